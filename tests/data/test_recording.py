"""Recordings written and read back, joined by time, and described."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from recording_files import (
    PERIOD_NS,
    START_NS,
    File,
    assert_same,
    example,
    losses,
    moving_robot,
    read_at,
    read_written,
    track_message,
)

from vmf.data.poses import BodyPoses
from vmf.data.recording import describe, schemas, write
from vmf.data.tracks import from_dense
from vmf.errors import InputError
from vmf.geometry import motion


@pytest.mark.parametrize("mounting", ["eye_in_hand", "eye_to_hand"])
@pytest.mark.parametrize("joints", [False, True])
@pytest.mark.parametrize("sync", ["nearest", "interpolate"])
def test_what_is_written_is_read_back_bit_for_bit(
    tmp_path: Path, mounting: str, joints: bool, sync: str
) -> None:
    tracks, poses = example(mounting=mounting, joints=joints)
    write(tmp_path / "a.mcap", tracks, poses, mounting)
    data = read_written(tmp_path / "a.mcap", mounting, joints, sync=sync)
    assert_same(data.tracks, tracks)
    assert data.losses == data.repairs == ()
    write(tmp_path / "b.mcap", data.tracks, poses, mounting)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_recording_that_says_no_image_size_has_none(tmp_path: Path) -> None:
    times, poses = moving_robot(3)
    tracks = from_dense(times, poses.motions("eye_in_hand"), np.full((3, 2, 4), np.nan))
    write(tmp_path / "a.mcap", tracks, poses, "eye_in_hand")
    assert_same(read_written(tmp_path / "a.mcap").tracks, tracks)


def test_the_spec_is_attached_chunks_are_small_and_nothing_else_is_left(tmp_path: Path) -> None:
    tracks, poses = example(1500)
    write(tmp_path / "a.mcap", tracks, poses, "eye_in_hand", attachment="task: planar\n")
    with open(tmp_path / "a.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        attached = list(reader.iter_attachments())
        summary = reader.get_summary()
    assert [(a.name, a.data) for a in attached] == [("spec.yaml", b"task: planar\n")]
    assert summary is not None
    assert max(c.uncompressed_size for c in summary.chunk_indexes) < 70_000
    assert summary.statistics is not None
    # A pose, tracks, the body's frame, and what is drawn over two images, each frame.
    assert summary.statistics.message_count == 5 * 1500
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    tracks, poses = example()
    path = tmp_path / "a.mcap"
    path.write_bytes(b"old")
    bad = from_dense(tracks.times_ns, tracks.E_S_from_W, np.full((40, 1, 4), np.inf))
    with pytest.raises(ValueError, match="JSON"):
        write(path, bad, poses, "eye_in_hand")
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(InputError, match=r"missing.*a\.mcap: cannot be written"):
        write(tmp_path / "missing" / "a.mcap", tracks, poses, "eye_in_hand")
    with pytest.raises(ValueError, match="39 poses"):
        write(path, tracks, BodyPoses(poses.position_m[1:], poses.quaternion_xyzw[1:]), "eye_in_hand")  # type: ignore[union-attr]


def test_ids_come_in_order_of_first_appearance(tmp_path: Path) -> None:
    times, poses = moving_robot(2)
    seen = [[("z", [1, 2], [3, 4])], [("b", [1, 2], None), ("a", None, [1, 2]), ("z", [2, 2], [4, 4])]]
    with File(tmp_path / "a.mcap") as file:
        for i, ns in enumerate(times.tolist()):
            file.pose(ns, poses.position_m[i], poses.quaternion_xyzw[i])
            file.tracks(track_message(ns, seen[i], left_size=[640, 480]), ns)
    tracks = read_at(tmp_path / "a.mcap").tracks
    assert tracks.ids == ("z", "b", "a")
    assert tracks.target.tolist() == [0, 0, 1, 2]
    assert tracks.frame.tolist() == [0, 1, 1, 1]
    assert tracks.image_size == (640, 480)
    np.testing.assert_array_equal(tracks.pixels[2], [1, 2, np.nan, np.nan])


def _shifted(path: Path, shift_ns: int, skip: slice = slice(0)) -> tuple[np.ndarray, BodyPoses]:
    """Write tracks `shift_ns` after the poses, without the poses in `skip`."""
    times, poses = moving_robot(20)
    left_out = set(range(20)[skip])
    with File(path) as file:
        for i, ns in enumerate(times.tolist()):
            if i not in left_out:
                file.pose(ns, poses.position_m[i], poses.quaternion_xyzw[i])
            file.tracks(track_message(ns + shift_ns, [("a", [i, 1], [i, 2])]), ns)
    return times, poses


def test_nearest_takes_the_nearest_pose_within_the_tolerance(tmp_path: Path) -> None:
    shift = 5_000_000
    _, poses = _shifted(tmp_path / "a.mcap", shift, slice(5, 7))
    data = read_at(tmp_path / "a.mcap", sync_tolerance_s=0.006)
    kept = [i for i in range(20) if i not in (5, 6)]
    np.testing.assert_array_equal(data.tracks.E_S_from_W, poses.motions("eye_in_hand")[kept])
    assert data.tracks.pixels[:, 0].tolist() == kept
    assert [loss.count for loss in data.losses] == [2]
    assert "frames without a pose on /pose" in losses(data)
    with pytest.raises(InputError, match="no frame remains"):
        read_at(tmp_path / "a.mcap", sync_tolerance_s=0.004)


@pytest.mark.parametrize("mounting", ["eye_in_hand", "eye_to_hand"])
def test_interpolation_follows_the_screw_between_the_poses_around(tmp_path: Path, mounting: str) -> None:
    shift = 10_000_000
    times, poses = _shifted(tmp_path / "a.mcap", shift, slice(5, 9))
    data = read_at(tmp_path / "a.mcap", mounting, sync="interpolate", sync_tolerance_s=0.001)
    # The last frame has no pose after it; the four missing poses leave a gap of five periods.
    kept = [i for i in range(19) if i not in range(4, 9)]
    assert data.tracks.times_ns.tolist() == (times[kept] + shift).tolist()
    expected = motion.interpolate(times, poses.motions(mounting), times[kept] + shift)
    np.testing.assert_allclose(data.tracks.E_S_from_W, expected, rtol=0, atol=1e-12)
    assert [loss.count for loss in data.losses] == [6]


def test_joints_are_interpolated_linearly(tmp_path: Path) -> None:
    with File(tmp_path / "a.mcap") as file:
        for ns, pan in ((START_NS, 0.0), (START_NS + PERIOD_NS * 2, 0.4)):
            joints = {"name": ["tilt", "pan"], "position": [-pan, pan], "velocity": [], "effort": []}
            stamped = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": ""}
            file.ros("/joints", schemas.JOINT_STATE, {"header": stamped, **joints})
        file.tracks(track_message(START_NS + PERIOD_NS, [("a", [1, 2], [3, 4])]))
    options = {"pose": None, "joints": {"topic": "/joints"}, "sync": "interpolate"}
    E = read_at(tmp_path / "a.mcap", **options).tracks.E_S_from_W
    c, s = np.cos(0.2), np.sin(0.2)
    tilt = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    pan = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(E[0, :3, :3], tilt @ pan, atol=1e-15)


def test_the_recorders_time_stands_in_for_a_stamp_never_set(tmp_path: Path) -> None:
    _, poses = moving_robot(3)
    with File(tmp_path / "a.mcap") as file:
        for i in range(3):
            message = track_message(0, [("a", [i, 1], [i, 2])])
            file.ros("/pose", schemas.POSE_STAMPED, _unstamped(poses, i), START_NS + i)
            file.tracks(message, START_NS + i)
    assert read_at(tmp_path / "a.mcap").tracks.times_ns.tolist() == [START_NS + i for i in range(3)]


def _unstamped(poses: BodyPoses, i: int) -> dict[str, object]:
    from recording_files import pose_stamped

    return pose_stamped(0, poses.position_m[i], poses.quaternion_xyzw[i])


def test_unsorted_frames_are_sorted_and_repeated_stamps_dropped(tmp_path: Path) -> None:
    times, poses = moving_robot(10)
    order = [0, 2, 1, 3, 4, 4, 5, 6, 8, 7, 9]
    with File(tmp_path / "a.mcap") as file:
        for k, i in enumerate(order):
            file.pose(times[i], poses.position_m[i], poses.quaternion_xyzw[i])
            file.tracks(track_message(int(times[i]), [("a", [k, 1], [k, 2])]))
    data = read_at(tmp_path / "a.mcap")
    assert data.tracks.times_ns.tolist() == times.tolist()
    assert data.tracks.pixels[:, 0].tolist() == [0, 2, 1, 3, 4, 6, 7, 9, 8, 10]
    np.testing.assert_array_equal(data.tracks.E_S_from_W, poses.motions("eye_in_hand"))
    assert [(loss.place, loss.count) for loss in data.losses] == [("/pose", 1), ("/tracks", 1)]
    assert [(repair.place, repair.count) for repair in data.repairs] == [("/pose", 2), ("/tracks", 2)]


@pytest.mark.parametrize(
    ("jump_s", "text"), [(100, "gaps in time"), (-100, "clock jumps back by more than 1 s")]
)
def test_a_clock_that_jumps_is_reported_and_reading_goes_on(tmp_path: Path, jump_s: int, text: str) -> None:
    times, poses = moving_robot(20)
    times[10:] += jump_s * 10**9
    with File(tmp_path / "a.mcap") as file:
        for i, ns in enumerate(times.tolist()):
            file.pose(ns, poses.position_m[i], poses.quaternion_xyzw[i])
            file.tracks(track_message(ns, [("a", [i, 1], [i, 2])]))
    data = read_at(tmp_path / "a.mcap")
    assert data.tracks.n_frames == 20
    assert {loss.place for loss in data.losses if text in loss.what} == {"/pose", "/tracks"}


def test_a_recording_is_described_in_words_and_numbers(tmp_path: Path) -> None:
    tracks, poses = example()
    write(tmp_path / "a.mcap", tracks, poses, "eye_in_hand", attachment="task: planar\n")
    info = describe(tmp_path / "a.mcap")
    shown = ("/robot/transform", "/stereo/left/annotations", "/stereo/right/annotations")
    topics = ("/robot/pose", "/stereo/tracks", *shown)
    assert {t.name: t.count for t in info.topics} == dict.fromkeys(topics, 40)
    (seen,), (pose, body) = info.tracks, info.poses
    assert (body.topic, body.parent, body.child) == ("/robot/transform", "world", "body")
    left, right = ~np.isnan(tracks.pixels[:, 0]), ~np.isnan(tracks.pixels[:, 2])
    assert (seen.frames, seen.empty_frames, seen.targets) == (40, 1, 5)
    assert (seen.seen_both, seen.seen_left + seen.seen_right) == ((left & right).sum(), (left ^ right).sum())
    assert seen.left_px is not None
    assert seen.left_px[0] == (np.nanmin(tracks.pixels[:, 0]), np.nanmax(tracks.pixels[:, 0]))
    travel = np.linalg.norm(np.diff(poses.position_m, axis=0), axis=1).sum()  # type: ignore[union-attr]
    assert pose.travel_m == pytest.approx(travel)
    assert info.duration_s == pytest.approx(39 * PERIOD_NS / 1e9)
    assert info.attachments == ("spec.yaml",)
    assert info.losses == ()
    text = "\n".join(info.lines())
    assert "40 frames (1 without a target), 5 targets, images 640x480" in text
    assert "body in world" in text
