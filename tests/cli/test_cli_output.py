"""What is said where: results on stdout, everything else on stderr, tables that say what they are."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from vmf_command import CONFIGS, QUICK, errors, record, same_results, summary, train, vmf

QUICKSTART = CONFIGS / "quickstart.yaml"
RIVALS = ["triangulate_arun", "pnp", "bundle"]
# Two frames are too few to learn anything, which is worth a note.
HOPELESS = (*QUICK, "data.simulate.frames=2", "evaluate.trials=1")


def test_json_is_the_only_thing_on_stdout_and_says_it_all(tmp_path: Path) -> None:
    said = vmf("compare-3d", QUICKSTART, *QUICK, "--out", tmp_path, "--jobs", 1, "--json", plots=True)
    found = json.loads(said.out)
    assert found.keys() == {"run_dir", "summary", "paired", "crossovers", "plots", "losses", "notes"}
    run = Path(found["run_dir"])
    pd.testing.assert_frame_equal(
        pd.DataFrame(found["summary"]), summary(run), check_exact=True, check_dtype=False
    )
    assert len(found["paired"]) == len(pd.read_csv(run / "paired.csv"))
    assert {Path(p).suffix for p in found["plots"]} <= {".png", ".pdf"}
    assert all(Path(p).is_file() for p in found["plots"])
    assert record(run)["losses"] == found["losses"] == []
    assert record(run)["notes"] == found["notes"]


def test_json_has_null_where_there_is_no_number(tmp_path: Path) -> None:
    said = vmf("train", QUICKSTART, *HOPELESS, "--out", tmp_path, "--json", "--quiet")
    rows = [row for row in json.loads(said.out)["summary"] if row["method"] == "vmf"]
    assert rows
    for row in rows:
        assert (row["n"], row["mean"], row["median"], row["ci_low"]) == (0, None, None, None)
        assert row["n_refused"] + row["n_diverged"] in (1, 4)


def test_a_log_has_plain_progress_lines_and_notes(tmp_path: Path) -> None:
    said = vmf("train", QUICKSTART, *HOPELESS, "--out", tmp_path)
    assert said.code == 0
    lines = said.err.splitlines()
    assert lines[0].startswith("trials: 1 of 1 after ")
    assert lines[-1].startswith("note: ")
    assert "\x1b" not in said.err + said.out
    assert "\r" not in said.err


def test_quiet_says_nothing_beside_the_result(tmp_path: Path) -> None:
    said = vmf("train", QUICKSTART, *HOPELESS, "--out", tmp_path, "--quiet")
    assert (said.code, said.err) == (0, "")
    assert "run directory: " in said.out


def test_the_table_says_which_question_each_protocol_asks(tmp_path: Path) -> None:
    said = vmf("compare-3d", QUICKSTART, *QUICK, "--out", tmp_path, "--jobs", 1, "--quiet")
    text = " ".join(said.out.split())
    assert "trained code: from a view of the training itself, same targets — frame=30" in text
    assert "held out: new targets, new poses, one shot each — frame=30" in text
    assert "The learned function has seen these very targets in every training frame" in text
    assert "Neither side has seen these targets before. Positive: vmf is better." in text
    for word in ("refused", "diverged", "t_x (m)", "angle (rad)", "95 % interval", "no_motion", *RIVALS):
        assert word in text
    run = tmp_path / "quickstart" / "latest"
    assert f"run directory: {run.resolve()}" in text


def test_compare_3d_asks_all_methods_the_same_and_pairs_them(tmp_path: Path) -> None:
    more = (*QUICK, "evaluate.trials=3", "noise.pixel_px=3")
    run = train(QUICKSTART, tmp_path, *more, command="compare-3d")
    table = errors(run)
    assert list(dict.fromkeys(table["method"])) == ["vmf", *RIVALS, "cramer_rao", "no_motion"]
    asked = {
        name: rows.drop(columns=["method", "estimate", "abs_error", "status"]).reset_index(drop=True)
        for name, rows in table.groupby("method")
    }
    for rows in asked.values():
        assert rows.equals(asked["vmf"])
    still = table[(table["method"] == "no_motion")]
    assert (still["status"] == "ok").all()
    assert (still["estimate"] == 0).all()
    np.testing.assert_allclose(still["abs_error"], still["truth"].abs(), rtol=0, atol=1e-15)

    paired = pd.read_csv(run / "paired.csv")
    assert set(paired["method"]) == {*RIVALS, "no_motion"}
    keys = ["protocol", "component"]
    at_end = table[(table["protocol"] == "held_out") | (table["frame"] == 30)]
    for row in paired.itertuples():
        mine = at_end[(at_end["protocol"] == row.protocol) & (at_end["component"] == row.component)]
        by_method = {m: mine.loc[mine["method"] == m, "abs_error"].to_numpy() for m in (row.method, "vmf")}
        theirs, ours = by_method[row.method], by_method["vmf"]
        both = np.isfinite(theirs) & np.isfinite(ours)
        assert row.n == both.sum() > 2
        assert row.mean_difference == pytest.approx((theirs - ours)[both].mean(), rel=1e-12, abs=1e-15)
        assert row.ci_low <= row.mean_difference <= row.ci_high
        if np.median(ours[both]) > 0:
            ratio = np.median(theirs[both]) / np.median(ours[both])
            assert row.median_ratio == pytest.approx(ratio, rel=1e-12)
    assert len(paired) == len(paired.drop_duplicates([*keys, "method"]))


def test_comparison_leaves_the_answers_of_the_function_alone(tmp_path: Path) -> None:
    compared = errors(train(QUICKSTART, tmp_path, *QUICK, command="compare-3d"))
    mine = compared[~compared["method"].isin(RIVALS)].reset_index(drop=True)
    assert mine.equals(errors(train(QUICKSTART, tmp_path, *QUICK)))


def test_a_stated_calibration_error_is_part_of_the_rivals_name(tmp_path: Path) -> None:
    rivals = "rivals=[{method: bundle}, {method: bundle, error: {focal_percent: 1, rotation_deg: 0.5}}]"
    run = train(QUICKSTART, tmp_path, *QUICK, rivals, command="compare-3d")
    assert list(dict.fromkeys(errors(run)["method"])) == [
        "vmf",
        "bundle",
        "bundle[focal=1%,rot=0.5deg]",
        "cramer_rao",
        "no_motion",
    ]


def test_a_comparison_with_nobody_says_so(tmp_path: Path) -> None:
    said = vmf("compare-3d", QUICKSTART, *QUICK, "rivals=[]", "--out", tmp_path, "--jobs", 1)
    assert said.code == 2 or "rival" in said.err


def test_a_rival_that_refuses_everything_is_still_a_row(tmp_path: Path) -> None:
    # One target does not fix a translation and a heading by triangulation.
    more = (*QUICK, "task=six_dof", "data.simulate.targets=4", "evaluate.query_targets=2")
    run = train(QUICKSTART, tmp_path, *more, command="compare-3d")
    counted = summary(run).query("protocol == 'held_out' and component == 'angle'").set_index("method")
    assert counted.loc["triangulate_arun", "n"] == 0
    paired = pd.read_csv(run / "paired.csv").query("protocol == 'held_out'")
    assert set(paired["method"]) >= {"triangulate_arun"}


@pytest.mark.parametrize("override", ["evaluate.protocol=[]", "evaluate.min_targets=9"])
def test_a_spec_that_asks_nothing_is_refused(tmp_path: Path, override: str) -> None:
    more = (*QUICK, "evaluate.protocol=[trained_code]", override)
    vmf("train", QUICKSTART, *more, "--out", tmp_path, "--jobs", 1, "--quiet").refused("evaluate")


@pytest.mark.parametrize("name", ["../outside", "a/../../outside", "a/b"])
def test_a_run_stays_where_out_says(tmp_path: Path, name: str) -> None:
    out = tmp_path / "runs"
    vmf("train", QUICKSTART, *QUICK, f"name={name!r}", "--out", out, "--jobs", 1).refused("name")


def test_info_tells_what_a_run_and_a_model_hold(tmp_path: Path) -> None:
    run = train(QUICKSTART, tmp_path, *QUICK)
    said = vmf("info", run)
    assert (said.code, said.err) == (0, "")
    median = summary(run).query("protocol == 'held_out' and method == 'vmf' and component == 'distance'")[
        "median"
    ]
    for part in (
        "command: train",
        "status: done",
        "git_commit: ",
        f"{median.iloc[0]:.4g} m",
        "peak_memory_mib",
    ):
        assert part in said.out
    model = vmf("info", run / "model.npz")
    assert (model.code, model.err) == (0, "")
    assert model.out in said.out
    for part in ("task: translation", "learned from 30 frames, 4 targets, 120 stereo", "noise found: "):
        assert part in model.out


def test_info_refuses_what_is_none_of_these(tmp_path: Path) -> None:
    vmf("info", tmp_path / "nothing").refused(str(tmp_path / "nothing"), "no such file or directory")
    vmf("info", tmp_path).refused(str(tmp_path), "no run.json")
    vmf("info", QUICKSTART).refused(str(QUICKSTART), "is not an MCAP file")


@pytest.fixture(scope="module")
def two_noises(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    out = tmp_path_factory.mktemp("noises")
    return [train(QUICKSTART, out, *QUICK, f"noise.pixel_px={noise}") for noise in (1.0, 3.0)]


def test_a_table_has_a_column_for_what_differs_and_no_other(two_noises: list[Path]) -> None:
    said = vmf("table", *two_noises, "--format", "csv")
    assert said.code == 0
    rows = list(csv.DictReader(io.StringIO(said.out)))
    assert list(rows[0]) == [
        "noise.pixel_px",
        "protocol",
        "case",
        "method",
        "angle mean (rad)",
        "angle median (rad)",
        "distance mean (m)",
        "distance median (m)",
        "n",
        "n_refused",
        "n_diverged",
    ]
    assert [row["noise.pixel_px"] for row in rows] == ["1.0"] * 6 + ["3.0"] * 6
    for row, run in zip(rows, [two_noises[0]] * 6 + [two_noises[1]] * 6, strict=True):
        chosen = summary(run).query(
            f"protocol == {row['protocol']!r} and method == {row['method']!r} and component == 'distance'"
        )
        assert float(row["distance median (m)"]) == chosen["median"].item()
        assert int(row["n"]) == chosen["n"].item()


def test_the_markdown_table_says_the_same_in_four_digits(two_noises: list[Path]) -> None:
    said = vmf("table", *two_noises)
    lines = said.out.splitlines()
    rows = list(csv.reader(io.StringIO(vmf("table", *two_noises, "--format", "csv").out)))
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert cells[0] == rows[0]
    assert set(cells[1]) == {"---"}
    assert len(cells) == len(rows) + 1
    for shown, exact in zip(cells[2:], rows[1:], strict=True):
        for a, b in zip(shown, exact, strict=True):
            assert a == b or float(a) == pytest.approx(float(b), rel=1e-3)


def test_a_table_of_equal_runs_has_no_column_of_settings(two_noises: list[Path]) -> None:
    header = vmf("table", two_noises[0], two_noises[0], "--format", "csv").out.splitlines()[0]
    assert header.startswith("protocol,case,method,")


def test_a_table_of_what_is_unfinished_or_no_run_is_refused(tmp_path: Path, two_noises: list[Path]) -> None:
    unfinished = tmp_path / "unfinished"
    unfinished.mkdir()
    (unfinished / "run.json").write_text(json.dumps({**record(two_noises[0]), "status": "running"}))
    vmf("table", two_noises[0], unfinished).refused(str(unfinished), "status running", "finished run")
    vmf("table", tmp_path / "none").refused(str(tmp_path / "none"), "no run.json")
    vmf("table", two_noises[0], "--format", "html").refused("--format", "'html'", "markdown, csv")


@pytest.mark.parametrize("content", ["", "a,b\n1,2\n"])
@pytest.mark.parametrize("command", ["info", "table"])
def test_a_damaged_summary_is_refused(
    tmp_path: Path, two_noises: list[Path], command: str, content: str
) -> None:
    (tmp_path / "run.json").write_text(json.dumps(record(two_noises[0])))
    (tmp_path / "summary.csv").write_text(content)
    vmf(command, tmp_path).refused(str(tmp_path / "summary.csv"))


def test_spec_yaml_of_a_run_is_found_again_by_its_hash(two_noises: list[Path]) -> None:
    run = two_noises[0]
    again = train(run / "spec.yaml", run.parent.parent, "name=again")
    assert again.name.split("-")[0] == run.name.split("-")[0]
    assert same_results(run, again)
