"""Data for the learner: simulated or recorded, always as `Tracks`."""

from vmf.data.poses import BodyPoses, PanTiltJoints, Poses
from vmf.data.query import Query, Truth, join
from vmf.data.tracks import Tracks, from_dense

__all__ = ["BodyPoses", "PanTiltJoints", "Poses", "Query", "Tracks", "Truth", "from_dense", "join"]
