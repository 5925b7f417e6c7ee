"""Message times: put them in order, and find for every frame the pose that belongs to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.data.poses import BodyPoses, PanTiltJoints, Poses
from vmf.data.recording.transforms import Stream
from vmf.errors import Loss
from vmf.geometry import motion

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

BACKWARD_JUMP_NS = 10**9
GAP_PERIODS = 100
# Poses further apart than this many usual periods say too little about what the robot did between them.
BRACKET_PERIODS = 3


@dataclass(frozen=True)
class Order:
    """Indices (n,) that bring messages into strictly increasing time, and what was noticed on the way."""

    keep: Ints
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]


def in_order(times_ns: Ints, place: str) -> Order:
    """Sort times (N,) in ns, drop the later of two messages with the same, report jumps of the clock."""
    keep = np.argsort(times_ns, kind="stable")
    times = times_ns[keep]
    repeated = np.zeros(len(times), bool)
    repeated[1:] = times[1:] == times[:-1]
    keep, times = keep[~repeated], times[~repeated]
    gaps = np.diff(times)
    found = {
        "messages with the stamp of an earlier one dropped": int(repeated.sum()),
        "clock jumps back by more than 1 s": int((np.diff(times_ns) < -BACKWARD_JUMP_NS).sum()),
        f"gaps in time of more than {GAP_PERIODS} median periods (clock jump or pause)": (
            int((gaps > GAP_PERIODS * np.median(gaps)).sum()) if len(gaps) else 0
        ),
    }
    late = int((times_ns[1:] < np.maximum.accumulate(times_ns)[:-1]).sum())
    return Order(
        keep,
        tuple(Loss(place, what, n) for what, n in found.items() if n),
        (Loss(place, "messages out of time order sorted", late),) if late else (),
    )


def to_poses(values: Floats) -> Poses:
    """Return body poses from values (N, 7), pan-tilt joints from values (N, 2), bits unchanged."""
    if values.shape[1] == 2:
        return PanTiltJoints(values[:, 0], values[:, 1])
    return BodyPoses(values[:, :3], values[:, 3:])


def join_nearest(
    stream: Stream, at_ns: Ints, mounting: str, tolerance_ns: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the motions (n, 4, 4) of the poses nearest in time, and which frames (F,) have one.

    `stream` and `at_ns` (F,) are in time order.
    """
    right = np.clip(np.searchsorted(stream.times_ns, at_ns), 1, max(len(stream.times_ns) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(stream.times_ns) - 1)
    to_left, to_right = np.abs(at_ns - stream.times_ns[left]), np.abs(stream.times_ns[right] - at_ns)
    nearest = np.where(to_right < to_left, right, left)
    matched = np.minimum(to_left, to_right) <= tolerance_ns
    return to_poses(stream.values[nearest[matched]]).motions(mounting), matched


def join_interpolated(
    stream: Stream, at_ns: Ints, mounting: str, tolerance_ns: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the motions (n, 4, 4) between the poses around each frame, and which frames (F,) have them.

    Joints are interpolated linearly, poses on SE(3). The poses around a frame must not be further apart than
    the tolerance allows on both sides, or than `BRACKET_PERIODS` usual periods.
    """
    times = stream.times_ns
    after = np.searchsorted(times, at_ns)
    exact = after < len(times)
    exact[exact] = times[after[exact]] == at_ns[exact]
    inside = (after > 0) & (after < len(times))
    right = np.clip(after, 0, len(times) - 1)
    left = np.where(exact, right, np.maximum(right - 1, 0))
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    close = times[right] - times[left] <= max(2 * tolerance_ns, BRACKET_PERIODS * period)
    matched = exact | (inside & close)
    at, left, right = at_ns[matched], left[matched], right[matched]
    if stream.values.shape[1] == 2:
        share = (at - times[left]) / np.where(right > left, times[right] - times[left], 1)
        between = stream.values[left] + share[:, None] * (stream.values[right] - stream.values[left])
        return to_poses(between).motions(mounting), matched
    # The exact ones are taken as they are, so that a written recording comes back bit for bit.
    E = to_poses(stream.values).motions(mounting)
    result = E[left]
    moving = right > left
    if moving.any():
        result[moving] = motion.interpolate(times, E, at[moving])
    return result, matched
