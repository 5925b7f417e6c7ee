"""The part of the left image in which targets begin, and how it moves along with them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vmf.errors import InputError
from vmf.spec.images import Region as Rectangle
from vmf.track.base import Bools, Floats, Image

_FOR_SIMILARITY = 4


@dataclass(frozen=True)
class Region:
    """A quadrangle with corners (4, 2), in px."""

    corners: Floats

    def moved(self, before: Floats, now: Floats) -> Region:
        """Return the region after points (n, 2) in it moved: with scale and turn if there are enough."""
        if not len(before):
            return self
        if len(before) >= _FOR_SIMILARITY:
            M, _ = cv2.estimateAffinePartial2D(np.ascontiguousarray(before), np.ascontiguousarray(now))
            if M is not None and np.isfinite(M).all():
                return Region(self.corners @ M[:, :2].T + M[:, 2])
        return Region(self.corners + np.median(now - before, axis=0))

    def mask(self, image: Image) -> Image:
        """Return 255 where a pixel of the image is inside, 0 elsewhere."""
        mask = np.zeros(image.shape[:2], np.uint8)
        cv2.fillConvexPoly(mask, np.rint(np.clip(self.corners, -1e4, 1e4)).astype(np.int32), (255,))
        return mask

    def contains(self, pixels: Floats) -> Bools:
        """Tell which pixels (n, 2) are inside."""
        outline = self.corners.astype(np.float32)
        return np.array(
            [cv2.pointPolygonTest(outline, (float(x), float(y)), False) >= 0 for x, y in pixels], bool
        )


def of_rectangle(rectangle: Rectangle) -> Region:
    """Return the region of a rectangle x, y, width, height."""
    x, y, w, h = rectangle
    return Region(np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]]))


def check_shown(rectangles: tuple[Rectangle, ...], image: Image) -> None:
    """Check that each rectangle has a part in the image.

    Raises
    ------
    InputError : one of them lies outside.
    """
    height, width = image.shape[:2]
    for x, y, w, h in rectangles:
        if not (x < width and y < height and x + w > 0.0 and y + h > 0.0):
            raise InputError(
                f"region {x:g},{y:g},{w:g},{h:g}: lies outside of the {width}x{height} image, "
                "x,y,width,height inside are accepted"
            )


def starting(rectangles: tuple[Rectangle, ...], image: Image) -> list[Region]:
    """Return the regions of the first left image: those given, or all of it.

    Raises
    ------
    InputError : one of them lies outside.
    """
    check_shown(rectangles, image)
    height, width = image.shape[:2]
    return [of_rectangle(r) for r in rectangles or ((0.0, 0.0, float(width), float(height)),)]
