"""The first look of a target, and how it is found again to a fraction of a pixel.

Following a point from frame to frame adds up small errors. Aligning its first look with every image, up to
an affine map and a change of brightness, does not: a target that no longer looks like it did is lost
(Shi and Tomasi 1994).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from vmf.track.base import Floats, Image
from vmf.track.ecc import aligned

RADIUS = 10
# A target seen this much larger, smaller or flatter than at first is not the same to a tracker.
_MOST_SCALE, _MOST_SQUEEZE = 3.0, 3.0


@dataclass(frozen=True)
class Patch:
    """A square of 2 · RADIUS + 1 pixels around a target, as it was first seen."""

    look: Image = field(repr=False)


@dataclass(frozen=True)
class Alignment:
    """Where a patch is: `warp` (2, 3) takes its pixels to the image; `similarity` is their correlation."""

    warp: Floats
    similarity: float

    @property
    def pixel(self) -> Floats:
        """The target's pixel (2,)."""
        return centre(self.warp)


def take(image: Image, pixel: Floats) -> Patch:
    """Return the look of the target at a pixel (2,)."""
    side = 2 * RADIUS + 1
    at = (float(pixel[0]), float(pixel[1]))
    return Patch(np.asarray(cv2.getRectSubPix(image, (side, side), at), np.uint8))


def centre(warp: Floats) -> Floats:
    """Return the pixel (2,) that a warp (2, 3) takes a patch's middle to."""
    return np.asarray(warp @ (RADIUS, RADIUS, 1.0))


def placed(linear: Floats, pixel: Floats) -> Floats:
    """Return the warp (2, 3) with a linear part (2, 2) that takes a patch's middle to a pixel (2,)."""
    return np.column_stack([linear, pixel - linear @ (RADIUS, RADIUS)])


def align(patch: Patch, image: Image, guess: Floats, reach_px: float) -> Alignment | None:
    """Return where a patch is near a first `guess` (2, 3), None if not within `reach_px` or nowhere."""
    found = aligned(patch.look, image, guess)
    if found is None or np.linalg.norm(centre(found[0]) - centre(guess)) > reach_px:
        return None
    warp, similarity = found
    largest, smallest = np.linalg.svd(warp[:, :2], compute_uv=False)
    plausible = np.linalg.det(warp[:, :2]) > 0.0 and largest <= _MOST_SQUEEZE * smallest
    if not plausible or largest > _MOST_SCALE or smallest * _MOST_SCALE < 1.0:
        return None
    return Alignment(warp, similarity)
