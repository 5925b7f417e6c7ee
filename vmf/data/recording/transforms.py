"""Pose messages of six kinds, all brought to one: the pose of a child frame in a parent frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from numpy.typing import NDArray

from vmf.data.poses import NORM_TOLERANCE
from vmf.data.recording import schemas
from vmf.data.recording.container import RawMessage, Topic
from vmf.data.recording.damage import DamagedError, fields, reason
from vmf.data.recording.foxglove import frame_transform
from vmf.data.recording.messages import decoder, listed, number, stamp_ns, text, usable
from vmf.errors import InputError, Loss
from vmf.geometry import motion

# What poses are called the poses of where they do not say it.
UNNAMED_BODY = "body"

Pair = tuple[str, str | None]


@dataclass(frozen=True)
class Stream:
    """Poses of one child in one parent in file order.

    Attributes
    ----------
    times_ns : (N,) int64.
    values : (N, 7) position x y z (m) and quaternion x y z w as stored, or (N, 2) pan, tilt (rad).
    """

    times_ns: NDArray[np.int64]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class _Transform:
    pair: Pair
    time_ns: int
    values: tuple[float, ...]
    index: int

    @property
    def norm(self) -> float:
        """Norm of the quaternion."""
        return math.hypot(*self.values[3:])

    @property
    def turned(self) -> bool:
        """Whether the quaternion is one of a rotation."""
        return abs(self.norm - 1.0) <= NORM_TOLERANCE


def read_transforms(
    messages: Sequence[RawMessage], place: str
) -> tuple[dict[Pair, Stream], tuple[Loss, ...]]:
    """Return the poses of every (parent, child) pair; child is None where the schema names none.

    Raises
    ------
    InputError : a quaternion whose norm is off 1 by more than `NORM_TOLERANCE`.
    """
    by_pair: dict[Pair, list[_Transform]] = {}
    malformed, why, invalid = 0, "", 0
    for transforms in _decoded(messages):
        if isinstance(transforms, DamagedError):
            malformed, why = malformed + 1, why or reason(transforms)
            continue
        for transform in transforms:
            if not usable(*transform.values):
                invalid += 1
                continue
            if not transform.turned:
                raise InputError(
                    f"{place}: message {transform.index} has a quaternion of norm {transform.norm:.6g}; "
                    f"expected 1 within {NORM_TOLERANCE:g}"
                )
            by_pair.setdefault(transform.pair, []).append(transform)
    losses = []
    if malformed:
        losses.append(Loss(place, f"malformed pose messages dropped; first: {why}", malformed))
    if invalid:
        losses.append(Loss(place, "poses with NaN, infinite or absurd values dropped", invalid))
    return {pair: _stream(transforms) for pair, transforms in by_pair.items()}, tuple(losses)


def select(streams: dict[Pair, Stream], parent: str | None, child: str | None, place: str) -> Stream:
    """Return the one stream that fits the `parent` and `child` asked for.

    Raises
    ------
    InputError : none fits, or more than one; the pairs present are listed. A child is asked for of poses
        that name none.
    """
    if child is not None and all(present is None for _, present in streams):
        raise InputError(
            f"{place}: its poses name no child frame, found child: {child} in the spec; none is accepted"
        )
    fitting = [pair for pair in streams if _fits(pair, parent, child)]
    if len(fitting) == 1:
        return streams[fitting[0]]
    present = ", ".join(f"parent {p or '(unnamed)'} child {c or '(unnamed)'}" for p, c in streams)
    if not fitting:
        raise InputError(f"{place}: no transform with parent {parent}, child {child}; present: {present}")
    raise InputError(f"{place}: several transforms; give parent and child; present: {present}")


class UnnamedBody:
    """What the poses of a topic are of, where they do not say it, as a frame for Foxglove."""

    def __init__(self, topic: Topic) -> None:
        """Read the poses of a topic.

        Raises
        ------
        InputError : its schema cannot be parsed.
        """
        self.topic = topic.name
        self._read = _READERS[topic.schema]
        self._decode = decoder(topic)

    def transform(self, message: RawMessage) -> FrameTransform | None:
        """Return where the body is, None where the message is damaged."""
        try:
            (pose,) = self._read(self._decode(message.data), message)
        except DamagedError:
            return None
        if not usable(*pose.values) or not pose.turned:
            return None
        T = motion.from_quaternion(np.array(pose.values[:3]), np.array(pose.values[3:]))
        return frame_transform(T, pose.pair[0], UNNAMED_BODY, pose.time_ns)


def _fits(pair: Pair, parent: str | None, child: str | None) -> bool:
    return (parent is None or _name(pair[0]) == _name(parent)) and (
        child is None or (pair[1] is not None and _name(pair[1]) == _name(child))
    )


def _name(frame: str) -> str:
    return frame.lstrip("/")  # tf's old habit; tf2 dropped it


def _stream(transforms: list[_Transform]) -> Stream:
    return Stream(
        np.array([t.time_ns for t in transforms], np.int64), np.array([t.values for t in transforms], float)
    )


def _decoded(messages: Sequence[RawMessage]) -> Iterator[list[_Transform] | DamagedError]:
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for message in messages:
        decode = decoders.get(id(message.topic))
        if decode is None:
            decode = decoders[id(message.topic)] = decoder(message.topic)
        try:
            found = _READERS[message.topic.schema](decode(message.data), message)
        except DamagedError as error:
            yield error
        else:
            yield found


_POSITION, _ORIENTATION = fields("x", "y", "z"), fields("x", "y", "z", "w")
_POSE_STAMPED = fields("header.stamp", "header.frame_id", "pose.position", "pose.orientation")
_TRANSFORM_STAMPED = fields(
    "header.stamp", "header.frame_id", "child_frame_id", "transform.translation", "transform.rotation"
)
_TF_MESSAGE = fields("transforms")
_ODOMETRY = fields(
    "header.stamp", "header.frame_id", "child_frame_id", "pose.pose.position", "pose.pose.orientation"
)
_POSE_IN_FRAME = fields("timestamp", "frame_id", "pose.position", "pose.orientation")
_FRAME_TRANSFORM = fields("timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation")


def _transform(
    message: RawMessage, stamp: object, pair: Pair, position: object, orientation: object
) -> _Transform:
    values = tuple(map(number, (*_POSITION(position), *_ORIENTATION(orientation))))
    return _Transform(pair, stamp_ns(stamp, message.log_time_ns), values, message.index)


def _of_unnamed(raw: RawMessage, stamp: object, parent: object, *pose: object) -> list[_Transform]:
    return [_transform(raw, stamp, (text(parent), None), *pose)]


def _of_named(
    raw: RawMessage, stamp: object, parent: object, child: object, *pose: object
) -> list[_Transform]:
    return [_transform(raw, stamp, (text(parent), text(child)), *pose)]


def _pose_stamped(m: object, raw: RawMessage) -> list[_Transform]:
    return _of_unnamed(raw, *_POSE_STAMPED(m))


def _transform_stamped(m: object, raw: RawMessage) -> list[_Transform]:
    return _of_named(raw, *_TRANSFORM_STAMPED(m))


def _tf_message(m: object, raw: RawMessage) -> list[_Transform]:
    return [transform for one in listed(_TF_MESSAGE(m)) for transform in _transform_stamped(one, raw)]


def _odometry(m: object, raw: RawMessage) -> list[_Transform]:
    return _of_named(raw, *_ODOMETRY(m))


def _pose_in_frame(m: object, raw: RawMessage) -> list[_Transform]:
    return _of_unnamed(raw, *_POSE_IN_FRAME(m))


def _frame_transform(m: object, raw: RawMessage) -> list[_Transform]:
    return _of_named(raw, *_FRAME_TRANSFORM(m))


_READERS: dict[str, Callable[[Any, RawMessage], list[_Transform]]] = {
    schemas.POSE_STAMPED: _pose_stamped,
    schemas.TRANSFORM_STAMPED: _transform_stamped,
    schemas.TF_MESSAGE: _tf_message,
    schemas.ODOMETRY: _odometry,
    schemas.POSE_IN_FRAME: _pose_in_frame,
    schemas.FRAME_TRANSFORM: _frame_transform,
}
