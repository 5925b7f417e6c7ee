"""Mean shift: the thesis's tracker."""

from __future__ import annotations

import cv2

from vmf.track.base import Image
from vmf.track.colour import ColourTracker
from vmf.track.window import Window

STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.2)


class MeanshiftTracker(ColourTracker):
    """Moves a window of constant size to the middle of what it holds until it stays there (Cheng 1995)."""

    def _moved(self, weights: Image, window: Window) -> Window:
        x, y, w, h = cv2.meanShift(weights, window, STOP)[1]
        return int(x), int(y), int(w), int(h)
