"""The calibration sweep and the Cramér–Rao bound at the command line."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pandas as pd
import pytest
from vmf_command import CONFIGS, NO_SWEEP, QUICK, errors, record, summary, train, vmf

QUICKSTART = CONFIGS / "quickstart.yaml"
SWEEP = (
    "calibration_sweep={focal_percent: [1], principal_px: [], rotation_deg: [0.5, 4], baseline_percent: [], "
    "methods: [bundle, triangulate_arun], questions: 5}"
)
SWEPT = [
    f"{method}[{error}]"
    for method in ("bundle", "triangulate_arun")
    for error in ("focal=1%", "rot=0.5deg", "rot=4deg")
]
MORE = (*QUICK, "noise.pixel_px=1")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(QUICKSTART, tmp_path_factory.mktemp("swept"), *MORE, SWEEP, command="compare-3d")


def test_the_sweep_is_in_the_tables_with_its_own_number_of_questions(swept: Path) -> None:
    counted = summary(swept).query("protocol == 'held_out' and component == 'distance'").set_index("method")
    assert [m for m in counted.index if "[" in m] == SWEPT
    # Five questions of two trials are three of each; the others answer all four of each.
    assert (counted.loc[SWEPT, ["n", "n_refused", "n_diverged"]].sum(axis=1) == 6).all()
    assert counted.loc["bundle", "n"] == 8
    table = errors(swept)
    assert set(table.loc[table["method"].isin(SWEPT), "protocol"]) == {"held_out"}
    assert record(swept)["swept"] == SWEPT


def test_crossovers_are_written_printed_and_told_to_machines(tmp_path: Path) -> None:
    said = vmf("compare-3d", QUICKSTART, *MORE, SWEEP, "--out", tmp_path, "--jobs", 1, "--json", plots=True)
    found = json.loads(said.out)
    table = pd.read_csv(said.run / "crossover.csv")
    pd.testing.assert_frame_equal(pd.DataFrame(found["crossovers"]), table, check_dtype=False)
    assert set(zip(table["method"], table["kind"], table["unit"], strict=True)) == {
        (method, *kind)
        for method in ("bundle", "triangulate_arun")
        for kind in (("focal", "%"), ("rotation", "deg"))
    }
    assert set(table["component"]) == {"distance"}
    assert (table["n"] <= table["n_asked"]).all()
    assert (table["n_asked"] == 6).all()
    # Four degrees are more than 30 px of disparity: no one who trusts such cameras keeps up.
    assert (table.loc[table["kind"] == "rotation", "crossover"] < 4).all()
    assert "calibration_crossover" in {Path(path).stem for path in found["plots"]}
    text = vmf("compare-3d", QUICKSTART, *MORE, SWEEP, "--out", tmp_path, "--jobs", 2, "--quiet").out
    lines = [line for line in text.splitlines() if line.startswith("  bundle, ")]
    assert [line.split(" (n = ")[0] for line in lines] == ["  bundle, focal length", "  bundle, rotation"]
    assert "distance from " in lines[1]
    assert not any(name in text for name in SWEPT)


def test_a_sweep_changes_nothing_else(swept: Path, tmp_path: Path) -> None:
    without = train(QUICKSTART, tmp_path, *MORE, NO_SWEEP, command="compare-3d")
    assert not (without / "crossover.csv").exists()
    assert record(without)["swept"] == []
    table = errors(swept)
    rest = table[~table["method"].isin(SWEPT)].reset_index(drop=True)
    pd.testing.assert_frame_equal(rest, errors(without), check_exact=True)
    assert (swept / "paired.csv").read_bytes() == (without / "paired.csv").read_bytes()
    by_method = summary(swept)
    kept = by_method[~by_method["method"].isin(SWEPT)].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, summary(without), check_exact=True)


def test_only_a_comparison_sweeps(swept: Path, tmp_path: Path) -> None:
    trained = train(QUICKSTART, tmp_path, *MORE, SWEEP)
    evaluated = vmf("evaluate", swept, "--out", tmp_path, "--json", "--quiet").run
    for run in (trained, evaluated):
        assert not set(errors(run)["method"]) & set(SWEPT)
        assert not (run / "crossover.csv").exists()


def test_tables_of_runs_leave_the_sweep_out(swept: Path) -> None:
    rows = csv.DictReader(io.StringIO(vmf("table", swept, "--format", "csv").out))
    methods = {row["method"] for row in rows}
    assert "bundle" in methods
    assert not methods & set(SWEPT)


@pytest.mark.parametrize(
    ("sweep", "said"),
    [
        ("calibration_sweep.focal_percent=[-1]", "greater than 0"),
        ("calibration_sweep.methods=[guess]", "bundle"),
        ("calibration_sweep.questions=0", "greater than 0"),
        ("calibration_sweep.rotation_degrees=[1]", "rotation_deg"),
    ],
)
def test_a_senseless_sweep_is_refused(sweep: str, said: str) -> None:
    vmf("compare-3d", QUICKSTART, sweep).refused("calibration_sweep", said)


def test_the_bound_is_in_every_simulated_run_and_in_no_pair(swept: Path, tmp_path: Path) -> None:
    trained = train(QUICKSTART, tmp_path, *MORE)
    evaluated = vmf("evaluate", trained, "--json", "--quiet").run
    for run in (trained, evaluated, swept):
        bound = summary(run).query("method == 'cramer_rao'")
        assert set(bound["protocol"]) == {"trained_code", "held_out"}
        ours = summary(run).query("method == 'vmf'")
        assert (bound["n"].to_numpy() == (ours["n"] + ours["n_refused"] + ours["n_diverged"])).all()
    for run in (evaluated, swept):
        assert "cramer_rao" not in set(pd.read_csv(run / "paired.csv")["method"])


def test_the_bound_lies_where_exact_cameras_reach_it(tmp_path: Path) -> None:
    """At 0.1 px maximum likelihood with exact cameras makes of a noise what the bound allows."""
    more = (*QUICK, "noise.pixel_px=0.1", "evaluate.queries=50", "task=six_dof", "data.simulate.targets=6")
    run = train(QUICKSTART, tmp_path, *more, command="compare-3d")
    held_out = summary(run).query("protocol == 'held_out'").set_index(["component", "method"])["median"]
    for component in ("rot_x", "rot_y", "rot_z", "t_x", "t_y", "t_z", "angle", "distance"):
        assert held_out[component, "bundle"] == pytest.approx(held_out[component, "cramer_rao"], rel=0.05)
        assert held_out[component, "triangulate_arun"] > held_out[component, "cramer_rao"]
