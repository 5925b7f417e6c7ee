"""From what a robot reports (body poses or joints) to the motions `E_S_from_W` of the method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vmf.geometry import motion

Floats = NDArray[np.float64]

# How far the norm of a reported quaternion may be from 1: rounding in single precision and a little more.
NORM_TOLERANCE = 1e-3


@dataclass(frozen=True)
class BodyPoses:
    """Poses of the moving frame in a fixed one: positions (N, 3) in m, quaternions (N, 4) x y z w."""

    position_m: Floats
    quaternion_xyzw: Floats

    def motions(self, mounting: str) -> Floats:
        """Return `E_S_from_W` (N, 4, 4): inv(W_T_S) for `eye_in_hand`, B_T_tool itself for `eye_to_hand`."""
        T = motion.from_quaternion(self.position_m, self.quaternion_xyzw)
        return T if mounting == "eye_to_hand" else motion.inverse(T)


@dataclass(frozen=True)
class PanTiltJoints:
    """Joint angles (N,) in rad of a pan-tilt unit."""

    pan_rad: Floats
    tilt_rad: Floats

    def motions(self, mounting: str) -> Floats:
        """Return `E_S_from_W` (N, 4, 4) = R_y(tilt) R_z(pan), whatever the mounting (§2, C2)."""
        angles = np.stack([self.tilt_rad, self.pan_rad], axis=-1)
        R = Rotation.from_euler("YZ", angles).as_matrix()
        return motion.from_rotation_translation(R, np.zeros(3))


Poses = BodyPoses | PanTiltJoints
