"""Settings that the thesis's experiments need, at the command line: what they refuse, and what they leave."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from vmf_command import CONFIGS, MINI, QUICK, errors, summary, train, vmf

from vmf.errors import InputError
from vmf.experiment.check import check
from vmf.spec import Spec

QUICKSTART = CONFIGS / "quickstart.yaml"
EXACT = "learner={kind: pipeline, engine: sequential, matrices: exact}"


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (("evaluate.beyond=[30]",), ("evaluate.beyond: found 30", "from 1 to 29 is accepted")),
        (("evaluate.curve_spacing=log",), ("evaluate.curve_spacing", "geometric, even")),
        (
            ("data.simulate.lost=[{target: 99, from_frame: 3, frames: 2}]",),
            ("data.simulate.lost: found target 99",),
        ),
        (
            ("data.simulate.lost=[{target: 0, from_frame: 30, frames: 2}]",),
            ("found from_frame 30, 1 to 29 are accepted",),
        ),
        (("task=pan_tilt", "noise.drift_m_per_sqrt_m=0.1"), ("pan_tilt does not travel",)),
        (("task=translation", "noise.drift_rad_per_sqrt_m=0.1"), ("translation does not turn",)),
        (("task=planar", "noise.drift_m_per_sqrt_m=1e308"), ("noise.drift_m_per_sqrt_m", "at most 1000")),
        (("noise.drift_m_per_sqrt_m=-1",), ("noise.drift_m_per_sqrt_m", "at least 0")),
        (("learner={kind: pipeline, matrices: exact}",), ("matrices: exact needs engine: sequential",)),
        (("data.simulate.tracker={kind: meanshift}",), ("follows images.targets: blob, found texture",)),
        (("data.simulate.tracker={kind: klt}",), ("data.simulate.tracker.kind", "meanshift")),
        (("data.simulate.workspace.tool_start_m=[0,0,1]",), ("tool_start_m", "eye_to_hand")),
    ],
)
def test_what_cannot_be_is_one_line(
    tmp_path: Path, overrides: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    vmf("train", QUICKSTART, *MINI, *overrides, "--out", tmp_path).refused(*parts)


def test_a_recording_has_no_pixels_without_noise() -> None:
    recording = {"path": "x.mcap", "pose": {"topic": "/p"}, "tracks": {"topic": "/t"}}
    learner = {"kind": "pipeline", "engine": "sequential", "matrices": "exact"}
    content = {"task": "planar", "data": {"recording": recording}, "learner": learner}
    with pytest.raises(InputError, match=r"learner\.matrices: found exact, which only a simulation knows"):
        check(Spec.model_validate(content), None)


def test_settings_that_say_what_is_so_anyway_change_no_byte(tmp_path: Path) -> None:
    plain = train(QUICKSTART, tmp_path, *QUICK)
    said = train(
        QUICKSTART,
        tmp_path,
        *QUICK,
        "noise.drift_m_per_sqrt_m=0",
        "data.simulate.lost=[]",
        "data.simulate.tracker=null",
        "evaluate.beyond=[]",
        "evaluate.curve_spacing=geometric",
    )
    for name in ("errors.parquet", "summary.csv", "model.npz"):
        assert (plain / name).read_bytes() == (said / name).read_bytes()


def test_odometry_is_a_row_beside_the_functions_and_right_without_drift(tmp_path: Path) -> None:
    """Of the trained code alone: one shot from view to view has no odometry between them."""
    table = errors(train(QUICKSTART, tmp_path, *QUICK, "task=planar", "noise.drift_m_per_sqrt_m=1e-9"))
    by_odometry = table[table["method"] == "odometry"]
    mine = table[(table["method"] == "vmf") & (table["protocol"] == "trained_code")]
    assert set(by_odometry["protocol"]) == {"trained_code"}
    assert len(by_odometry) == len(mine)
    np.testing.assert_array_equal(by_odometry["truth"], mine["truth"])
    # A nanometre after a metre, over 60 m or less of way.
    assert by_odometry.loc[by_odometry["unit"] == "m", "abs_error"].max() < 1e-7


def test_answers_beyond_a_frame_are_a_case_of_the_summary(tmp_path: Path) -> None:
    run = train(QUICKSTART, tmp_path, *QUICK, "evaluate.beyond=[10]", "evaluate.curve_points=6")
    table, counted = errors(run), summary(run)
    rows = counted[counted["case"] == "frame>10"]
    later = table["frame"][(table["protocol"] == "trained_code") & (table["frame"] > 10)].nunique()
    assert later > 1
    assert set(rows["protocol"]) == {"trained_code"}
    for _, row in rows.iterrows():
        part = table[
            (table["protocol"] == "trained_code")
            & (table["frame"] > 10)
            & (table["method"] == row["method"])
            & (table["component"] == row["component"])
        ]
        assert row[["n", "n_refused", "n_diverged"]].sum() == len(part) == 2 * later
        assert row["mean"] == pytest.approx(part["abs_error"].mean())


def test_condition_numbers_and_reconstructed_points_have_tables(tmp_path: Path) -> None:
    pipeline = ("learner={kind: pipeline}", "approximator={kind: cmac, tile_px: 64}")
    run = train(QUICKSTART, tmp_path, *MINI, *pipeline, command="compare-3d")
    condition, points = pd.read_csv(run / "condition.csv"), pd.read_csv(run / "points.csv")
    assert list(condition) == ["frame", "n", "n_singular", "median", "p05", "p95"]
    assert (condition["n"] + condition["n_singular"] == 2).all()
    assert condition["median"].iloc[-1] > 1.0
    assert list(points) == ["component", "unit", "n", "mean", "std"]
    assert points["component"].tolist() == ["x", "y", "z"]
    # 3 px at about 2 m and 0.2 m between the cameras: centimetres across, more in depth.
    assert points["mean"].between(1e-3, 1.0).all()
    assert points["mean"][2] > points["mean"][:2].max()
