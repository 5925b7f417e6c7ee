"""Corners of square tags with a number in them: what ArUco and AprilTag trackers share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np

from vmf.track.base import Floats, Image, Sightings, Tracker, correlation, merged
from vmf.track.ecc import aligned, warped

# Narrowest and widest cell (px), and the white around (in cells), of the picture to compare a tag with.
_CELL_PX = (3, 12)
_MARGIN = 0.5
# Detected corners are off by no more than this, and this share of a side.
_MOST_SHIFT_PX, _MOST_SHIFT = 1.0, 0.03


class TagTracker(Tracker):
    """Finds tags in every image anew; the number in a tag proves that it is the same."""

    def __init__(self, dictionary: int, ids: Sequence[int] | None, min_similarity: float) -> None:
        """Take tags of an OpenCV `dictionary`, of these numbers only where `ids` are given."""
        super().__init__()
        self._dictionary = cv2.aruco.getPredefinedDictionary(dictionary)
        self._ids = None if ids is None else set(ids)
        self._min_similarity = min_similarity
        self._cells = self._dictionary.markerSize + 2
        self._looks: dict[tuple[int, int], Image] = {}
        # One detector for each camera: they work at the same time.
        self._detectors = (
            cv2.aruco.ArucoDetector(self._dictionary, _parameters()),
            cv2.aruco.ArucoDetector(self._dictionary, _parameters()),
        )

    def step(self, left: Image, right: Image) -> Sightings:
        return merged(*self._both(self._corners, self._detectors, (left, right)))

    def _corners(self, detector: cv2.aruco.ArucoDetector, image: Image) -> dict[str, tuple[Floats, float]]:
        squares, numbers, _ = detector.detectMarkers(image)
        listed = [] if numbers is None else [int(n) for n in np.ravel(numbers)]
        times = Counter(listed)
        seen: dict[str, tuple[Floats, float]] = {}
        for square, number in zip(squares, listed, strict=True):
            if (self._ids is not None and number not in self._ids) or times[number] > 1:
                continue  # two tags of one number cannot be told apart
            corners, similarity = self._aligned(image, np.asarray(square, float).reshape(4, 2), number)
            if similarity >= self._min_similarity:
                for i, corner in enumerate(corners):
                    seen[f"{number}/{i}"] = corner, min(similarity, 1.0)
        return seen

    def _aligned(self, image: Image, corners: Floats, number: int) -> tuple[Floats, float]:
        """Return the corners at which a tag looks most like its number, and how much it does.

        All edges of the tag together place its corners better than the few pixels around each. Where they
        do not fit, because the tag is bent or half in shadow, the corners stay as they were detected.
        """
        side_px = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
        cell_px = int(np.clip(round(side_px / self._cells), *_CELL_PX))
        look = self._look(number, cell_px)
        margin = round(_MARGIN * cell_px)
        low, high = margin - 0.5, look.shape[0] - margin - 0.5
        square = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
        before = np.asarray(cv2.getPerspectiveTransform(square, corners.astype(np.float32)), float)
        found = aligned(look, image, before)
        if found is not None:
            moved = warped(found[0], square.astype(float))
            if np.linalg.norm(moved - corners, axis=1).max() <= _MOST_SHIFT_PX + _MOST_SHIFT * side_px:
                return moved, found[1]
        upright = cv2.warpPerspective(
            image, before, look.shape, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        )
        return corners, correlation(np.asarray(upright, np.uint8), look)

    def _look(self, number: int, cell_px: int) -> Image:
        """Return what a tag looks like, with a little white around it."""
        if (number, cell_px) not in self._looks:
            look = cv2.aruco.generateImageMarker(self._dictionary, number, self._cells * cell_px)
            margin = round(_MARGIN * cell_px)
            self._looks[number, cell_px] = np.pad(np.asarray(look, np.uint8), margin, constant_values=255)
        return self._looks[number, cell_px]


def _parameters() -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return parameters
