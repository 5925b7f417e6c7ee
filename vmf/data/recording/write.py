"""Write tracks and poses as an MCAP recording that reads back bit for bit."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from vmf.data.poses import BodyPoses, Poses
from vmf.data.recording import schemas
from vmf.data.recording.encode import compressed_image, header, pose_stamped, stereo_tracks
from vmf.data.recording.foxglove import Camera
from vmf.data.recording.observations import TARGETS_KEY
from vmf.data.recording.output import Output, output
from vmf.data.recording.shown import (
    CAMERA_FRAMES,
    Frames,
    Observed,
    show_body,
    show_cameras,
    show_targets,
)
from vmf.data.tracks import Tracks

SPEC_NAME = "spec.yaml"
TRACKS_TOPIC = "/stereo/tracks"
POSE_TOPIC = "/robot/pose"
JOINTS_TOPIC = "/robot/joints"
TRUE_TRACKS_TOPIC = "/stereo/true_tracks"
IMAGE_TOPICS = ("/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed")
_NOTHING: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class CompressedImages:
    """The left and the right image of every frame, one after the other, as `jpeg` or `png` data."""

    format: str
    pairs: Iterable[tuple[bytes, bytes]]


@dataclass(frozen=True)
class Extras:
    """What goes with tracks and poses.

    Attributes
    ----------
    about : what the metadata record beside the attached spec says further, such as its hash.
    cameras : the left and the right camera, where their calibration is known.
    """

    about: Mapping[str, str] = field(default_factory=lambda: _NOTHING)
    cameras: tuple[Camera, Camera] | None = None


def write(
    path: Path,
    tracks: Tracks,
    poses: Poses,
    mounting: str,
    *,
    attachment: str | None = None,
    images: CompressedImages | None = None,
    tracks_topic: str = TRACKS_TOPIC,
    pose_topic: str = POSE_TOPIC,
    joints_topic: str = JOINTS_TOPIC,
    extras: Extras | None = None,
) -> None:
    """Write one pose (or joint) message and one track message per frame; `attachment` is the spec's YAML.

    For Foxglove, the body's frame and annotations for both images come with each frame, and with `images`
    the frame's images behind them. The file appears under its name only when it is complete.

    Raises
    ------
    ValueError : times do not increase from 0 on, or poses and frames differ in number.
    InputError : the file cannot be written.
    """
    extras = extras or Extras()
    times = tracks.times_ns
    motions = poses.position_m if isinstance(poses, BodyPoses) else poses.pan_rad
    if len(motions) != tracks.n_frames:
        raise ValueError(f"{len(motions)} poses for {tracks.n_frames} frames")
    if len(times) and (times[0] < 0 or (np.diff(times) <= 0).any() or times[-1] >= 2**32 * 10**9):
        raise ValueError("frame times must increase and fit a ROS 2 stamp")
    frames, observed = Frames.of(mounting), Observed(tracks)
    targets = {TARGETS_KEY: json.dumps(tracks.ids)}
    start = int(times[0]) if len(times) else 0
    with output(Path(path)) as out:
        if extras.cameras is not None:
            show_cameras(out, extras.cameras, frames, start)
        rows = zip(
            times.tolist(),
            poses.motions(mounting),
            _motion_messages(poses, tracks, frames.fixed),
            _track_messages(tracks),
            _image_messages(images, tracks),
            strict=True,
        )
        for i, (time, E_S_from_W, motion, seen, pictures) in enumerate(rows):
            if isinstance(poses, BodyPoses):
                out.ros(pose_topic, schemas.POSE_STAMPED, schemas.POSE_STAMPED_TEXT, motion, time)
            else:
                out.ros(joints_topic, schemas.JOINT_STATE, schemas.JOINT_STATE_TEXT, motion, time)
            out.json(tracks_topic, schemas.STEREO_TRACKS, schemas.STEREO_TRACKS_TEXT, seen, time, targets)
            show_body(out, E_S_from_W, frames, time)
            drawn = [observed.drawn(i)]
            for camera in range(2):
                show_targets(out, drawn, camera, time)
            _write_images(out, pictures, time)
        if attachment is not None:
            out.attach(SPEC_NAME, attachment, start, **extras.about)


def _write_images(out: Output, pictures: Sequence[tuple[str, dict[str, object]]], time_ns: int) -> None:
    for topic, picture in pictures:
        out.ros(topic, schemas.COMPRESSED_IMAGE, schemas.COMPRESSED_IMAGE_TEXT, picture, time_ns)


def _motion_messages(poses: Poses, tracks: Tracks, fixed: str) -> Iterator[dict[str, object]]:
    if isinstance(poses, BodyPoses):
        return _pose_messages(poses, tracks, fixed)
    return _joint_messages(poses.pan_rad, poses.tilt_rad, tracks)


def _pose_messages(poses: BodyPoses, tracks: Tracks, frame_id: str) -> Iterator[dict[str, object]]:
    rows = zip(
        tracks.times_ns.tolist(), poses.position_m.tolist(), poses.quaternion_xyzw.tolist(), strict=True
    )
    for time, position, quaternion in rows:
        yield pose_stamped(time, frame_id, position, quaternion)


def _joint_messages(pan: np.ndarray, tilt: np.ndarray, tracks: Tracks) -> Iterator[dict[str, object]]:
    for time, *angles in zip(tracks.times_ns.tolist(), pan.tolist(), tilt.tolist(), strict=True):
        yield {
            "header": header(time, ""),
            "name": ["pan", "tilt"],
            "position": angles,
            "velocity": [],
            "effort": [],
        }


def _image_messages(
    images: CompressedImages | None, tracks: Tracks
) -> Iterator[list[tuple[str, dict[str, object]]]]:
    """Yield the image messages of every frame, with their topics."""
    times = tracks.times_ns.tolist()
    if images is None:
        yield from ([] for _ in times)
        return
    for time, pair in zip(times, images.pairs, strict=True):
        yield [
            (topic, compressed_image(time, frame, images.format, data))
            for topic, frame, data in zip(IMAGE_TOPICS, CAMERA_FRAMES, pair, strict=True)
        ]


def _track_messages(tracks: Tracks) -> Iterator[dict[str, object]]:
    order = np.lexsort((tracks.target, tracks.frame))
    starts = np.searchsorted(tracks.frame[order], np.arange(tracks.n_frames + 1)).tolist()
    rows = tracks.pixels[order].tolist()
    names = [tracks.ids[k] for k in tracks.target[order].tolist()]
    sizes = None if tracks.image_size is None else (tracks.image_size, tracks.image_size)
    for frame, time in enumerate(tracks.times_ns.tolist()):
        seen = slice(starts[frame], starts[frame + 1])
        yield stereo_tracks(time, sizes, names[seen], rows[seen])
