"""Read a recording: poses or joints, tracks, joined by time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vmf.data.recording import schemas
from vmf.data.recording.container import Contents, scan
from vmf.data.recording.joints import read_joints
from vmf.data.recording.observations import Observations, from_frames, read_observations
from vmf.data.recording.repair import cut_frozen
from vmf.data.recording.still import drop_still
from vmf.data.recording.synchronise import Floats, Ints, in_order, join_interpolated, join_nearest
from vmf.data.recording.topics import check_topic
from vmf.data.recording.transforms import Stream, read_transforms, select
from vmf.data.tracks import Tracks
from vmf.errors import InputError, Loss
from vmf.progress import Report
from vmf.spec.model import Recording


@dataclass(frozen=True)
class RecordingData:
    """The tracks of a recording, and how it went.

    Attributes
    ----------
    losses : what could not be used; the caller exits 3 if there is any.
    repairs : what was put right without loss: messages sorted, ids of frozen tracks cut.
    sha256 : checksum of the file as it is.
    """

    tracks: Tracks
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]
    sha256: str
    path: Path


def read(source: Recording, mounting: str, base_dir: Path, progress: Report | None = None) -> RecordingData:
    """Read the recording a spec names; a relative path counts from `base_dir`.

    Images are tracked on the way, which takes long enough for a `progress`.

    Raises
    ------
    InputError : the file, a topic, a schema, a frame or joint name is wrong, or no frame is left.
    """
    path = base_dir / source.path
    motion_topic = source.pose.topic if source.pose else source.joints.topic if source.joints else ""
    topics = {motion_topic, source.tracks.topic if source.tracks else ""}
    contents = scan(path, lambda topic: topic.name in topics)
    motion_schemas = schemas.POSE_SCHEMAS if source.pose else (schemas.JOINT_STATE,)
    check_topic(contents, motion_topic, motion_schemas)
    if source.tracks is not None:
        check_topic(contents, source.tracks.topic, (schemas.STEREO_TRACKS,))

    losses, repairs = list(contents.losses), list(contents.repairs)
    with _naming(path):
        stream, lost = _read_motion(source, contents, motion_topic)
    tracked = _observed(source, contents, stream, progress)
    seen, tracks_topic = tracked.seen, tracked.topic
    losses += [*lost, *tracked.losses]
    repairs += tracked.repairs
    order = in_order(stream.times_ns, motion_topic)
    stream = Stream(stream.times_ns[order.keep], stream.values[order.keep])
    losses += order.losses
    repairs += order.repairs
    order = in_order(seen.times_ns, tracks_topic)
    losses += order.losses
    repairs += order.repairs
    times_ns = seen.times_ns[order.keep]
    if not len(times_ns):
        raise InputError(f"{path}: {tracks_topic} holds no usable frame", *map(str, losses))

    join = join_nearest if source.sync == "nearest" else join_interpolated
    E, matched = join(stream, times_ns, mounting, round(source.sync_tolerance_s * 1e9))
    if not matched.all():
        what = (
            f"frames without a pose on {motion_topic} ({source.sync}, {source.sync_tolerance_s:g} s) dropped"
        )
        losses.append(Loss(tracks_topic, what, int((~matched).sum())))
    if not matched.any():
        span = _span(times_ns), _span(stream.times_ns)
        raise InputError(
            f"{path}: no frame remains: {tracks_topic} spans {span[0]}, {motion_topic} {span[1]}",
            *map(str, losses),
        )
    tracks = _assemble(seen, order.keep[matched], E)
    tracks, cut = cut_frozen(tracks, mounting)
    if cut:
        what = "frozen observations dropped (pixels repeated while the robot moves), their ids cut there"
        repairs.append(Loss(tracks_topic, what, cut))
    if mounting == "eye_to_hand":
        tracks, still = drop_still(tracks)
        if still:
            what = "targets left out that stand still while the tool moves, and so are not on it"
            repairs.append(Loss(tracks_topic, what, still))
    return RecordingData(tracks, tuple(losses), tuple(repairs), contents.sha256, path)


@dataclass(frozen=True)
class _Observed:
    """Observations, the topic they come from, and what was lost or repaired in getting them."""

    seen: Observations
    topic: str
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]


def _observed(source: Recording, contents: Contents, stream: Stream, progress: Report | None) -> _Observed:
    """Return what the recording's tracks say, or a tracker of its images."""
    if source.tracks is not None:
        topic = source.tracks.topic
        with _naming(contents.path):
            seen, losses = read_observations(contents.on(topic), topic)
        return _Observed(seen, topic, losses, ())
    assert source.images is not None
    # The trackers need OpenCV, which takes its time to load.
    from vmf.data.images import StereoImages
    from vmf.track.odometry import Trajectory
    from vmf.track.recorded import tracked_frames

    images = StereoImages(contents.path, source.images)
    frames = list(tracked_frames(images, source.images.tracker, progress, lambda: Trajectory.of(stream)))
    seen = from_frames(
        ((f.time_ns, f.sightings.ids, f.sightings.pixels) for f in frames),
        frames[0].sizes[0] if frames else None,
    )
    return _Observed(seen, images.left, images.losses, images.repairs)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Put the file's name in front of what is wrong with one of its topics."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: {error.lines[0]}", *error.lines[1:]) from None


def _read_motion(source: Recording, contents: Contents, topic: str) -> tuple[Stream, tuple[Loss, ...]]:
    messages = contents.on(topic)
    if source.joints is not None:
        return read_joints(messages, source.joints.pan, source.joints.tilt, topic)
    streams, losses = read_transforms(messages, topic)
    if not streams:
        raise InputError(f"{topic} holds no usable pose", *map(str, losses))
    parent, child = (source.pose.parent, source.pose.child) if source.pose else (None, None)
    return select(streams, parent, child, topic), losses


def _assemble(seen: Observations, frames: Ints, E: Floats) -> Tracks:
    """Build the tracks of the frames (n,) chosen, in their order, from observations in file order."""
    new_frame = np.full(len(seen.times_ns), -1)
    new_frame[frames] = np.arange(len(frames))
    keep = new_frame[seen.frame] >= 0
    frame, target = new_frame[seen.frame[keep]], seen.target[keep]
    order = np.lexsort((frame, target))
    return Tracks(
        seen.times_ns[frames],
        E,
        frame[order],
        target[order],
        seen.pixels[keep][order],
        seen.ids,
        seen.image_size,
    )


def _span(times_ns: Ints) -> str:
    return f"{times_ns[0] / 1e9:.3f} s to {times_ns[-1] / 1e9:.3f} s"
