"""Align a picture with part of an image (enhanced correlation coefficient, Evangelidis and Psarakis 2008)."""

from __future__ import annotations

import math
from typing import cast

import cv2
import numpy as np

from vmf.track.base import Floats, Image

_MARGIN = 6
_SMOOTHING = 3
# Without a mask; OpenCV's types have no word for it.
_EVERYWHERE = cast(Image, None)
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 25, 1e-4)


def aligned(picture: Image, image: Image, guess: Floats) -> tuple[Floats, float] | None:
    """Return the warp that takes a picture to where the image looks like it, and their correlation.

    `guess` is a first one: affine (2, 3), or a homography (3, 3). None where nothing alike is near. Gain and
    offset of the brightness do not count.
    """
    window = _around(picture, image, guess)
    if window is None:
        return None
    left, top, right, bottom = window
    start = _shifted(guess, -left, -top).astype(np.float32)
    motion = cv2.MOTION_AFFINE if len(guess) == 2 else cv2.MOTION_HOMOGRAPHY
    part = image[top:bottom, left:right]
    try:
        similarity, found = cv2.findTransformECC(picture, part, start, motion, _STOP, _EVERYWHERE, _SMOOTHING)
    except cv2.error:
        return None  # OpenCV's way to say that there is nothing alike
    warp = _shifted(np.asarray(found, float), left, top)
    return (warp, float(similarity)) if np.isfinite(warp).all() else None


def _around(picture: Image, image: Image, guess: Floats) -> tuple[int, int, int, int] | None:
    """Return the window of the image around where a guess puts a picture, None if too little is inside.

    Done for every target in every image: numbers, not arrays, for the sake of time.
    """
    h, w = picture.shape[:2]
    rows = guess.tolist()
    xs, ys = [], []
    (a, b, c), (d, e, f) = rows[:2]
    for u, v in ((0, 0), (w - 1, 0), (w - 1, h - 1), (0, h - 1)):
        depth = 1.0
        if len(rows) == 3:
            depth = rows[2][0] * u + rows[2][1] * v + rows[2][2]
            if not depth > 0.0:
                return None
        xs.append((a * u + b * v + c) / depth)
        ys.append((d * u + e * v + f) / depth)
    # Of four numbers any that is none, or none of size, makes their sum so.
    if not math.isfinite(sum(xs) + sum(ys)):
        return None
    left, top = max(math.floor(min(xs)) - _MARGIN, 0), max(math.floor(min(ys)) - _MARGIN, 0)
    right = min(math.ceil(max(xs)) + _MARGIN + 1, image.shape[1])
    bottom = min(math.ceil(max(ys)) + _MARGIN + 1, image.shape[0])
    return (left, top, right, bottom) if min(right - left, bottom - top) >= 2 * _MARGIN else None


def warped(warp: Floats, pixels: Floats) -> Floats:
    """Return pixels (n, 2) taken by an affine warp (2, 3) or a homography (3, 3)."""
    p = np.column_stack([pixels, np.ones(len(pixels))]) @ warp.T
    return p if len(warp) == 2 else np.asarray(p[:, :2] / p[:, 2:])


def _shifted(warp: Floats, x: int, y: int) -> Floats:
    shifted = warp.copy()
    if len(warp) == 2:
        shifted[0, 2] += x
        shifted[1, 2] += y
    else:
        shifted[:2] += np.outer((x, y), warp[2])
    return shifted
