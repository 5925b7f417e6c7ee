"""Radial lens distortion: where a pixel of an ideal camera ends up, and which one a real pixel shows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.errors import InputError

Floats = NDArray[np.float64]

# Beyond this an ideal image would have to be absurdly large.
_MOST_MARGIN = 1.0


@dataclass(frozen=True)
class Lens:
    """A camera matrix `K` (3, 3) and the radial coefficients k1, k2 of its lens."""

    K: Floats
    k1: float
    k2: float

    def distorted(self, pixels: Floats) -> Floats:
        """Return where pixels (…, 2) of the ideal camera appear."""
        focal, centre = np.diag(self.K)[:2], self.K[:2, 2]
        xy = (pixels - centre) / focal
        r2 = (xy**2).sum(axis=-1, keepdims=True)
        return np.asarray(xy * (1 + self.k1 * r2 + self.k2 * r2**2) * focal + centre)

    def ideal(self, pixels: Floats) -> Floats:
        """Return the pixels (n, 2) of the ideal camera that appear at `pixels` (n, 2)."""
        rays = cv2.undistortPointsIter(
            np.ascontiguousarray(pixels[:, None]),
            self.K,
            np.array([self.k1, self.k2, 0.0, 0.0]),
            np.eye(3),
            self.K,
            (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9),
        )
        return np.asarray(rays[:, 0], float)

    def margin_px(self, size: tuple[int, int]) -> int:
        """Return how far the ideal image must reach beyond the real one of `size` (width, height).

        Raises
        ------
        InputError : the lens folds the image over itself, or needs far too much.
        """
        w, h = size
        u, v = np.arange(-0.5, w), np.arange(-0.5, h)
        edge = np.concatenate(
            [np.column_stack([u, np.full_like(u, y)]) for y in (-0.5, h - 0.5)]
            + [np.column_stack([np.full_like(v, x), v]) for x in (-0.5, w - 0.5)]
        )
        ideal = self.ideal(edge)
        low, high = ideal.min(axis=0), ideal.max(axis=0)
        beyond = float(max(0.0, *(-low), *(high - np.array(size) + 1)))
        returns = float(np.abs(self.distorted(ideal) - edge).max())
        if not (returns < 1e-3 and beyond <= _MOST_MARGIN * max(size)):
            raise InputError(
                f"data.simulate.images.distortion: found {self.k1:g}, {self.k2:g}; "
                "coefficients that do not fold the image over itself are accepted"
            )
        return int(np.ceil(beyond)) + 2
