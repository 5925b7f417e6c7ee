"""Data for the learner: simulated or recorded, always as `Tracks`."""

from vmf.data.poses import BodyPoses, PanTiltJoints, Poses
from vmf.data.tracks import Tracks, from_dense

__all__ = ["BodyPoses", "PanTiltJoints", "Poses", "Tracks", "from_dense"]
