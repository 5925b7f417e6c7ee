"""Recordings in MCAP: read, write, describe."""

from vmf.data.recording.describe import PosesInfo, RecordingInfo, TopicInfo, TracksInfo, describe
from vmf.data.recording.read import RecordingData, read
from vmf.data.recording.shown import FIXED_FRAMES
from vmf.data.recording.write import (
    IMAGE_TOPICS,
    JOINTS_TOPIC,
    POSE_TOPIC,
    TRACKS_TOPIC,
    TRUE_TRACKS_TOPIC,
    CompressedImages,
    Extras,
    write,
)

__all__ = [
    "FIXED_FRAMES",
    "IMAGE_TOPICS",
    "JOINTS_TOPIC",
    "POSE_TOPIC",
    "TRACKS_TOPIC",
    "TRUE_TRACKS_TOPIC",
    "CompressedImages",
    "Extras",
    "PosesInfo",
    "RecordingData",
    "RecordingInfo",
    "TopicInfo",
    "TracksInfo",
    "describe",
    "read",
    "write",
]
