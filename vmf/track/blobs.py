"""Blobs of one colour, which is where a target may begin."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np

from vmf.track.base import Floats, Image
from vmf.track.colour_histogram import coloured
from vmf.track.window import Window, middle

# Hues in steps, and areas of blobs.
_HUES, _SMALLEST_PX, _LARGEST_SHARE = 24, 40, 0.2
_MOST_PIXELS = 1920 * 1080


def conspicuous(image: Image) -> Iterator[Window]:
    """Yield windows around blobs of one colour in an HSV image, the most conspicuous first.

    In an image of more than `_MOST_PIXELS`, blobs are looked for in every nth pixel of every nth row: hues
    have no mean, and only where blobs are is asked here.
    """
    step = math.ceil(math.sqrt(image.shape[0] * image.shape[1] / _MOST_PIXELS))
    for x, y, w, h in _blobs(np.ascontiguousarray(image[::step, ::step])):
        yield step * x, step * y, step * w, step * h


def _blobs(image: Image) -> Iterator[Window]:
    anywhere = coloured(image)
    found: list[tuple[float, Window]] = []
    for step in range(_HUES):
        centre = (2 * step + 1) * 180 // (2 * _HUES)
        off = (image[..., 0].astype(np.int16) - centre + 90) % 180 - 90
        mask = np.where(np.abs(off) <= 180 // _HUES, anywhere, 0).astype(np.uint8)
        mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
        n, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
        for k in range(1, n):
            x, y, w, h, area = stats[k].tolist()
            touches = x == 0 or y == 0 or x + w == image.shape[1] or y + h == image.shape[0]
            if touches or not _SMALLEST_PX <= area <= _LARGEST_SHARE * mask.size:
                continue
            saturation = float(image[y : y + h, x : x + w, 1][labels[y : y + h, x : x + w] == k].mean())
            # Compact blobs of strong colour; area counts little, or the background would win.
            found.append((saturation * area / (w * h) * area**0.25, (x, y, w, h)))
    taken: list[Floats] = []
    for _, window in sorted(found, reverse=True):
        at = middle(window)
        if all(np.linalg.norm(at - other) > max(window[2:]) / 2 for other in taken):
            taken.append(at)
            yield window
