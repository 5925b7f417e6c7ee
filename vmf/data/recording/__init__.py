"""Recordings in MCAP: read, write, describe."""

from vmf.data.recording.describe import PosesInfo, RecordingInfo, TopicInfo, TracksInfo, describe
from vmf.data.recording.read import RecordingData, read
from vmf.data.recording.write import write

__all__ = [
    "PosesInfo",
    "RecordingData",
    "RecordingInfo",
    "TopicInfo",
    "TracksInfo",
    "describe",
    "read",
    "write",
]
