"""Align a picture with part of an image (enhanced correlation coefficient, Evangelidis and Psarakis 2008)."""

from __future__ import annotations

import cv2
import numpy as np

from vmf.track.base import Floats, Image

_MARGIN = 6
_SMOOTHING = 3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 25, 1e-4)


def aligned(picture: Image, image: Image, guess: Floats) -> tuple[Floats, float] | None:
    """Return the warp that takes a picture to where the image looks like it, and their correlation.

    `guess` is a first one: affine (2, 3), or a homography (3, 3). None where nothing alike is near. Gain and
    offset of the brightness do not count.
    """
    h, w = picture.shape[:2]
    outline = np.array([[0.0, 0.0], [w - 1, 0.0], [w - 1, h - 1], [0.0, h - 1]])
    corners = warped(guess, outline)
    size = np.array(image.shape[1::-1])
    low = np.clip(np.floor(corners.min(axis=0)) - _MARGIN, 0, size).astype(int)
    high = np.clip(np.ceil(corners.max(axis=0)) + _MARGIN + 1, 0, size).astype(int)
    if ((high - low) < 2 * _MARGIN).any():
        return None
    part = image[low[1] : high[1], low[0] : high[0]]
    affine = len(guess) == 2
    start = _shifted(guess, -low).astype(np.float32)
    motion = cv2.MOTION_AFFINE if affine else cv2.MOTION_HOMOGRAPHY
    everywhere = np.full(part.shape, 255, np.uint8)
    try:
        similarity, found = cv2.findTransformECC(picture, part, start, motion, _STOP, everywhere, _SMOOTHING)
    except cv2.error:
        return None  # OpenCV's way to say that there is nothing alike
    warp = _shifted(np.asarray(found, float), low)
    return (warp, float(similarity)) if np.isfinite(warp).all() else None


def warped(warp: Floats, pixels: Floats) -> Floats:
    """Return pixels (n, 2) taken by an affine warp (2, 3) or a homography (3, 3)."""
    p = np.column_stack([pixels, np.ones(len(pixels))]) @ warp.T
    return p if len(warp) == 2 else np.asarray(p[:, :2] / p[:, 2:])


def _shifted(warp: Floats, by: Floats) -> Floats:
    if len(warp) == 2:
        return np.asarray(warp + np.array([[0.0, 0.0, by[0]], [0.0, 0.0, by[1]]]))
    return np.asarray(np.array([[1.0, 0.0, by[0]], [0.0, 1.0, by[1]], [0.0, 0.0, 1.0]]) @ warp)
