"""What every tracker offers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Result = TypeVar("Result")


@dataclass(frozen=True)
class Sightings:
    """Targets seen in one stereo pair.

    Attributes
    ----------
    ids : (n,) names; the same name is the same target, in other pairs too.
    pixels : (n, 4) `x_L, y_L, x_R, y_R` (px), NaN in a camera that did not see the target.
    quality : (n,) from 0 to 1, how surely and how well the tracker found the target.
    """

    ids: tuple[str, ...]
    pixels: Floats
    quality: Floats


@dataclass(frozen=True)
class Odometry:
    """Where the robot is, and how far it has come.

    Attributes
    ----------
    T : (4, 4) pose of the moving frame in the fixed one.
    travelled_m : length of the way until there.
    """

    T: Floats
    travelled_m: float


NOTHING = Sightings((), np.zeros((0, 4)), np.zeros(0))


class Tracker(ABC):
    """Follows targets through stereo pairs given in order of time.

    A name is given to a target once and for all: a target that was lost has its name again only if what is
    seen proves it, else it is a new one. Its threads end with `close`, or with the `with` that it is used in.
    """

    colour: ClassVar[bool] = False  # whether `step` takes RGB images (h, w, 3), not grey ones (h, w)

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(2)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads; nothing is tracked after it."""
        self._pool.shutdown()

    @abstractmethod
    def step(self, left: Image, right: Image) -> Sightings:
        """Return the targets in the next pair."""

    @property
    def needs_odometry(self) -> bool:
        """Whether `moved_to` has to come before each `step`."""
        return False

    def moved_to(self, odometry: Odometry) -> None:  # noqa: B027
        """Hear where the robot is as the next pair is taken; few trackers ask."""

    def _both(
        self, work: Callable[..., Result], *of_left_and_right: tuple[Any, Any]
    ) -> tuple[Result, Result]:
        """Return what `work` makes of each camera's arguments, done at the same time."""
        first, second = self._pool.map(work, *of_left_and_right)
        return first, second


def merged(left: dict[str, tuple[Floats, float]], right: dict[str, tuple[Floats, float]]) -> Sightings:
    """Return what both cameras saw, each a pixel (2,) and a quality by name, as one."""
    ids = tuple(dict.fromkeys([*left, *right]))
    if not ids:
        return NOTHING
    unseen = (np.full(2, np.nan), 1.0)
    seen = [(left.get(name, unseen), right.get(name, unseen)) for name in ids]
    pixels = np.array([np.concatenate([a[0], b[0]]) for a, b in seen])
    return Sightings(ids, pixels, np.array([min(a[1], b[1]) for a, b in seen]))


def inside(pixels: Floats, image: Image, margin: float = 0.0) -> Bools:
    """Tell which pixels (n, 2) lie in an image, at least `margin` px from its border."""
    high = np.array(image.shape[1::-1]) - 1.0 - margin
    return np.asarray(((pixels >= margin) & (pixels <= high)).all(axis=-1))


def correlation(a: Image, b: Image) -> float:
    """Return the normalised correlation of two pictures of one size, 0 where one is even."""
    return float(cv2.matchTemplate(a, b, cv2.TM_CCOEFF_NORMED)[0, 0])
