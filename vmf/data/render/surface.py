"""A flat picture in space, and its exact projection: a homography."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.data.images import Image

Floats = NDArray[np.float64]

# Pixels of one level in those of the next finer one: centres of squares of four.
_COARSER = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Surface:
    """A picture on a plane.

    Attributes
    ----------
    levels : the picture (h, w, 3), then halved again and again.
    planes : for each level (4, 3), the homogeneous point of a picture pixel `(u, v, 1)`.
    endless : whether the picture goes on beyond its border, mirrored.
    """

    levels: tuple[Image, ...] = field(repr=False)
    planes: tuple[Floats, ...]
    endless: bool = False

    def points(self, pixels: Floats) -> Floats:
        """Return the points (n, 3) of picture pixels (n, 2)."""
        p = np.column_stack([pixels, np.ones(len(pixels))]) @ self.planes[0].T
        return np.asarray(p[:, :3])

    @property
    def outline(self) -> Floats:
        """The corners (4, 2) of the picture in its own pixels."""
        h, w = self.levels[0].shape[:2]
        return np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])

    @property
    def centre(self) -> Floats:
        """The middle (2,) of the picture in its own pixels."""
        return np.asarray(self.outline.mean(axis=0))

    def draw(self, canvas: Image, M: Floats) -> None:
        """Draw what a camera `M` (3, 4), whose image is `canvas`, sees of the surface."""
        scale = _magnification(M @ self.planes[0], self.centre)
        level = min(int(max(0.0, np.floor(-np.log2(scale)))), len(self.levels) - 1)
        picture, H = self.levels[level], M @ self.planes[level]
        height, width = canvas.shape[:2]
        if self.endless:
            cv2.warpPerspective(
                picture,
                H,
                (width, height),
                dst=canvas,
                flags=cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REFLECT,
            )
            return
        corners = apply(M @ self.planes[0], self.outline)
        low = np.clip(np.floor(corners.min(axis=0)) - 1, 0, [width, height]).astype(int)
        high = np.clip(np.ceil(corners.max(axis=0)) + 2, 0, [width, height]).astype(int)
        if (high <= low).any():
            return
        H = np.array([[1.0, 0.0, -low[0]], [0.0, 1.0, -low[1]], [0.0, 0.0, 1.0]]) @ H
        size = (int(high[0] - low[0]), int(high[1] - low[1]))
        seen = cv2.warpPerspective(picture, H, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        whole = np.full(picture.shape[:2], 1.0, np.float32)
        cover = cv2.warpPerspective(whole, H, size, flags=cv2.INTER_LINEAR)[..., None]
        part = canvas[low[1] : high[1], low[0] : high[0]]
        part[:] = np.rint(part + cover * (seen.astype(np.float32) - part))


def make_surface(picture: Image, origin: Floats, across: Floats, down: Floats, endless: bool) -> Surface:
    """Return a picture centred on `origin` (3,), whose sides `across` and `down` (3,) are given in metres."""
    h, w = picture.shape[:2]
    u, v = across / w, down / h
    corner = origin - u * (w - 1) / 2 - v * (h - 1) / 2
    plane = np.column_stack([np.append(u, 0.0), np.append(v, 0.0), np.append(corner, 1.0)])
    levels, planes = zip(*_pyramid(picture, plane), strict=True)
    return Surface(levels, planes, endless)


def _pyramid(picture: Image, plane: Floats) -> Iterator[tuple[Image, Floats]]:
    yield picture, plane
    while min(picture.shape[:2]) >= 16 and picture.shape[0] % 2 == 0 and picture.shape[1] % 2 == 0:
        half = (picture.shape[1] // 2, picture.shape[0] // 2)
        picture = np.asarray(cv2.resize(picture, half, interpolation=cv2.INTER_AREA), np.uint8)
        plane = plane @ _COARSER
        yield picture, plane


def apply(H: Floats, pixels: Floats) -> Floats:
    """Return pixels (n, 2) mapped by a homography (3, 3)."""
    p = np.column_stack([pixels, np.ones(len(pixels))]) @ H.T
    return np.asarray(p[:, :2] / p[:, 2:])


def shows_front(M: Floats, surface: Surface) -> bool:
    """Tell whether all of a surface lies in front of a camera (3, 4), which sees its front."""
    P = np.column_stack([surface.points(surface.outline), np.ones(4)])
    if (P @ M[2] <= 0.0).any():
        return False
    corners = apply(M @ surface.planes[0], surface.outline)
    a, b = corners[1] - corners[0], corners[3] - corners[0]
    return bool(a[0] * b[1] - a[1] * b[0] > 0.0)


def _magnification(H: Floats, at: Floats) -> float:
    """Return how many image pixels one picture pixel is wide around `at` (2,)."""
    step = apply(H, at + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    a, b = step[1] - step[0], step[2] - step[0]
    return float(max(np.sqrt(abs(a[0] * b[1] - a[1] * b[0])), 1e-3))
