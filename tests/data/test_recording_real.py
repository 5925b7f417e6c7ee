"""The real recordings, where they are at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_files import assert_same

from vmf.data.recording import RecordingData, describe, read, write
from vmf.data.recording.container import scan
from vmf.data.recording.synchronise import to_poses
from vmf.data.recording.transforms import read_transforms
from vmf.spec.model import PoseSource, Recording, TrackSource

POSES = {
    "starry_night.mcap": ("/vicon/rig", "/stereo/tracks", "eye_in_hand"),
    "kitti07.mcap": ("/ins/base_link", "/stereo/tracks", "eye_in_hand"),
    "kitti07_raw.mcap": ("/ins/base_link", "/stereo/tracks", "eye_in_hand"),
    "franka_tag.mcap": ("/franka/tool_pose", "/stereo_01/tracks", "eye_to_hand"),
}


@pytest.fixture(scope="module")
def recordings() -> Path:
    directory = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
    if not (directory / "kitti07.mcap").exists():
        pytest.skip("the real recordings are not next to the repository (../shared/data)")
    return directory


def _read(directory: Path, name: str) -> RecordingData:
    pose, tracks, mounting = POSES[name]
    source = Recording(path=name, pose=PoseSource(topic=pose), tracks=TrackSource(topic=tracks))
    return read(source, mounting, directory)


@pytest.mark.parametrize(
    ("name", "frames", "targets", "observations", "size"),
    [
        ("starry_night.mcap", 1300, 20, 6818, None),
        ("kitti07.mcap", 1101, 7418, 71112, (1226, 370)),
        ("franka_tag.mcap", 80, 1, 80, (640, 480)),
    ],
)
def test_sound_recordings_lose_nothing(
    recordings: Path, name: str, frames: int, targets: int, observations: int, size: tuple[int, int] | None
) -> None:
    data = _read(recordings, name)
    tracks = data.tracks
    assert (tracks.n_frames, tracks.n_targets, len(tracks.frame)) == (frames, targets, observations)
    assert tracks.image_size == size
    assert data.losses == data.repairs == ()
    assert (np.diff(tracks.target * frames + tracks.frame) > 0).all()


def test_the_frozen_tracks_of_kitti_are_found_and_cut_as_published(recordings: Path) -> None:
    raw, published = _read(recordings, "kitti07_raw.mcap"), _read(recordings, "kitti07.mcap").tracks
    assert [repair.count for repair in raw.repairs] == [4196]
    assert raw.losses == ()
    # Names of cut targets differ; which observations belong together, and their order, must not.
    for name in ("times_ns", "E_S_from_W", "frame", "target", "pixels"):
        np.testing.assert_array_equal(getattr(raw.tracks, name), getattr(published, name), err_msg=name)


def test_a_real_recording_written_again_reads_the_same(recordings: Path, tmp_path: Path) -> None:
    data = _read(recordings, "starry_night.mcap")
    contents = scan(data.path, lambda topic: topic.name == "/vicon/rig")
    streams, _ = read_transforms(contents.messages, "/vicon/rig")
    (stream,) = streams.values()
    write(tmp_path / "a.mcap", data.tracks, to_poses(stream.values), "eye_in_hand", pose_topic="/vicon/rig")
    source = Recording(path="a.mcap", pose={"topic": "/vicon/rig"}, tracks={"topic": "/stereo/tracks"})  # type: ignore[arg-type]
    again = read(source, "eye_in_hand", tmp_path)
    assert_same(again.tracks, data.tracks)
    assert again.losses == again.repairs == ()


def test_every_real_recording_can_be_described(recordings: Path) -> None:
    for path in sorted(recordings.glob("*.mcap")):
        info = describe(path)
        assert info.losses == ()
        assert len(info.poses) == 1
        assert len(info.tracks) == ("images" not in path.name)
        assert info.poses[0].travel_m > 3
