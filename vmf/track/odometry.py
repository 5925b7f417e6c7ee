"""How far the robot has come, for trackers that ask."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.data.poses import BodyPoses
from vmf.data.recording.synchronise import to_poses
from vmf.data.recording.transforms import Stream
from vmf.track.base import Floats, Odometry


@dataclass(frozen=True)
class Trajectory:
    """Poses over time.

    Attributes
    ----------
    times_ns : (N,) increasing.
    T : (N, 4, 4) pose of the moving frame in the fixed one.
    travelled_m : (N,) length of the way until there.
    """

    times_ns: NDArray[np.int64]
    T: Floats
    travelled_m: Floats

    @classmethod
    def of(cls, stream: Stream) -> Trajectory:
        """Return the trajectory of poses, or of joints, which turn but do not travel."""
        order = np.argsort(stream.times_ns, kind="stable")
        poses = to_poses(stream.values[order])
        T = poses.motions("eye_to_hand")
        steps = np.zeros(len(T))
        if isinstance(poses, BodyPoses):
            steps[1:] = np.linalg.norm(np.diff(poses.position_m, axis=0), axis=1)
        return cls(stream.times_ns[order], T, np.cumsum(steps))

    def at(self, time_ns: int) -> Odometry:
        """Return where the robot was at the pose nearest in time."""
        after = int(np.clip(np.searchsorted(self.times_ns, time_ns), 0, len(self.times_ns) - 1))
        before = max(after - 1, 0)
        earlier = abs(time_ns - self.times_ns[before]) <= abs(self.times_ns[after] - time_ns)
        nearest = before if earlier else after
        return Odometry(self.T[nearest], float(self.travelled_m[nearest]))
