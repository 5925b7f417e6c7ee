"""Upright rectangles of whole pixels."""

from __future__ import annotations

import numpy as np

from vmf.track.base import Floats, Image

# x, y of the top-left pixel, width and height.
Window = tuple[int, int, int, int]


def whole(region: tuple[float, float, float, float]) -> Window:
    """Return the whole pixels of a rectangle."""
    x, y, w, h = region
    return round(x), round(y), max(round(w), 1), max(round(h), 1)


def middle(window: Window) -> Floats:
    """Return the middle (2,) of a window."""
    x, y, w, h = window
    return np.array([x + (w - 1) / 2, y + (h - 1) / 2])


def centred(at: Floats, size: tuple[int, int]) -> Window:
    """Return the window of a size (width, height) around a pixel (2,)."""
    w, h = size
    return round(float(at[0]) - (w - 1) / 2), round(float(at[1]) - (h - 1) / 2), w, h


def within(window: Window, image: Image) -> Window | None:
    """Return the part of a window inside an image, None if there is none."""
    x, y = max(window[0], 0), max(window[1], 0)
    w, h = min(window[0] + window[2], image.shape[1]) - x, min(window[1] + window[3], image.shape[0]) - y
    return (x, y, w, h) if w > 0 and h > 0 else None
