"""Corners of AprilTags."""

from __future__ import annotations

import cv2

from vmf.spec.images import AprilTagTracker as Options
from vmf.track.tags import TagTracker


class AprilTagTracker(TagTracker):
    """Finds the corners of AprilTags (Olson 2011), named `tag/corner`."""

    def __init__(self, options: Options) -> None:
        """Take the tags that `options` name."""
        dictionary = getattr(cv2.aruco, f"DICT_APRILTAG_{options.family}")
        super().__init__(dictionary, options.ids, options.min_similarity)
