"""In front of fixed cameras, what stands still while the tool moves is not on the tool."""

from __future__ import annotations

import numpy as np
import pytest
from recording_files import File, assert_same, losses, moving_robot, read_at, track_message

from vmf.data.recording.still import drop_still
from vmf.data.tracks import Tracks, from_dense

RNG = np.random.default_rng(0)


def tracks(n: int = 12, step_m: float = 0.02, still_px: float = 0.3, moving_px: float = 8.0) -> Tracks:
    """Four targets: the second and the last stand still but for a tracker's noise."""
    E = np.tile(np.eye(4), (n, 1, 1))
    E[:, 0, 3] = step_m * np.arange(n)
    pixels = 100.0 + RNG.uniform(0, 300, (1, 4, 4)) + np.zeros((n, 1, 1))
    pixels[:, [0, 2]] += moving_px * np.arange(n)[:, None, None]
    pixels[:, [1, 3]] += RNG.uniform(-still_px, still_px, (n, 2, 4))
    pixels[3:, 3, 2:] = np.nan
    return from_dense(np.arange(n) * 10**8, E, pixels, ("a", "wall", "b", "table"))


def test_still_targets_are_left_out_and_the_others_keep_everything() -> None:
    whole = tracks()
    kept, dropped = drop_still(whole)
    assert dropped == 2
    assert kept.ids == ("a", "b")
    for new, old in ((0, 0), (1, 2)):
        np.testing.assert_array_equal(
            kept.pixels[kept.target == new], whole.pixels[whole.target == old], strict=True
        )
    np.testing.assert_array_equal(kept.E_S_from_W, whole.E_S_from_W)
    again, none = drop_still(kept)
    assert none == 0
    assert_same(again, kept)


@pytest.mark.parametrize(
    "case",
    [
        {"step_m": 0.001},  # the tool hardly moves either
        {"still_px": 3.0},  # they do move
        {"moving_px": 0.1},  # nothing moves: there is no telling
        {"n": 2},  # too little was seen
    ],
)
def test_where_there_is_a_doubt_all_stay(case: dict[str, float]) -> None:
    whole = tracks(**case)  # type: ignore[arg-type]
    kept, dropped = drop_still(whole)
    assert dropped == 0
    assert kept is whole


def test_no_observations_are_no_trouble() -> None:
    nothing = tracks().select(np.zeros(0, np.int64))
    assert drop_still(nothing) == (nothing, 0)


@pytest.mark.parametrize(("mounting", "ids"), [("eye_to_hand", ("tool",)), ("eye_in_hand", ("tool", "wall"))])
def test_it_is_a_repair_of_eye_to_hand_recordings_alone(tmp_path, mounting, ids) -> None:
    times, poses = moving_robot(10)
    with File(tmp_path / "a.mcap") as file:
        for i, ns in enumerate(times.tolist()):
            file.pose(ns, poses.position_m[i], poses.quaternion_xyzw[i])
            seen = [("tool", [50.0 + 9 * i, 80.5], [40.0 + 8 * i, 80.5]), ("wall", [300, 30], [280.5, 30])]
            file.tracks(track_message(ns, seen), ns)
    data = read_at(tmp_path / "a.mcap", mounting)
    assert data.tracks.ids == ids
    assert losses(data) == ""
    assert len(data.repairs) == (mounting == "eye_to_hand")
    for repair in data.repairs:
        assert (repair.place, repair.count) == ("/tracks", 1)
        assert "stand still while the tool moves" in repair.what


def test_other_keys_of_a_track_are_passed_over(tmp_path) -> None:
    times, poses = moving_robot(5)
    for name, more in (("plain", {}), ("quality", {"quality": 0.87, "colour": "red"})):
        with File(tmp_path / f"{name}.mcap") as file:
            for i, ns in enumerate(times.tolist()):
                file.pose(ns, poses.position_m[i], poses.quaternion_xyzw[i])
                message = track_message(ns, [("a", [1.5 * i, 2.0], [3.0, 4.1 * i])])
                message["tracks"] = [{**track, **more} for track in message["tracks"]]
                file.tracks(message, ns)
    a, b = (read_at(tmp_path / f"{name}.mcap") for name in ("plain", "quality"))
    assert_same(a.tracks, b.tracks)
    assert not b.losses
