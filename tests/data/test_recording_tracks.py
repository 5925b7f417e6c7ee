"""Bad track messages, and tracks that freeze."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from recording_files import START_NS, File, losses, moving_robot, read_at, track_message

from vmf.data.recording import schemas
from vmf.data.recording.repair import cut_frozen
from vmf.data.tracks import Tracks, from_dense
from vmf.errors import InputError

GOOD = track_message(START_NS, [("a", [1.0, 2.0], [3.0, 4.0])])


def _with(**change: object) -> bytes:
    return json.dumps({**GOOD, **change}).encode()


def _track(**change: object) -> bytes:
    return _with(tracks=[{"id": "a", "left": [1, 2], "right": [3, 4], **change}])


MALFORMED = {
    "not json": b"{",
    "not text": b"\xff\xfe\x00",
    "nested beyond measure": b"[" * 100_000,
    "not an object": b"[]",
    "empty": b"",
    "no timestamp": json.dumps({"tracks": []}).encode(),
    "no tracks": json.dumps({"timestamp": {"sec": 1, "nsec": 0}}).encode(),
    "no nsec": _with(timestamp={"sec": 1}),
    "stamp of text": _with(timestamp={"sec": "1", "nsec": 0}),
    "stamp before 1970": _with(timestamp={"sec": -5, "nsec": 0}),
    "stamp beyond 64 bits": _with(timestamp={"sec": 10**30, "nsec": 0}),
    "tracks of null": _with(tracks=None),
    "track of null": _with(tracks=[None]),
    "no id": _with(tracks=[{"left": None, "right": None}]),
    "id of a number": _track(id=7),
    "id of half a character": _track(id="3\ud800"),
    "no right": _with(tracks=[{"id": "a", "left": [1, 2]}]),
    "one coordinate": _track(left=[1]),
    "three coordinates": _track(left=[1, 2, 3]),
    "coordinate of text": _track(left=["1", 2]),
    "coordinate of null": _track(left=[None, 2]),
    "coordinate beyond floats": _track(left=[10**400, 2]),
    "size of one": _with(left_size=[640]),
    "size of nought": _with(left_size=[640, 0]),
    "size beyond all images": _with(left_size=[640, 2**70]),
}


@pytest.mark.parametrize("message", MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_message_is_dropped_and_counted(tmp_path: Path, message: bytes) -> None:
    with File(tmp_path / "a.mcap") as file:
        file.sound(5)
        file.tracks(message)
    data = read_at(tmp_path / "a.mcap")
    assert data.tracks.n_frames == 5
    assert [(loss.place, loss.count) for loss in data.losses] == [("/tracks", 1)]
    assert "malformed track messages dropped; first: " in losses(data)


def test_nothing_but_malformed_messages_is_refused(tmp_path: Path) -> None:
    with File(tmp_path / "a.mcap") as file:
        file.pose(START_NS, np.zeros(3), np.array([0, 0, 0, 1.0]))
        file.tracks(b"{")
    with pytest.raises(InputError, match=r"/tracks holds no usable frame\n/tracks: malformed"):
        read_at(tmp_path / "a.mcap")


def test_a_pixel_of_nan_costs_that_camera_alone(tmp_path: Path) -> None:
    nan, inf = float("nan"), float("inf")
    tracks = [("a", [1, nan], [3, 4]), ("b", [1, 2], [inf, 4]), ("c", [nan, 2], None), ("d", None, None)]
    with File(tmp_path / "a.mcap") as file:
        file.pose(START_NS, np.zeros(3), np.array([0, 0, 0, 1.0]))
        file.tracks(track_message(START_NS, tracks))
    data = read_at(tmp_path / "a.mcap")
    assert data.tracks.ids == ("a", "b")
    np.testing.assert_array_equal(data.tracks.pixels, [[np.nan, np.nan, 3, 4], [1, 2, np.nan, np.nan]])
    assert [loss.count for loss in data.losses] == [3]


def test_an_id_twice_in_a_frame_and_a_change_of_image_size_are_counted(tmp_path: Path) -> None:
    times, poses = moving_robot(3)
    with File(tmp_path / "a.mcap") as file:
        for i, ns in enumerate(times.tolist()):
            file.pose(ns, poses.position_m[i], poses.quaternion_xyzw[i])
            twice = [("a", [i, 2], [3, 4]), ("a", [9, 9], [9, 9])]
            file.tracks(track_message(ns, twice, left_size=[320 if i == 2 else 640, 480]))
    data = read_at(tmp_path / "a.mcap")
    assert data.tracks.pixels[:, 0].tolist() == [0, 1]
    assert [loss.count for loss in data.losses] == [1, 2]
    assert "another image size than (640, 480)" in losses(data)


def test_messages_on_the_wrong_topic_or_of_the_wrong_kind_are_refused(tmp_path: Path) -> None:
    with File(tmp_path / "a.mcap") as file:
        file.sound(3)
    path = tmp_path / "a.mcap"
    with pytest.raises(InputError) as error:
        read_at(path, tracks={"topic": "/track"})
    assert str(error.value) == (
        f"{path}: no topic /track; did you mean /tracks?; topics present: "
        f"/pose ({schemas.POSE_STAMPED}), /tracks (vmf.StereoTracks)"
    )
    with pytest.raises(InputError, match=r"topic /pose has schema geometry_msgs.*accepted here: vmf\.Stereo"):
        read_at(path, tracks={"topic": "/pose"})
    with pytest.raises(InputError, match=r"topic /tracks has schema vmf.*accepted here: geometry_msgs/msg/P"):
        read_at(path, pose={"topic": "/tracks"})
    with pytest.raises(
        InputError, match=r"topic /pose has schema.*accepted here: sensor_msgs/msg/JointState"
    ):
        read_at(path, pose=None, joints={"topic": "/pose"})


def _freezing(steps_px: float, robot_m: float, decimals: int | None = None) -> Tracks:
    """Return two targets over 12 frames; the first repeats itself at frame 5 and then is another."""
    random = np.random.default_rng(1)
    n = 12
    pixels = np.cumsum(random.uniform(0.5, 1.5, (n, 2, 4)) * steps_px, axis=0) + 100
    pixels[6:, 0] += 50
    if decimals is not None:
        pixels = np.round(pixels * 2) / 2
    pixels[5, 0] = pixels[4, 0]
    E = np.tile(np.eye(4), (n, 1, 1))
    E[:, 0, 3] = robot_m * np.arange(n)
    return from_dense(np.arange(n) * 10**8, E, pixels, ("7", "7#1"))


@pytest.mark.parametrize("mounting", ["eye_in_hand", "eye_to_hand"])
def test_a_frozen_track_is_cut_where_it_froze(mounting: str) -> None:
    tracks = _freezing(5.0, 0.1)
    cut, n = cut_frozen(tracks, mounting)
    assert n == 1
    assert cut.ids == ("7", "7#1", "7#2")  # 7#1 was taken
    assert [cut.frame[cut.target == k].tolist() for k in range(3)] == [
        [0, 1, 2, 3, 4],
        list(range(12)),
        list(range(6, 12)),
    ]
    kept = np.delete(tracks.pixels, 5, axis=0)
    np.testing.assert_array_equal(np.unique(cut.pixels, axis=0), np.unique(kept, axis=0))
    assert cut_frozen(cut, mounting)[1] == 0


def test_a_track_frozen_for_long_loses_every_repetition() -> None:
    tracks = _freezing(5.0, 0.1)
    tracks.pixels[4:8] = tracks.pixels[3]
    cut, n = cut_frozen(tracks, "eye_in_hand")
    assert n == 4
    assert len(cut.ids) == 3
    assert cut.frame[cut.target == 2].tolist() == [8, 9, 10, 11]


def test_a_camera_that_sees_the_target_alone_can_freeze_too() -> None:
    tracks = _freezing(5.0, 0.1)
    tracks.pixels[:, 2:] = np.nan
    assert cut_frozen(tracks, "eye_in_hand")[1] == 1


def test_pixels_that_repeat_while_the_robot_stands_are_left_alone() -> None:
    tracks = _freezing(5.0, 1e-5)
    assert cut_frozen(tracks, "eye_in_hand") == (tracks, 0)


def test_coarse_pixels_that_repeat_by_chance_are_left_alone() -> None:
    assert cut_frozen(_freezing(0.5, 0.1, decimals=0), "eye_in_hand")[1] == 0
    assert cut_frozen(_freezing(5.0, 0.1, decimals=0), "eye_in_hand")[1] == 1


def test_pixels_that_never_move_are_left_alone() -> None:
    tracks = _freezing(5.0, 0.1)
    tracks.pixels[:] = 3.14159
    assert cut_frozen(tracks, "eye_in_hand")[1] == 0
