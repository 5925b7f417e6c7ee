"""SIFT features of an image, found piece by piece where all of it at once would take too much memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.track.base import Floats, Image

# OpenCV doubles an image and keeps eleven copies of it: some 240 bytes a pixel, in both images at a time.
_MOST_PIXELS, _TILE_PX = 2**21, 1024
# What lies so near to a piece is shown beside it, so that features at its border look as they are.
_AROUND_PX = 128


@dataclass(frozen=True)
class Features:
    """Features of one image: pixels (n, 2), sizes (n,) px, directions (n,) rad, descriptors (n, 128)."""

    pixels: Floats
    sizes: Floats
    directions: Floats
    descriptors: NDArray[np.float32]

    def select(self, which: NDArray[np.int64]) -> Features:
        """Return some of the features."""
        return Features(
            self.pixels[which], self.sizes[which], self.directions[which], self.descriptors[which]
        )

    def __len__(self) -> int:
        return len(self.pixels)

    def linear(self, i: int, size: float, direction: float) -> Floats:
        """Return the turn and scale (2, 2) to feature i from one of another size and direction."""
        angle, scale = self.directions[i] - direction, self.sizes[i] / size
        return np.asarray(scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]))


class FeatureDetector:
    """Finds the strongest SIFT features (Lowe 2004) of an image."""

    def __init__(self, features: int) -> None:
        """Find so many."""
        self._most = features
        # Without precise upscaling OpenCV's features lie off by a quarter of a pixel.
        self._sift = cv2.SIFT.create(features, enable_precise_upscale=True)

    def __call__(self, image: Image) -> Features:
        """Return the features of an image (height, width)."""
        pieces = list(self._pieces(image))
        keys = [key for found, _ in pieces for key in found]
        descriptors = np.concatenate([described for _, described in pieces])
        if len(pieces) > 1:
            strongest = np.argsort([-key.response for key in keys], kind="stable")[: self._most]
            keys, descriptors = [keys[i] for i in strongest], descriptors[strongest]
        return Features(
            np.array([k.pt for k in keys], float).reshape(-1, 2),
            np.array([k.size for k in keys], float),
            np.deg2rad([k.angle for k in keys]),
            descriptors,
        )

    def _pieces(self, image: Image) -> Iterator[tuple[list[cv2.KeyPoint], NDArray[np.float32]]]:
        height, width = image.shape
        if image.size <= _MOST_PIXELS:
            yield self._found(image)
            return
        for top in range(0, height, _TILE_PX):
            for left in range(0, width, _TILE_PX):
                above, before = max(top - _AROUND_PX, 0), max(left - _AROUND_PX, 0)
                part = image[above : top + _TILE_PX + _AROUND_PX, before : left + _TILE_PX + _AROUND_PX]
                keys, descriptors = self._found(np.ascontiguousarray(part))
                for key in keys:
                    key.pt = key.pt[0] + before, key.pt[1] + above
                own = [
                    i
                    for i, (x, y) in enumerate(key.pt for key in keys)
                    if left <= x < left + _TILE_PX and top <= y < top + _TILE_PX
                ]
                yield [keys[i] for i in own], descriptors[own]

    def _found(self, image: Image) -> tuple[list[cv2.KeyPoint], NDArray[np.float32]]:
        keys, descriptors = self._sift.detectAndCompute(image, None)
        if descriptors is None:
            return [], np.zeros((0, 128), np.float32)
        return list(keys), np.asarray(descriptors, np.float32)
