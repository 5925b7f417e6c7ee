"""`vmf bench`: one command, one JSON, one table."""

from __future__ import annotations

import json
from pathlib import Path

from vmf_command import vmf


def test_a_figure_by_name_is_printed_and_written(tmp_path: Path) -> None:
    said = vmf("bench", "updates", "--quick", "--quiet", "--out", tmp_path)
    assert (said.code, said.err) == (0, "")
    assert "updates" in said.out
    assert "numpy.linalg.qr" in said.out
    (figure,) = json.loads((tmp_path / "bench.json").read_text())["figures"]
    assert figure["name"] == "updates"
    assert (tmp_path / "bench.txt").read_text() == said.out


def test_json_is_what_was_written(tmp_path: Path) -> None:
    said = vmf("bench", "codes", "updates", "codes", "--quick", "--json", "--out", tmp_path)
    assert said.code == 0
    assert said.out == (tmp_path / "bench.json").read_text()
    assert [figure["name"] for figure in json.loads(said.out)["figures"]] == ["codes", "updates"]
    assert str(tmp_path / "bench.json") in said.err


def test_a_place_that_cannot_be_is_said_before_anything_is_measured(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    vmf("bench", "motions", "--quick", "--out", tmp_path / "file" / "x").refused("--out")


def test_an_unknown_figure_is_refused_with_those_there_are(tmp_path: Path) -> None:
    line = vmf("bench", "engine", "--quick", "--out", tmp_path).refused("engine", "engines", "recordings")
    assert line.startswith("figure engine: ")
    assert not list(tmp_path.iterdir())
