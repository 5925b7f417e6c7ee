"""What colour a target has, by a histogram of hue and saturation, and how much of it an image shows."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.track.base import Image
from vmf.track.window import Window, centred, middle

_BINS, _RANGES = [32, 16], [0, 180, 0, 256]
# Below these a pixel has no colour to speak of.
_LEAST_SATURATION, _LEAST_VALUE = 50, 30


@dataclass(frozen=True)
class Colour:
    """What a target looks like.

    Attributes
    ----------
    weights : (hue, saturation) 0 to 255, how much a colour speaks for the target and against what is around.
    look : (hue, saturation) histogram of a box around the target, sum 1; the first bin counts all grey.
    """

    weights: NDArray[np.float32] = field(repr=False)
    look: NDArray[np.float32] = field(repr=False)


def to_hsv(image: Image) -> Image:
    """Return an RGB image as hue, saturation, value."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2HSV), np.uint8)


def coloured(image: Image) -> Image:
    """Return 255 where a pixel of an HSV image has a colour, 0 where it is grey."""
    low = (0, _LEAST_SATURATION, _LEAST_VALUE)
    return np.asarray(cv2.inRange(image, low, (255, 255, 255)), np.uint8)


def back_projection(image: Image, colour: Colour) -> Image:
    """Return the back-projection (h, w), 0 to 255."""
    projected = cv2.calcBackProject([image], [0, 1], colour.weights, _RANGES, 1.0)
    return np.asarray(cv2.bitwise_and(projected, coloured(image)), np.uint8)


def histogram(image: Image, window: Window) -> NDArray[np.float32]:
    """Return the histogram of a window, sum 1, grey pixels in the first bin."""
    x, y, w, h = window
    part = np.ascontiguousarray(image[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)])
    if not part.size:
        return np.zeros(_BINS, np.float32)
    mask = coloured(part)
    histogram = np.asarray(cv2.calcHist([part], [0, 1], mask, _BINS, _RANGES), np.float32)
    # Hue is a circle: its ends meet when noise is smoothed away.
    around = np.concatenate([histogram[-1:], histogram, histogram[:1]])
    smooth = np.asarray(cv2.GaussianBlur(around, (3, 3), 0.8), np.float32)[1:-1].copy()
    smooth[0, 0] += mask.size - cv2.countNonZero(mask)
    return smooth / max(float(smooth.sum()), 1e-12)


def colour_in(image: Image, window: Window) -> Colour | None:
    """Return the colour of a target in a window, as against what surrounds it; None if all of it is grey."""
    target = histogram(image, window)
    around = histogram(image, centred(middle(window), (2 * window[2], 2 * window[3])))
    target[0, 0] = around[0, 0] = 0.0
    if target.sum() < 0.1:
        return None
    # The surroundings hold the target, a quarter of them.
    beside = np.maximum(4.0 * around - target, 0.0) / 3.0
    share = np.where(target > 0.02 * target.max(), target / np.maximum(target + beside, 1e-12), 0.0)
    return Colour((255.0 * share).astype(np.float32), target)
