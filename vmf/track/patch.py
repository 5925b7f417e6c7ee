"""The first look of a target, and how it is found again to a fraction of a pixel.

Following a point from frame to frame adds up small errors. Aligning its first look with every image, up to
an affine map and a change of brightness, does not: a target that no longer looks like it did is lost
(Shi and Tomasi 1994).
"""

from __future__ import annotations

import math
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
    """Where a patch is.

    Attributes
    ----------
    pixel : (2,) the target.
    linear : (2, 2) how the patch is turned, scaled and sheared.
    similarity : correlation of the patch with what is there.
    """

    pixel: Floats
    linear: Floats
    similarity: float


def take(image: Image, pixel: Floats) -> Patch:
    """Return the look of the target at a pixel (2,)."""
    side = 2 * RADIUS + 1
    at = (float(pixel[0]), float(pixel[1]))
    return Patch(np.asarray(cv2.getRectSubPix(image, (side, side), at), np.uint8))


def align(patch: Patch, image: Image, linear: Floats, pixel: Floats, reach_px: float) -> Alignment | None:
    """Return where a patch is near a first guess, None if not within `reach_px` of it or nowhere."""
    # Done for every target in every image: numbers, not arrays, for the sake of time.
    (a, b), (c, d) = linear.tolist()
    x, y = pixel.tolist()
    guess = np.array([[a, b, x - (a + b) * RADIUS], [c, d, y - (c + d) * RADIUS]])
    found = aligned(patch.look, image, guess)
    if found is None:
        return None
    warp, similarity = found
    (a, b, s), (c, d, t) = warp.tolist()
    at = s + (a + b) * RADIUS, t + (c + d) * RADIUS
    if math.dist(at, (x, y)) > reach_px or not _plausible(a, b, c, d):
        return None
    return Alignment(np.array(at), warp[:, :2], similarity)


def _plausible(a: float, b: float, c: float, d: float) -> bool:
    """Tell whether [[a, b], [c, d]] neither mirrors nor scales or squeezes too much, by singular values."""
    mean, half = math.hypot(a + d, c - b) / 2, math.hypot(a - d, b + c) / 2
    largest, smallest = mean + half, mean - half
    return largest <= min(_MOST_SCALE, _MOST_SQUEEZE * smallest) and smallest * _MOST_SCALE >= 1.0
