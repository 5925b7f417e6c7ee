"""Corners of ArUco tags."""

from __future__ import annotations

import cv2

from vmf.spec.images import ArucoTracker as Options
from vmf.track.tags import TagTracker


class ArucoTracker(TagTracker):
    """Finds the corners of ArUco tags (Garrido-Jurado et al. 2014), named `tag/corner`."""

    def __init__(self, options: Options) -> None:
        """Take the tags that `options` name."""
        dictionary = getattr(cv2.aruco, f"DICT_{_NAMES.get(options.dictionary, options.dictionary.upper())}")
        super().__init__(dictionary, options.ids, options.min_similarity)


_NAMES = {"original": "ARUCO_ORIGINAL", "mip_36h12": "ARUCO_MIP_36h12"}
