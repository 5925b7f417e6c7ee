"""The topics that show a robot in Foxglove: its frames, its cameras, and targets over what they see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from vmf.data.recording import foxglove
from vmf.data.recording.foxglove import Camera, Drawn
from vmf.data.recording.output import Output
from vmf.data.tracks import Tracks
from vmf.geometry import inverse

Floats = NDArray[np.float64]

CAMERA_FRAMES = ("left", "right")
ANNOTATION_TOPICS = ("/stereo/left/annotations", "/stereo/right/annotations")
CALIBRATION_TOPICS = ("/stereo/left/calibration", "/stereo/right/calibration")
# A topic each: after a jump in time Foxglove shows the last message of every topic.
CAMERA_TRANSFORM_TOPICS = ("/stereo/left/transform", "/stereo/right/transform")
BODY_TRANSFORM_TOPIC = "/robot/transform"
# The frame that poses are given in, by mounting: W and B of the method.
FIXED_FRAMES: Mapping[str, str] = MappingProxyType({"eye_in_hand": "world", "eye_to_hand": "base"})
# What they are the poses of: S of the method, or the tool.
BODY_FRAMES: Mapping[str, str] = MappingProxyType({"eye_in_hand": "body", "eye_to_hand": "tool"})


@dataclass(frozen=True)
class Frames:
    """Names of the frames of a robot.

    Attributes
    ----------
    mounting : what carries the cameras.
    fixed, body : the frame that poses are given in, and the one they are poses of.
    """

    mounting: str
    fixed: str
    body: str

    @classmethod
    def of(cls, mounting: str, fixed: str | None = None) -> Frames:
        """Return the usual names."""
        return cls(mounting, fixed or FIXED_FRAMES[mounting], BODY_FRAMES[mounting])

    @property
    def cameras(self) -> str:
        """The frame S, which the cameras are fixed in."""
        return self.fixed if self.mounting == "eye_to_hand" else self.body

    def pose(self, E_S_from_W: Floats) -> Floats:
        """Return the pose (4, 4) of the body in the fixed frame: `W_T_S`, or `B_T_tool`."""
        return E_S_from_W if self.mounting == "eye_to_hand" else inverse(E_S_from_W)


def show_cameras(
    out: Output, cameras: Sequence[Camera], frames: Frames, time_ns: int, log_time_ns: int | None = None
) -> None:
    """Write where the left and the right camera are, if that is known, and their calibration."""
    for i, camera in enumerate(cameras):
        if camera.E_S_from_camera is not None:
            T = foxglove.frame_transform(camera.E_S_from_camera, frames.cameras, CAMERA_FRAMES[i], time_ns)
            out.protobuf(CAMERA_TRANSFORM_TOPICS[i], T, time_ns if log_time_ns is None else log_time_ns)
        known = foxglove.calibration(camera, cameras[0], CAMERA_FRAMES[i], time_ns)
        out.protobuf(CALIBRATION_TOPICS[i], known, time_ns if log_time_ns is None else log_time_ns)


def show_body(
    out: Output, E_S_from_W: Floats, frames: Frames, time_ns: int, log_time_ns: int | None = None
) -> None:
    """Write where the body is."""
    message = foxglove.frame_transform(frames.pose(E_S_from_W), frames.fixed, frames.body, time_ns)
    out.protobuf(BODY_TRANSFORM_TOPIC, message, time_ns if log_time_ns is None else log_time_ns)


def show_targets(
    out: Output, drawn: Sequence[Drawn], camera: int, time_ns: int, log_time_ns: int | None = None
) -> None:
    """Write what is drawn over the image that a camera took at `time_ns`."""
    message = foxglove.image_annotations(drawn, camera, time_ns)
    out.protobuf(ANNOTATION_TOPICS[camera], message, time_ns if log_time_ns is None else log_time_ns)


class Observed:
    """The targets seen in each frame of some tracks, ready to be drawn."""

    def __init__(self, tracks: Tracks) -> None:
        """Sort the observations by frame."""
        self._order = np.lexsort((tracks.target, tracks.frame))
        self._starts = np.searchsorted(tracks.frame[self._order], np.arange(tracks.n_frames + 1))
        self._tracks = tracks

    def rows(self, frame: int) -> NDArray[np.int64]:
        """Return which observations belong to a frame, by target."""
        return np.asarray(self._order[self._starts[frame] : self._starts[frame + 1]])

    def drawn(self, frame: int) -> Drawn:
        """Return the targets of a frame."""
        rows = self.rows(frame)
        ids = [self._tracks.ids[k] for k in self._tracks.target[rows].tolist()]
        return Drawn(foxglove.OBSERVED, ids, self._tracks.pixels[rows])
