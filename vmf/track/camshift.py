"""CAMShift: mean shift with a window as large as the target."""

from __future__ import annotations

import cv2

from vmf.track.base import Image
from vmf.track.colour import ColourTracker
from vmf.track.meanshift import STOP
from vmf.track.window import Window

_EDGE_PX = 3


class CamshiftTracker(ColourTracker):
    """Moves a window like mean shift, and gives it the size of what it then holds (Bradski 1998)."""

    def _moved(self, weights: Image, window: Window) -> Window:
        x, y, w, h = cv2.CamShift(weights, window, STOP)[1]
        # The window is tight around the target, whose blurred edge belongs to it.
        return int(x) - _EDGE_PX, int(y) - _EDGE_PX, int(w) + 2 * _EDGE_PX, int(h) + 2 * _EDGE_PX
