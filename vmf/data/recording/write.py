"""Write tracks and poses as an MCAP recording that reads back bit for bit."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.writer import Writer

from vmf.data.poses import BodyPoses, Poses
from vmf.data.recording import schemas
from vmf.data.recording.observations import TARGETS_KEY
from vmf.data.tracks import Tracks
from vmf.errors import InputError

CHUNK_BYTES = 64 * 1024
SPEC_NAME = "spec.yaml"
TRACKS_TOPIC = "/stereo/tracks"
POSE_TOPIC = "/robot/pose"
JOINTS_TOPIC = "/robot/joints"
# The frame that poses are given in, by mounting: W and B of the method.
FIXED_FRAMES: Mapping[str, str] = MappingProxyType({"eye_in_hand": "world", "eye_to_hand": "base"})
TRUE_TRACKS_TOPIC = "/stereo/true_tracks"
IMAGE_TOPICS = ("/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed")


@dataclass(frozen=True)
class CompressedImages:
    """The left and the right image of every frame, one after the other, as `jpeg` or `png` data."""

    format: str
    pairs: Iterable[tuple[bytes, bytes]]


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
) -> None:
    """Write one pose (or joint) message and one track message per frame; `attachment` is the spec's YAML.

    With `images`, each frame's come behind them. The file appears under its name only when it is complete.

    Raises
    ------
    ValueError : times do not increase from 0 on, or poses and frames differ in number.
    InputError : the file cannot be written.
    """
    path = Path(path)
    times = tracks.times_ns
    motions = poses.position_m if isinstance(poses, BodyPoses) else poses.pan_rad
    if len(motions) != tracks.n_frames:
        raise ValueError(f"{len(motions)} poses for {tracks.n_frames} frames")
    if len(times) and (times[0] < 0 or (np.diff(times) <= 0).any() or times[-1] >= 2**32 * 10**9):
        raise ValueError("frame times must increase and fit a ROS 2 stamp")
    with replacing(path) as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        # The ROS 2 writer has no public way to a JSON channel: its plain writer underneath does.
        plain = writer._writer
        if isinstance(poses, BodyPoses):
            motion_topic = pose_topic
            schema = writer.register_msgdef(schemas.POSE_STAMPED, schemas.POSE_STAMPED_TEXT)
            messages = _pose_messages(poses, tracks, FIXED_FRAMES[mounting])
        else:
            motion_topic = joints_topic
            schema = writer.register_msgdef(schemas.JOINT_STATE, schemas.JOINT_STATE_TEXT)
            messages = _joint_messages(poses.pan_rad, poses.tilt_rad, tracks)
        tracks_schema = plain.register_schema(
            schemas.STEREO_TRACKS, SchemaEncoding.JSONSchema, schemas.STEREO_TRACKS_TEXT.encode()
        )
        channel = plain.register_channel(
            tracks_topic, MessageEncoding.JSON, tracks_schema, {TARGETS_KEY: json.dumps(tracks.ids)}
        )
        image_schema = schema
        if images is not None:
            image_schema = writer.register_msgdef(schemas.COMPRESSED_IMAGE, schemas.COMPRESSED_IMAGE_TEXT)
        shown = _image_messages(images, tracks)
        frames = zip(times.tolist(), messages, _track_messages(tracks), shown, strict=True)
        for i, (time, pose, seen, pictures) in enumerate(frames):
            writer.write_message(motion_topic, schema, pose, log_time=time, sequence=i)
            plain.add_message(channel, time, seen, time, i)
            for topic, picture in pictures:
                writer.write_message(topic, image_schema, picture, log_time=time, sequence=i)
        if attachment is not None:
            start = int(times[0]) if len(times) else 0
            writer.add_attachment(0, start, SPEC_NAME, "application/yaml", attachment.encode())
        writer.finish()  # type: ignore[no-untyped-call]


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Open a temporary file beside `path` that takes its place if all goes well, and vanishes if not."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


def _header(time_ns: int, frame_id: str) -> dict[str, object]:
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": frame_id}


def _pose_messages(poses: BodyPoses, tracks: Tracks, frame_id: str) -> Iterator[dict[str, object]]:
    rows = zip(
        tracks.times_ns.tolist(), poses.position_m.tolist(), poses.quaternion_xyzw.tolist(), strict=True
    )
    for time, position, quaternion in rows:
        pose = {
            "position": dict(zip("xyz", position, strict=True)),
            "orientation": dict(zip("xyzw", quaternion, strict=True)),
        }
        yield {"header": _header(time, frame_id), "pose": pose}


def _joint_messages(pan: np.ndarray, tilt: np.ndarray, tracks: Tracks) -> Iterator[dict[str, object]]:
    for time, *angles in zip(tracks.times_ns.tolist(), pan.tolist(), tilt.tolist(), strict=True):
        yield {
            "header": _header(time, ""),
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
            (topic, {"header": _header(time, topic.split("/")[2]), "format": images.format, "data": data})
            for topic, data in zip(IMAGE_TOPICS, pair, strict=True)
        ]


def _track_messages(tracks: Tracks) -> Iterator[bytes]:
    order = np.lexsort((tracks.target, tracks.frame))
    starts = np.searchsorted(tracks.frame[order], np.arange(tracks.n_frames + 1)).tolist()
    rows = tracks.pixels[order].tolist()
    names = [tracks.ids[k] for k in tracks.target[order].tolist()]
    size = {}
    if tracks.image_size is not None:
        size = {"left_size": list(tracks.image_size), "right_size": list(tracks.image_size)}
    for frame, time in enumerate(tracks.times_ns.tolist()):
        seen = range(starts[frame], starts[frame + 1])
        message = {
            "timestamp": {"sec": time // 10**9, "nsec": time % 10**9},
            **size,
            "tracks": [
                {"id": names[i], "left": pixel_or_null(rows[i][:2]), "right": pixel_or_null(rows[i][2:])}
                for i in seen
            ],
        }
        yield json.dumps(message, allow_nan=False).encode()


def pixel_or_null(xy: list[float]) -> list[float] | None:
    """Return x, y of a pixel as JSON has it: null where it was not seen."""
    return None if xy[0] != xy[0] or xy[1] != xy[1] else xy
