"""`vmf track`: from a recording's stereo images to a recording of stereo tracks."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml
from pydantic import ValidationError

from vmf.data.images import StereoImages
from vmf.data.recording import TRACKS_TOPIC, schemas
from vmf.data.recording.container import Contents, Topic, messages, scan
from vmf.data.recording.output import Output, check_target
from vmf.data.recording.shown import BODY_TRANSFORM_TOPIC, CAMERA_TRANSFORM_TOPICS
from vmf.data.recording.topics import check_topic
from vmf.data.recording.transforms import UnnamedBody, read_transforms, select
from vmf.data.recording.write_tracks import tracks_writer, written_quality
from vmf.errors import InputError, Loss
from vmf.progress import Report
from vmf.spec import TRACKER_MODELS, ImageSource, settings
from vmf.track import make_tracker
from vmf.track.odometry import Trajectory
from vmf.track.recorded import tracked_frames

_POSES = (*schemas.POSE_SCHEMAS, schemas.JOINT_STATE)
_SHOWN = (BODY_TRANSFORM_TOPIC, *CAMERA_TRANSFORM_TOPICS)


@dataclass(frozen=True)
class TrackingResult:
    """What `vmf track` found.

    Attributes
    ----------
    pairs, frames, empty_frames : stereo pairs, those that were intact, and those of them without a target.
    targets, length_median : names, and observations of each.
    seen_both, seen_left, seen_right : observations by camera; `left` and `right` mean that camera alone.
    quality_median : of all observations.
    copied : topics of poses and joints copied into the output, as its images and calibrations are.
    """

    path: Path
    left: str
    right: str
    pairs: int
    frames: int
    empty_frames: int
    targets: int
    length_median: float
    seen_both: int
    seen_left: int
    seen_right: int
    quality_median: float
    copied: tuple[str, ...]
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]

    def lines(self) -> list[str]:
        """Return the result as lines of text."""
        poses = ", ".join(self.copied) or "none: it needs poses to be trained on"
        return [
            f"{self.path}: {self.frames} frames of {TRACKS_TOPIC} from {self.left} and {self.right}",
            f"  {self.targets} targets, median {self.length_median:g} observations each; "
            f"seen by both cameras {self.seen_both}, left only {self.seen_left}, "
            f"right only {self.seen_right}; "
            f"median quality {self.quality_median:.3f}; {self.empty_frames} frames without a target",
            f"  poses copied: {poses}",
        ]

    def to_json(self) -> str:
        """Return the result as JSON."""
        listed = {key: [str(loss) for loss in getattr(self, key)] for key in ("losses", "repairs")}
        return json.dumps({**asdict(self), "path": str(self.path), **listed}, indent=2, allow_nan=False)


def image_source(
    tracker: str,
    options: tuple[str, ...],
    left: str | None,
    right: str | None,
    regions: tuple[str, ...] = (),
    pair_tolerance_s: float | None = None,
) -> ImageSource:
    """Return the section `images` of a spec that a command line describes.

    Raises
    ------
    InputError : no such tracker, or settings that it does not take.
    """
    model = TRACKER_MODELS.get(tracker)
    if model is None:
        raise InputError(f"--tracker: found {tracker!r}, accepted: {', '.join(TRACKER_MODELS)}")
    if regions and "regions" not in model.model_fields:
        able = [name for name, m in TRACKER_MODELS.items() if "regions" in m.model_fields]
        raise InputError(f"--region: {tracker} finds its targets itself; --region is for {', '.join(able)}")
    for region in regions:
        numbers = region.split(",")
        if len(numbers) != 4 or not all(_is_number(n) for n in numbers):
            raise InputError(f"--region: found {region!r}, x,y,width,height in pixels are accepted")
    given = (f"regions=[{', '.join(f'[{region}]' for region in regions)}]",) if regions else ()
    chosen = settings(model, (*given, *options))
    content: dict[str, object] = {"left": left, "right": right, "tracker": chosen}
    if pair_tolerance_s is not None:
        content["pair_tolerance_s"] = pair_tolerance_s
    try:
        return ImageSource.model_validate(content)
    except ValidationError as error:
        # The tracker has been checked, and topics may be any text.
        what = error.errors()[0]["msg"]
        raise InputError(f"--pair-tolerance-s: found {pair_tolerance_s}: {what}") from None


def track(
    path: Path,
    output: Path,
    source: ImageSource,
    progress: Report | None = None,
    pose: str | None = None,
) -> TrackingResult:
    """Track what the images of a recording show, and write it with the recording's poses.

    A tracker that needs odometry takes it from the topic `pose`, or from the only one there is.

    Raises
    ------
    InputError : the recording, its topics or the output are wrong, or no target was found.
    """
    check_target(output, "-o", (path,))
    images = StereoImages(path, source)
    if pose is not None:
        _check_pose(images.contents, pose, source)
    lengths: Counter[str] = Counter()
    seen = np.zeros(3, int)
    empty = 0
    quality: Counter[float] = Counter()
    copied = tuple(
        t.name for t, n in images.contents.counts if t.schema in _POSES and n and t.name not in _SHOWN
    )
    with tracks_writer(output, _described(images, source)) as writer:
        others = _Copier(writer.out, images)
        for frame in tracked_frames(
            images, source.tracker, progress, lambda: _trajectory(images.contents, pose)
        ):
            others.until(frame.log_time_ns)
            found = frame.sightings
            left_ns, right_ns = images.stamps_ns[np.searchsorted(images.times_ns, frame.time_ns)].tolist()
            writer.frame(
                frame.time_ns,
                (left_ns, right_ns),
                frame.log_time_ns,
                frame.sizes,
                found.ids,
                found.pixels,
                found.quality,
            )
            lengths.update(found.ids)
            quality.update(written_quality(found.quality))
            empty += not found.ids
            left, right = np.isfinite(found.pixels[:, 0]), np.isfinite(found.pixels[:, 2])
            seen += (left & right).sum(), (left & ~right).sum(), (right & ~left).sum()
        others.until(None)
        losses = images.contents.losses + images.losses
        if not lengths:
            raise InputError(
                f"{path}: {source.tracker.kind} found no target in any of {writer.frames} stereo pairs",
                *map(str, losses),
            )
        frames = writer.frames
    return TrackingResult(
        output,
        images.left,
        images.right,
        len(images),
        frames,
        empty,
        len(lengths),
        float(np.median(list(lengths.values()))),
        int(seen[0]),
        int(seen[1]),
        int(seen[2]),
        _median(quality),
        copied,
        losses,
        images.contents.repairs + images.repairs,
    )


def _median(counts: Counter[float]) -> float:
    """Return the median of values of which each was counted so often."""
    values = np.array(sorted(counts))
    until = np.cumsum([counts[value] for value in values.tolist()])
    middle = np.array([(until[-1] - 1) // 2, until[-1] // 2])
    return float(values[np.searchsorted(until, middle, side="right")].mean())


def _check_pose(contents: Contents, topic: str, source: ImageSource) -> None:
    check_topic(contents, topic, schemas.POSE_SCHEMAS)
    with make_tracker(source.tracker) as tracker:
        needed = tracker.needs_odometry
    if not needed:
        raise InputError(f"--pose: {source.tracker.kind} needs none as set; it is for sift with void_after_m")


class _Copier:
    """Copies images, poses and calibrations, and names the body that poses without a child are of."""

    def __init__(self, out: Output, images: StereoImages) -> None:
        contents = images.contents
        wanted = (images.left, images.right)

        def is_wanted(topic: Topic) -> bool:
            return topic.name in wanted or topic.schema in (*_POSES, *schemas.CALIBRATION_SCHEMAS)

        self._out = out
        self._messages = messages(contents.path, is_wanted)
        self._next = next(self._messages, None)
        self._body = _unnamed_body(contents)

    def until(self, log_time_ns: int | None) -> None:
        """Copy what comes before a time, in the order of the file; None copies all."""
        while self._next is not None and (log_time_ns is None or self._next.log_time_ns <= log_time_ns):
            self._out.copy(self._next)
            if self._body is not None and self._next.topic.name == self._body.topic:
                transform = self._body.transform(self._next)
                if transform is not None:
                    self._out.protobuf(BODY_TRANSFORM_TOPIC, transform, self._next.log_time_ns)
            self._next = next(self._messages, None)


def _unnamed_body(contents: Contents) -> UnnamedBody | None:
    """Return the body of the only poses that do not say what they are of, None where that leaves a doubt."""
    poses = [t for t, n in contents.counts if t.schema in schemas.CHILDLESS_SCHEMAS and n]
    shown = any(t.name == BODY_TRANSFORM_TOPIC for t, _ in contents.counts)
    if len(poses) != 1 or shown:
        return None
    try:
        return UnnamedBody(poses[0])
    except InputError:  # a schema that cannot be parsed is copied all the same
        return None


def _trajectory(contents: Contents, topic: str | None) -> Trajectory:
    """Return the way of the robot by a topic of poses, or the only one there is.

    Raises
    ------
    InputError : there is no such topic, or several; it holds no usable pose, or those of several frames.
    """
    if topic is None:
        topics = [
            t.name
            for t, n in contents.counts
            if t.schema in schemas.POSE_SCHEMAS and n and t.name not in _SHOWN
        ]
        if len(topics) != 1:
            found = ", ".join(topics) or "none"
            raise InputError(
                f"{contents.path}: void_after_m needs one topic with poses (--pose); found: {found}"
            )
        topic = topics[0]
    check_topic(contents, topic, schemas.POSE_SCHEMAS)
    streams, _ = read_transforms(scan(contents.path, lambda t: t.name == topic).on(topic), topic)
    return Trajectory.of(select(streams, None, None, topic))


def _described(images: StereoImages, source: ImageSource) -> str:
    """Return how the tracks are made, as the part of a spec that would make them on the way."""
    resolved = source.model_copy(update={"left": images.left, "right": images.right})
    described = {
        "source": {"file": images.contents.path.name, "sha256": images.contents.sha256},
        "images": resolved.model_dump(mode="json"),
    }
    return str(yaml.safe_dump(described, sort_keys=False))


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
