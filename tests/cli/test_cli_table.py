"""`vmf table`: any runs, directories of runs, every format, and whose program made them."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import pandas as pd
import pytest
from vmf_command import CONFIGS, QUICK, record, train, vmf

from vmf.table_formats import latex, markdown

QUICKSTART = CONFIGS / "quickstart.yaml"
SMALL = (*QUICK, "approximator.kind=none", "data.simulate.frames=10")
# Rows of a run: two protocols, each of vmf, the bound and no motion.
EACH = 2 * 3


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep over noise in falling order, with a point that failed."""
    out = tmp_path_factory.mktemp("swept")
    behind = "{target_low_m: [0, 0, -5], target_high_m: [1, 1, -4]}"
    for workspace, noise in (("{}", "10,3,1"), (behind, "1")):
        arguments = (*SMALL, f"noise.pixel_px={noise}", f"data.simulate.workspace={workspace}")
        vmf("sweep", QUICKSTART, *arguments, "--out", out, "--jobs", 1, "--quiet")
    return out / "quickstart-sweep"


def rows(*arguments: object) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(vmf("table", *arguments, "--format", "csv").out)))


def test_a_directory_of_runs_stands_for_its_finished_runs_in_order(swept: Path) -> None:
    said = vmf("table", swept, "--format", "csv")
    assert said.code == 3
    assert said.err.splitlines() == [f"lost: {swept}: runs that are not finished, left out (1)"]
    found = list(csv.DictReader(io.StringIO(said.out)))
    assert [row["noise.pixel_px"] for row in found] == ["1.0"] * EACH + ["3.0"] * EACH + ["10.0"] * EACH
    assert list(found[0])[:4] == ["noise.pixel_px", "protocol", "case", "method"]


def test_a_directory_that_train_writes_to_counts_every_run_once(tmp_path: Path) -> None:
    for noise in (2, 1):
        train(QUICKSTART, tmp_path, *SMALL, f"noise.pixel_px={noise}")
    found = rows(tmp_path / "quickstart")
    assert [row["noise.pixel_px"] for row in found] == ["1.0"] * EACH + ["2.0"] * EACH
    assert rows(tmp_path / "quickstart" / "latest") == [
        {key: value for key, value in row.items() if key != "noise.pixel_px"} for row in found[:EACH]
    ]


def test_functions_beside_the_own_are_told_apart_by_name(tmp_path: Path) -> None:
    other = "also=[{name: other, solver: {start: START}, curve_points: 0}]"
    for start in ("zero", "multi"):
        train(QUICKSTART, tmp_path, *SMALL, other.replace("START", start))
    found = rows(tmp_path / "quickstart")
    assert {row["also.other.solver.start"] for row in found} == {"zero", "multi"}
    assert "also" not in found[0]


def test_a_run_named_twice_counts_once(tmp_path: Path) -> None:
    train(QUICKSTART, tmp_path, *SMALL)
    once = rows(tmp_path / "quickstart")
    assert rows(tmp_path / "quickstart", tmp_path / "quickstart" / ".") == once


def test_other_packages_are_other_programs(tmp_path: Path) -> None:
    for noise in (1, 2):
        train(QUICKSTART, tmp_path, *SMALL, f"noise.pixel_px={noise}")
    run = next(path.parent for path in (tmp_path / "quickstart").glob("*-*/run.json"))
    changed = {**record(run), "swept": None}
    changed["packages"] = {**changed["packages"], "numpy": "1.0.0"}
    (run / "run.json").write_text(json.dumps(changed))
    said = vmf("table", tmp_path / "quickstart", "--format", "csv")
    assert "numpy 1.0.0" in said.err
    assert "scipy" not in said.err


def test_a_directory_without_a_finished_run_is_refused(tmp_path: Path, swept: Path) -> None:
    unfinished = tmp_path / "some" / "run"
    unfinished.mkdir(parents=True)
    some = {**record(next(swept.glob("*/summary.csv")).parent), "status": "failed"}
    (unfinished / "run.json").write_text(json.dumps(some))
    vmf("table", tmp_path / "some").refused("none of 1 runs is finished")
    vmf("table", tmp_path).refused("no run.json here")


def test_what_only_another_kind_has_is_no_column_of_its_own(tmp_path: Path) -> None:
    runs = [
        train(QUICKSTART, tmp_path, *SMALL, f"approximator.kind={kind}", *more)
        for kind, more in (("none", ()), ("polynomial", ()), ("polynomial", ("approximator.degree=1",)))
    ]
    assert list(rows(*runs[:2])[0])[:2] == ["approximator.kind", "protocol"]
    found = rows(*runs)
    assert [row["approximator.degree"] for row in found] == [""] * EACH + ["2"] * EACH + ["1"] * EACH
    lines = vmf("table", *runs).out.splitlines()
    column = lines[0].split(" | ").index("approximator.degree")
    assert [line.split(" | ")[column] for line in lines[2::EACH]] == ["–", "2", "1"]


def test_runs_of_different_programs_are_marked(tmp_path: Path, swept: Path) -> None:
    runs = [path.parent for path in sorted(swept.glob("*/summary.csv"))[:2]]
    assert "program" not in rows(*runs)[0]
    other = tmp_path / "other"
    other.mkdir()
    changed = {**record(runs[1]), "version": "9.9", "git_commit": "0123456789", "git_dirty": True}
    (other / "run.json").write_text(json.dumps(changed))
    (other / "summary.csv").write_bytes((runs[1] / "summary.csv").read_bytes())
    said = vmf("table", runs[0], other)
    assert said.code == 0
    assert said.err.startswith("note: made by different programs, see the column program: ")
    assert "9.9 01234567+" in said.err
    assert [row["program"] for row in rows(runs[0], other)][EACH:] == ["9.9 01234567+"] * EACH


def test_what_an_older_program_did_not_know_is_no_column(tmp_path: Path, swept: Path) -> None:
    runs = [path.parent for path in sorted(swept.glob("*/summary.csv"))[:2]]
    older = tmp_path / "older"
    older.mkdir()
    known = record(runs[1])
    del known["spec"]["solver"]["start"]
    (older / "run.json").write_text(json.dumps({**known, "version": "0.0.1"}))
    (older / "summary.csv").write_bytes((runs[1] / "summary.csv").read_bytes())
    assert list(rows(runs[0], older)[0])[:3] == ["noise.pixel_px", "program", "protocol"]


def test_a_section_that_only_some_have_is_told(tmp_path: Path) -> None:
    runs = [
        train(QUICKSTART, tmp_path, *SMALL, f"calibration_sweep={{questions: {n}}}" if n else SMALL[-1])
        for n in (0, 3)
    ]
    assert "calibration_sweep.questions" in rows(*runs)[0]


def test_json_has_every_digit_and_null_for_nothing(swept: Path) -> None:
    said = vmf("table", swept, "--json")
    assert said.code == 3
    found = json.loads(said.out)
    assert found.keys() == {"rows", "notes", "losses"}
    assert len(found["losses"]) == 1
    for ours, theirs in zip(found["rows"], rows(swept), strict=True):
        assert ours["noise.pixel_px"] == float(theirs["noise.pixel_px"])
        mean = theirs["distance mean (m)"]
        assert ours["distance mean (m)"] == (float(mean) if mean else None)
        assert isinstance(ours["n"], int)
    assert None in [row["distance mean (m)"] for row in found["rows"]]


def test_latex_is_a_table_of_the_same_cells(swept: Path) -> None:
    lines = vmf("table", swept, "--format", "latex").out.splitlines()
    shown = [line.split(" | ") for line in vmf("table", swept).out.splitlines()]
    assert lines[0] == r"\begin{tabular}{rlllrrrrrrr}"
    assert (lines[1], lines[3], lines[-2], lines[-1]) == (
        r"\toprule",
        r"\midrule",
        r"\bottomrule",
        r"\end{tabular}",
    )
    body = [lines[2], *lines[4:-2]]
    assert all(line.endswith(r" \\") for line in body)
    for line, cells in zip(body, [shown[0], *shown[2:]], strict=True):
        plain = [cell.replace("\\_", "_").replace("--", "–") for cell in line[:-3].split(" & ")]
        assert plain == [cell.strip("| ") for cell in cells]


def test_special_characters_survive_every_format() -> None:
    text = r"a&b%c$d#e_f{g}h~i^j\k|l<m"
    table = pd.DataFrame({"x|y": [text, "1"], "n": [1.0, float("nan")]})
    tex = latex(table).splitlines()
    assert tex[4] == (
        r"a\&b\%c\$d\#e\_f\{g\}h\textasciitilde{}i\textasciicircum{}j\textbackslash{}k\textbar{}l\textless{}m"
        r" & 1 \\"
    )
    assert tex[5] == r"1 & -- \\"
    lines = markdown(table).splitlines()
    assert all(len(re.split(r"(?<!\\)\|", line)) == 4 for line in lines)
    assert lines[2] == "| " + text.replace("|", "\\|") + " | 1 |"
