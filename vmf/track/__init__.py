"""Trackers: from stereo image pairs to the pixels of targets in both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from vmf.spec.images import Tracker as Options
from vmf.track.apriltag import AprilTagTracker
from vmf.track.aruco import ArucoTracker
from vmf.track.base import Sightings, Tracker
from vmf.track.camshift import CamshiftTracker
from vmf.track.chessboard import ChessboardTracker
from vmf.track.klt import KltTracker
from vmf.track.meanshift import MeanshiftTracker
from vmf.track.sift import SiftTracker

TRACKERS: dict[str, Callable[[Any], Tracker]] = {
    "meanshift": MeanshiftTracker,
    "camshift": CamshiftTracker,
    "klt": KltTracker,
    "sift": SiftTracker,
    "aruco": ArucoTracker,
    "apriltag": AprilTagTracker,
    "chessboard": ChessboardTracker,
}


def make_tracker(options: Options) -> Tracker:
    """Return a tracker that has seen nothing yet."""
    return TRACKERS[options.kind](options)


__all__ = ["TRACKERS", "Sightings", "Tracker", "make_tracker"]
