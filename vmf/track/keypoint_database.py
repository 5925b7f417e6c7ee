"""The keypoints known so far, as the thesis keeps them (§5.5): each with where it was seen last.

Odometry drifts, so a keypoint says less and less about where the robot is: after a set distance travelled its
matches are void, and what looks like it is a new keypoint.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.track.base import Bools, Floats, Odometry
from vmf.track.patch import Patch

Descriptors = NDArray[np.float32]

# Where a robot does not travel nothing is ever void: of more, what was not seen for longest is forgotten.
MOST_KEYPOINTS = 5_000
# Descriptors, of length 512, nearer than this may be the same feature's.
_ALIKE = 220.0


@dataclass(frozen=True)
class Look:
    """What a keypoint looked like at first: a patch, its size (px) and direction (rad), in which region."""

    patch: Patch
    size: float
    direction: float
    region: int


@dataclass(frozen=True)
class Keypoint:
    """An entry of the database.

    Attributes
    ----------
    descriptors : (2, 128) newest in the left and the right image.
    code : (4,) most recent pixels `x_L, y_L, x_R, y_R`.
    stamp : most recent pose, and the distance travelled until then; None without odometry.
    seen : the frame in which it was last seen.
    expected : (2,) left pixel, or where it should be if it moves like its neighbours since.
    """

    name: str
    look: Look
    descriptors: Descriptors = field(repr=False)
    code: Floats
    stamp: Odometry | None
    seen: int
    expected: Floats


@dataclass(frozen=True)
class Match:
    """A keypoint seen again: the entry as it was, and the newest pixels (4,) and pose."""

    before: Keypoint
    code: Floats
    stamp: Odometry | None


class KeypointDatabase:
    """Keypoints by number, as long as they are remembered.

    Attributes
    ----------
    keypoints : the entries; an entry keeps its number within a frame.
    matches : what was seen again in this frame: a learner that pairs only these works as in the thesis.
    """

    def __init__(self, memory_frames: int, void_after_m: float | None) -> None:
        """Forget what was not seen for some frames, or if `void_after_m` is given, for so much travel."""
        self._memory_frames, self._void_after_m = memory_frames, void_after_m
        self.keypoints: list[Keypoint] = []
        self.matches: list[Match] = []
        self._names = count()
        self._frame = 0
        self._now: Odometry | None = None

    def begin(self, now: Odometry | None) -> None:
        """Begin the next frame, and void what was seen too far away.

        Raises
        ------
        ValueError : there is no odometry, and matches become void by it.
        """
        if self._void_after_m is not None and now is None:
            raise ValueError("matches become void by distance travelled, which needs odometry")
        self._frame += 1
        self._now = now
        self.matches = []
        kept = [k for k in self.keypoints if not self._void(k)]
        if len(kept) > MOST_KEYPOINTS:
            newest = np.argsort([-k.seen for k in kept], kind="stable")[:MOST_KEYPOINTS]
            kept = [kept[i] for i in np.sort(newest).tolist()]
        self.keypoints = kept

    def descriptors(self, camera: int) -> Descriptors:
        """Return the descriptors (n, 128) in one camera."""
        return np.array([k.descriptors[camera] for k in self.keypoints], np.float32).reshape(-1, 128)

    def distinctive(self, descriptors: Descriptors) -> Bools:
        """Tell which descriptors (n, 128) in the left image are unlike those of all keypoints."""
        known = self.descriptors(0)
        if not len(descriptors) or not len(known):
            return np.ones(len(descriptors), bool)
        nearest = cv2.BFMatcher(cv2.NORM_L2).match(descriptors, known)
        return np.array([m.distance > _ALIKE for m in nearest])

    def recent(self, number: int) -> bool:
        """Tell whether a keypoint was seen so lately that where it should be is known."""
        return self._lately(self.keypoints[number])

    def in_sight(self) -> Bools:
        """Tell which keypoints (n,) were seen in this frame."""
        return np.array([k.seen == self._frame for k in self.keypoints], bool)

    def again(self, number: int, descriptors: Descriptors, code: Floats) -> None:
        """Note that a keypoint was seen again."""
        before = self.keypoints[number]
        self.matches.append(Match(before, code, self._now))
        self.keypoints[number] = replace(
            before,
            descriptors=descriptors,
            code=code,
            stamp=self._now,
            seen=self._frame,
            expected=code[:2],
        )

    def expect(self, number: int, pixel: Floats) -> None:
        """Note where a keypoint that was not seen should be in the left image."""
        self.keypoints[number] = replace(self.keypoints[number], expected=pixel)

    def add(self, look: Look, descriptors: Descriptors, code: Floats) -> str:
        """Enter a new keypoint and return its name."""
        name = str(next(self._names))
        self.keypoints.append(Keypoint(name, look, descriptors, code, self._now, self._frame, code[:2]))
        return name

    def _lately(self, keypoint: Keypoint) -> bool:
        return self._frame - keypoint.seen <= self._memory_frames + 1

    def _void(self, keypoint: Keypoint) -> bool:
        if self._void_after_m is None:
            return not self._lately(keypoint)
        assert self._now is not None
        assert keypoint.stamp is not None
        return self._now.travelled_m - keypoint.stamp.travelled_m > self._void_after_m
