"""What a recording holds, for `vmf info`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vmf.data.poses import BodyPoses
from vmf.data.recording import schemas
from vmf.data.recording.container import RawMessage, scan
from vmf.data.recording.observations import read_observations
from vmf.data.recording.synchronise import in_order, to_poses
from vmf.data.recording.transforms import read_transforms
from vmf.errors import InputError, Loss
from vmf.geometry import motion

Range = tuple[float, float]


@dataclass(frozen=True)
class TopicInfo:
    """A topic, how it is written, and how many of its messages are readable."""

    name: str
    schema: str
    encoding: str
    count: int


@dataclass(frozen=True)
class TracksInfo:
    """What one topic of stereo tracks holds.

    Attributes
    ----------
    frames, empty_frames : all, and those that show no target.
    length_min, length_median, length_max : observations per target.
    seen_left, seen_right, seen_both : observations by camera; `left` and `right` mean that camera alone.
    left_px, right_px : bounding ranges ((x_min, x_max), (y_min, y_max)), None if nothing was seen.
    """

    topic: str
    frames: int
    empty_frames: int
    targets: int
    length_min: int
    length_median: float
    length_max: int
    seen_left: int
    seen_right: int
    seen_both: int
    left_px: tuple[Range, Range] | None
    right_px: tuple[Range, Range] | None
    image_size: tuple[int, int] | None


@dataclass(frozen=True)
class PosesInfo:
    """One moving frame: number of poses, path length (m), largest rotation from the first pose (rad).

    `turn_rad` adds up the rotations from pose to pose.
    """

    topic: str
    parent: str
    child: str | None
    count: int
    travel_m: float
    turn_rad: float
    rotation_range_rad: float
    box_m: tuple[Range, Range, Range]


@dataclass(frozen=True)
class RecordingInfo:
    """What a recording holds; `lines` says it in words."""

    path: Path
    size_bytes: int
    sha256: str
    start_ns: int | None
    duration_s: float
    topics: tuple[TopicInfo, ...]
    tracks: tuple[TracksInfo, ...]
    poses: tuple[PosesInfo, ...]
    attachments: tuple[str, ...]
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]

    def lines(self) -> list[str]:
        """Return the description as lines of text."""
        start = "" if self.start_ns is None else f", from {self.start_ns / 1e9:.3f} s"
        lines = [f"{self.path}: MCAP, {self.size_bytes} bytes, {self.duration_s:.3f} s{start}"]
        lines += [f"topic {t.name}: {t.schema or 'no schema'}, {t.encoding}, {t.count}" for t in self.topics]
        for tracks in self.tracks:
            lines += _tracks_lines(tracks)
        for p in self.poses:
            frames = f"{p.child or 'body'} in {p.parent or 'unnamed frame'}"
            lines.append(
                f"poses {p.topic}: {p.count} of {frames}, travel {p.travel_m:.3f} m, "
                f"turn {p.turn_rad:.3f} rad, up to {p.rotation_range_rad:.3f} rad from the first"
            )
        lines += [f"attachment {name}" for name in self.attachments]
        lines += [f"repaired: {repair}" for repair in self.repairs]
        lines += [f"lost: {loss}" for loss in self.losses]
        return lines


def describe(path: Path) -> RecordingInfo:
    """Describe the recording at `path`, damaged or not.

    Raises
    ------
    InputError : the file is missing, unreadable, empty or not MCAP.
    """
    described = (schemas.STEREO_TRACKS, *schemas.POSE_SCHEMAS)
    contents = scan(Path(path), lambda topic: topic.schema in described)
    losses, repairs = list(contents.losses), list(contents.repairs)
    tracks: list[TracksInfo] = []
    poses: list[PosesInfo] = []
    for topic, schema in dict.fromkeys(
        (t.name, t.schema) for t, _ in contents.counts if t.schema in described
    ):
        on_it = contents.on(topic, schema)
        try:
            if schema == schemas.STEREO_TRACKS:
                tracks.append(_tracks_info(on_it, topic, losses, repairs))
            else:
                poses += _poses_info(on_it, topic, losses, repairs)
        except InputError as error:  # a description goes on where reading would refuse
            losses.append(Loss(topic, "; ".join(error.lines), 1))
    start, end = contents.span_ns or (None, None)
    return RecordingInfo(
        contents.path,
        contents.path.stat().st_size,
        contents.sha256,
        start,
        0.0 if start is None or end is None else (end - start) / 1e9,
        tuple(TopicInfo(t.name, t.schema, t.encoding, n) for t, n in contents.counts),
        tuple(tracks),
        tuple(poses),
        contents.attachments,
        tuple(losses),
        tuple(repairs),
    )


def _tracks_info(
    messages: Sequence[RawMessage], topic: str, losses: list[Loss], repairs: list[Loss]
) -> TracksInfo:
    seen, lost = read_observations(messages, topic)
    order = in_order(seen.times_ns, topic)
    losses += [*lost, *order.losses]
    repairs += order.repairs
    kept = np.zeros(len(seen.times_ns), bool)
    kept[order.keep] = True
    use = kept[seen.frame]
    pixels, frame = seen.pixels[use], seen.frame[use]
    lengths = np.unique(seen.target[use], return_counts=True)[1]
    left, right = ~np.isnan(pixels[:, 0]), ~np.isnan(pixels[:, 2])
    return TracksInfo(
        topic,
        len(order.keep),
        len(order.keep) - len(np.unique(frame)),
        len(lengths),
        int(lengths.min()) if len(lengths) else 0,
        float(np.median(lengths)) if len(lengths) else 0.0,
        int(lengths.max()) if len(lengths) else 0,
        int((left & ~right).sum()),
        int((right & ~left).sum()),
        int((left & right).sum()),
        _box(pixels[left, :2]),
        _box(pixels[right, 2:]),
        seen.image_size,
    )


def _poses_info(
    messages: Sequence[RawMessage], topic: str, losses: list[Loss], repairs: list[Loss]
) -> Iterator[PosesInfo]:
    streams, lost = read_transforms(messages, topic)
    losses += lost
    for (parent, child), stream in streams.items():
        order = in_order(stream.times_ns, topic)
        losses += order.losses
        repairs += order.repairs
        poses = to_poses(stream.values[order.keep])
        assert isinstance(poses, BodyPoses)
        T = poses.motions("eye_to_hand")
        step = motion.inverse(T[:-1]) @ T[1:]
        x, y, z = ((float(c.min()), float(c.max())) for c in poses.position_m.T)
        yield PosesInfo(
            topic,
            parent,
            child,
            len(T),
            float(np.linalg.norm(step[:, :3, 3], axis=1).sum()),
            float(motion.rotation_angle(step).sum()) if len(step) else 0.0,
            float(motion.rotation_angle(motion.inverse(T[0]) @ T).max()),
            (x, y, z),
        )


def _box(xy: NDArray[np.float64]) -> tuple[Range, Range] | None:
    if not len(xy):
        return None
    low, high = xy.min(axis=0).tolist(), xy.max(axis=0).tolist()
    return (low[0], high[0]), (low[1], high[1])


def _tracks_lines(t: TracksInfo) -> Iterator[str]:
    size = "" if t.image_size is None else f", images {t.image_size[0]}x{t.image_size[1]}"
    frames = f"{t.frames} frames ({t.empty_frames} without a target)"
    yield f"tracks {t.topic}: {frames}, {t.targets} targets{size}"
    yield (
        f"  observations per target: median {t.length_median:g}, from {t.length_min} to {t.length_max}; "
        f"seen by both cameras {t.seen_both}, left only {t.seen_left}, right only {t.seen_right}"
    )
    for camera, box in (("left", t.left_px), ("right", t.right_px)):
        if box is not None:
            (x0, x1), (y0, y1) = box
            yield f"  {camera} pixels: x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
