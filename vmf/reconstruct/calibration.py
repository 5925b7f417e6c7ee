"""Cameras that are off by a stated error, since no real rig has exact ones (§7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vmf.geometry import StereoCameras, camera_matrix

Floats = NDArray[np.float64]

# Vergence: the error of orientation that depth feels most.
_ROTATION_AXIS = np.array([0.0, 1.0, 0.0])


class CalibrationErrorLike(Protocol):
    """Anything that states a calibration error as `CalibrationError` does, such as a spec."""

    @property
    def focal_percent(self) -> float:
        """Error of the focal lengths (%)."""

    @property
    def principal_px(self) -> float:
        """Error of the principal points (px)."""

    @property
    def rotation_deg(self) -> float:
        """Error of the rotation between the cameras (deg)."""

    @property
    def baseline_percent(self) -> float:
        """Error of the baseline (%)."""


@dataclass(frozen=True)
class CalibrationError:
    """A calibration error, see `disturb`; exact by default."""

    focal_percent: float = 0.0
    principal_px: float = 0.0
    rotation_deg: float = 0.0
    baseline_percent: float = 0.0


@dataclass(frozen=True)
class RigModel:
    """A parallel stereo rig in physical terms.

    Attributes
    ----------
    K_left, K_right : (3, 3) intrinsics (px).
    R_camera_from_S : (3, 3) orientation of both cameras.
    p_left_in_S : (3,) centre of the left camera (m).
    baseline_m : distance of the right camera's centre along the camera's x axis (m).
    """

    K_left: Floats
    K_right: Floats
    R_camera_from_S: Floats
    p_left_in_S: Floats
    baseline_m: float

    def cameras(self) -> StereoCameras:
        """Return the exact cameras."""
        return disturb(self, CalibrationError())


def disturb(rig: RigModel, error: CalibrationErrorLike) -> StereoCameras:
    """Return the cameras that somebody has who calibrated the rig with a stated error.

    An error is what the true rig has beyond its calibration. With this sign a rotation makes depths and their
    errors too large, and adds to what a focal length does to the angles of motions; a negative rotation is as
    possible, and milder.

    Parameters
    ----------
    rig : the true rig.
    error : the truth has fx and fy of both cameras larger by `focal_percent`; cx and cy of both larger by
        `principal_px`; the cameras turned towards each other by `rotation_deg`, each by half of it about its
        own y axis (vergence); and the right camera's centre farther from the left one's by
        `baseline_percent`.
    """
    half = 0.5 * np.deg2rad(error.rotation_deg) * _ROTATION_AXIS
    turns = Rotation.from_rotvec([half, -half]).as_matrix()
    R = np.asarray(rig.R_camera_from_S, float)
    p_left = np.asarray(rig.p_left_in_S, float)
    p_right = p_left + rig.baseline_m / (1.0 + error.baseline_percent / 100.0) * R[0]
    left = camera_matrix(_disturbed(rig.K_left, error), turns[0] @ R, p_left)
    right = camera_matrix(_disturbed(rig.K_right, error), turns[1] @ R, p_right)
    return StereoCameras(np.stack([left, right]))


def label(method: str, error: CalibrationErrorLike) -> str:
    """Return a rival's name in tables, such as `bundle[focal=1%,rot=0.5deg]`; exact cameras add nothing."""
    parts = (
        ("focal", error.focal_percent, "%"),
        ("pp", error.principal_px, "px"),
        ("rot", error.rotation_deg, "deg"),
        ("base", error.baseline_percent, "%"),
    )
    stated = ",".join(f"{name}={value:g}{unit}" for name, value, unit in parts if value != 0.0)
    return f"{method}[{stated}]" if stated else method


def _disturbed(K: Floats, error: CalibrationErrorLike) -> Floats:
    K = np.array(K, float)
    K[[0, 1], [0, 1]] /= 1.0 + error.focal_percent / 100.0
    K[:2, 2] -= error.principal_px
    return K
