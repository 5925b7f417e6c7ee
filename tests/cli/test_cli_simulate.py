"""Training from a simulated recording gives the numbers that training from the simulation gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from mcap.reader import make_reader
from vmf_command import errors, summary, train, vmf

from vmf.spec import load
from vmf.spec.images import RenderedImages

CASES = {
    "translation": ("translation", "eye_in_hand"),
    "six_dof": ("six_dof", "eye_in_hand"),
    "planar": ("planar", "eye_in_hand"),
    "pan_tilt": ("pan_tilt", "eye_in_hand"),
    "translation eye-to-hand": ("translation", "eye_to_hand"),
    "six_dof eye-to-hand": ("six_dof", "eye_to_hand"),
}
HAND_GUIDED = {"motion": "hand_guided", "frames": 60}
Pair = tuple[pd.DataFrame, pd.DataFrame]


def both_ways(tmp_path: Path, task: str, mounting: str, simulate: dict[str, object]) -> tuple[Path, Path]:
    """Runs trained on the simulation, and on the file that `vmf simulate` writes of it."""
    common = {"task": task, "mounting": mounting, "noise": {"pixel_px": 2.0, "pose_m": 0, "pose_rad": 0}}
    common["learner"] = {"kind": "transport"}
    common["evaluate"] = {"protocol": ["trained_code"], "curve_points": 6, "bootstrap": 50}
    direct = tmp_path / "direct.yaml"
    direct.write_text(yaml.safe_dump({**common, "data": {"simulate": simulate}}))
    said = vmf("simulate", direct, "-o", tmp_path / "file.mcap")
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith(f"{tmp_path / 'file.mcap'}: {simulate['frames']} frames, ")
    source = {"path": "file.mcap", "tracks": {"topic": "/stereo/tracks"}}
    if task == "pan_tilt":
        source["joints"] = {"topic": "/robot/joints"}
    else:
        source["pose"] = {"topic": "/robot/pose"}
    recorded = tmp_path / "recorded.yaml"
    recorded.write_text(yaml.safe_dump({**common, "data": {"recording": source}}))
    return train(direct, tmp_path), train(recorded, tmp_path)


def unbounded(table: pd.DataFrame) -> pd.DataFrame:
    """A table without the Cramér–Rao bound, which only a simulation's truth gives."""
    return table[table["method"] != "cramer_rao"].reset_index(drop=True)


def answered(run: Path) -> pd.DataFrame:
    return unbounded(errors(run))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("motion", ["random", "hand_guided"])
def test_answers_are_the_same_bit_for_bit(tmp_path: Path, case: str, motion: str) -> None:
    runs = both_ways(tmp_path, *CASES[case], {"frames": 40, "motion": motion, "seed": 5})
    a, b = map(answered, runs)
    assert len(a) > 40
    assert (a["status"] == "ok").sum() > 20
    for column in ("trial", "frame", "protocol", "method", "component", "unit", "status"):
        assert a[column].equals(b[column]), column
    np.testing.assert_array_equal(a["estimate"], b["estimate"])
    # Truths are rounded where poses become quaternions: a few units in the last place of a motion.
    np.testing.assert_allclose(a["truth"], b["truth"], rtol=0, atol=16 * np.finfo(float).eps)


@pytest.mark.parametrize(
    "case",
    [
        "translation",
        "translation eye-to-hand",
        "six_dof",
        "planar",
        "pan_tilt",
        "six_dof eye-to-hand",
    ],
)
def test_tables_are_the_same_character_by_character(tmp_path: Path, case: str) -> None:
    runs = both_ways(tmp_path, *CASES[case], {"frames": 40, "seed": 5})
    a, b = (answered(run).to_csv(index=False) for run in runs)
    assert a == b
    # Intervals are resampled by the spec's seed, which a recording has not.
    fixed = ["case", "n", "n_refused", "n_diverged", "mean", "std", "median", "p95"]
    first, second = (unbounded(summary(run))[fixed] for run in runs)
    assert first.equals(second)


def test_the_recording_carries_the_spec_it_was_made_from(tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text("task: planar\ndata: {simulate: {frames: 9, seed: 3}}\n")
    vmf("simulate", spec, "-o", tmp_path / "a.mcap", "noise.pixel_px=0.25")
    with (tmp_path / "a.mcap").open("rb") as file:
        (attached,) = make_reader(file).iter_attachments()
    (tmp_path / "attached.yaml").write_bytes(attached.data)
    assert load(tmp_path / "attached.yaml").spec == load(spec, ["noise.pixel_px=0.25"]).spec
    vmf("simulate", tmp_path / "attached.yaml", "-o", tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_only_simulated_data_can_be_simulated(tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text("task: planar\ndata: {recording: {path: a, pose: {topic: p}, tracks: {topic: t}}}\n")
    vmf("simulate", spec, "-o", tmp_path / "a.mcap").refused(
        str(spec), "found recording, simulate is accepted"
    )
    assert not (tmp_path / "a.mcap").exists()


def test_a_film_that_nobody_could_follow_is_said_to_be_one(tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    simulated = {"frames": 4, "targets": 3, "seed": 1, "images": {"targets": "tag"}}
    spec.write_text(yaml.safe_dump({"task": "translation", "data": {"simulate": simulated}}))
    arguments = ("simulate", spec, "-o", tmp_path / "a.mcap", "--images")
    said = vmf(*arguments)
    assert said.code == 0
    (note,) = [line for line in said.err.splitlines() if line.startswith("note: ")]
    assert "px from frame to frame, too far for klt, sift" in note
    assert "data.simulate.motion=hand_guided" in note
    for more in ("data.simulate.motion=hand_guided", "--quiet", "--no-images"):
        assert "note" not in vmf(*arguments, more).err


def test_the_help_names_every_setting_of_images() -> None:
    words = vmf("simulate", "--help").out
    for name in RenderedImages.model_fields:
        assert name in words, name
