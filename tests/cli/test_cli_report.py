"""`vmf report`: runs on one page, what is not finished is said, and what is no run refused."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from PIL import Image
from vmf_command import CONFIGS, QUICK, record, train, vmf

from vmf.report.page import thesis

FEW = ("data.simulate.frames=20", "evaluate.trials=1", "evaluate.checkpoints=null", "evaluate.curve_points=4")
FEW += ("evaluate.queries=2", "evaluate.bootstrap=20")
QUICKSTART = CONFIGS / "quickstart.yaml"


def miniature(config: str, out: Path) -> Path:
    """Return the run directory of an experiment of the thesis, as the page has it but for the effort."""
    command = next(figure.command for figure in thesis().figures if figure.config == config)
    return train(CONFIGS / f"thesis/{config}.yaml", out, *FEW, command=command)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(QUICKSTART, tmp_path_factory.mktemp("runs"), *QUICK)


def test_a_run_and_a_directory_of_runs_make_a_page(run: Path, tmp_path: Path) -> None:
    page = tmp_path / "new" / "page.html"
    said = vmf("report", run, "-o", page)
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith(f"{page}: 1 run, ")
    text = page.read_text()
    assert "<title>Report of quickstart</title>" in text
    assert run.name in text
    assert "estimator: ml" in text
    # The same run by two ways is on it once; two of them stand side by side.
    assert vmf("report", run.parent, run, "-o", page).out.startswith(f"{page}: 1 run, ")
    shutil.copytree(run, tmp_path / "copy")
    assert vmf("report", run, tmp_path / "copy", "-o", page).out.startswith(f"{page}: 2 runs, ")
    assert "Runs side by side" in page.read_text()


def test_a_damaged_figure_is_left_out_and_the_run_is_not(tmp_path: Path) -> None:
    made = miniature("pan_tilt", tmp_path)
    plots = made / "plots"
    plots.mkdir(exist_ok=True)
    rng = np.random.default_rng(1)
    for name in ("absolute_error", "truth_vs_estimate"):
        Image.fromarray(rng.integers(0, 256, (60, 80, 3), np.uint8)).save(plots / f"{name}.png")
    whole = tmp_path / "whole.html"
    assert vmf("report", made, "-o", whole).code == 0
    figure = plots / "absolute_error.png"
    figure.write_bytes(figure.read_bytes()[: figure.stat().st_size // 2])
    for more in ((), ("--no-thesis",)):
        page = tmp_path / "page.html"
        said = vmf("report", made, "-o", page, *more)
        assert said.code == 3
        (line,) = [line for line in said.err.splitlines() if line.startswith("lost: ")]
        assert line.startswith(f"lost: {made}: the figure is left out: {figure}: damaged, ")
        assert page.read_text().count("<img") == whole.read_text().count("<img") - 1 == 1
    vmf("report", made, "-o", page)
    assert [undrawn(one) - undrawn(other) for one, other in ((page, whole), (whole, page))] == [
        {"absolute_error"},
        set(),
    ]


def undrawn(page: Path) -> set[str]:
    """Return the pictures that the page says a run of the thesis has not."""
    said = re.search(r"Not among the run’s plots: ([\w, ]+)\. ", page.read_text())
    return set() if said is None else set(said[1].split(", "))


def test_what_cannot_be_written_is_named_as_it_was_given(run: Path, tmp_path: Path) -> None:
    said = vmf("report", run, "-o", tmp_path)
    said.refused(f"-o: {tmp_path}: ")


def test_an_evaluation_is_a_run_too(run: Path, tmp_path: Path) -> None:
    evaluated = vmf("evaluate", run, "--json", "--quiet", "evaluate.queries=4").run
    page = tmp_path / "page.html"
    assert vmf("report", run, evaluated, "-o", page).code == 0
    text = page.read_text()
    assert "<title>Report of quickstart, quickstart, evaluated</title>" in text
    assert f"vmf evaluate {run.resolve()} evaluate.queries=4" in text


def test_runs_of_the_thesis_are_known_by_their_specs(run: Path, tmp_path: Path) -> None:
    made = miniature("translation", tmp_path / "whatever")
    page = tmp_path / "page.html"
    assert vmf("report", made, "-o", page).code == 0
    assert "The thesis beside ours" in page.read_text()
    assert vmf("report", made, "-o", page, "--no-thesis").code == 0
    assert "The thesis beside ours" not in page.read_text()
    said = vmf("report", run, "-o", page, "--thesis")
    assert said.code == 0
    assert "note: not run: stereo_codes" in said.err
    assert "Other runs" in page.read_text()


def test_a_run_that_has_only_the_name_of_an_experiment_is_said_to_be_none(run: Path, tmp_path: Path) -> None:
    named = tmp_path / "translation-sweep" / "point"
    shutil.copytree(run, named)
    page = tmp_path / "page.html"
    said = vmf("report", named.parent, "-o", page)
    assert said.code == 0
    assert "note: not counted: point is no run of translation: " in said.err
    assert "The thesis beside ours" not in page.read_text()
    vmf("report", named.parent, "-o", page, "--thesis")
    assert "not counted: point is no run of translation" in page.read_text()


def test_what_is_not_finished_is_counted(run: Path, tmp_path: Path) -> None:
    for name in ("done", "stopped"):
        shutil.copytree(run, tmp_path / name)
    stopped = tmp_path / "stopped" / "run.json"
    stopped.write_text(json.dumps(record(run) | {"status": "interrupted"}))
    said = vmf("report", tmp_path, "-o", tmp_path / "page.html")
    assert said.code == 3
    assert f"lost: {tmp_path}: runs that are not finished, left out (1)" in said.err
    said = vmf("report", tmp_path / "stopped", "-o", tmp_path / "page.html")
    said.refused(str(tmp_path / "stopped"), "no finished run")
    # A sweep that has no finished run yet, or no run at all, does not keep the others from their page.
    (tmp_path / "empty").mkdir()
    said = vmf("report", tmp_path / "empty", tmp_path / "stopped", run, "-o", tmp_path / "others.html")
    assert said.code == 3
    assert said.out.startswith(f"{tmp_path / 'others.html'}: 1 run, ")
    assert f"lost: {tmp_path / 'empty'}: no finished run" in said.err
    assert f"lost: {tmp_path / 'stopped'}: runs that are not finished, left out (1)" in said.err


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("summary.csv", None),
        ("condition.csv", "frame,n,median\n1,2,wide\n"),
        ("points.csv", "component,n,mean,std\nx,1,0.1,far\n"),
        ("condition.csv", "frame,n,median\n1,2,3\n2\n"),
        ("errors.parquet", "no such thing"),
        ("run.json", "{"),
    ],
)
def test_a_damaged_run_is_counted_and_the_others_make_the_page(
    run: Path, tmp_path: Path, name: str, text: str | None
) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(run, broken)
    if text is None:
        table = pd.read_csv(broken / name, dtype="object")
        table.loc[0, "mean"] = "far"
        text = table.to_csv(index=False)
    (broken / name).write_text(text)
    said = vmf("report", run, broken, "-o", tmp_path / "page.html")
    assert said.code == 3
    assert said.out.startswith(f"{tmp_path / 'page.html'}: 1 run, ")
    (line,) = said.err.splitlines()
    assert line.startswith(f"lost: {broken}: damaged, the run is left out: {broken / name}: ")
    vmf("report", broken, "-o", tmp_path / "page.html").refused(str(broken / name))


def test_damage_in_the_middle_of_the_answers_is_found(run: Path, tmp_path: Path) -> None:
    """Where the file still says what it is, and only the answers cannot be read."""
    broken = tmp_path / "broken"
    shutil.copytree(run, broken)
    errors = broken / "errors.parquet"
    content = bytearray(errors.read_bytes())
    content[4:104] = bytes(100)
    errors.write_bytes(content)
    assert pq.read_schema(errors).names == pq.read_schema(run / "errors.parquet").names
    said = vmf("report", run, broken, "-o", tmp_path / "page.html", "--thesis")
    assert said.code == 3
    assert f"lost: {broken}: damaged, the run is left out: {errors}: damaged, " in said.err


def test_what_is_missing_of_a_run_is_named(tmp_path: Path) -> None:
    made = miniature("pan_tilt", tmp_path)
    page = tmp_path / "page.html"
    assert vmf("report", made, "-o", page).code == 0
    (made / "errors.parquet").unlink()
    shutil.rmtree(made / "plots")
    said = vmf("report", made, "-o", page)
    assert said.code == 3
    assert f"lost: {made}: no errors.parquet" in said.err
    assert f"lost: {made}: no plots" in said.err
    assert page.exists()


def test_what_is_no_run_is_refused(run: Path, tmp_path: Path) -> None:
    vmf("report", tmp_path / "nowhere").refused("nowhere", "no such directory")
    vmf("report", tmp_path).refused(str(tmp_path), "no finished run")
    (tmp_path / "file").write_text("")
    vmf("report", run, "-o", tmp_path / "file" / "page.html").refused("-o", "file")
    broken = tmp_path / "broken"
    shutil.copytree(run, broken)
    (broken / "summary.csv").write_text("a,b\n1,2\n")
    vmf("report", broken, "-o", tmp_path / "page.html").refused("summary.csv", "columns")
