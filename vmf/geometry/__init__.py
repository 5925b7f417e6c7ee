"""Rigid motions, cameras and projection."""

from vmf.geometry.camera import StereoCameras, camera_matrix, in_view, parallel_rig, project, stereo_code
from vmf.geometry.motion import (
    from_quaternion,
    from_rotation_translation,
    interpolate,
    inverse,
    nearest_rotation,
    rotation_angle,
)
from vmf.geometry.triangulate import Triangulation, triangulate

__all__ = [
    "StereoCameras",
    "Triangulation",
    "camera_matrix",
    "from_quaternion",
    "from_rotation_translation",
    "in_view",
    "interpolate",
    "inverse",
    "nearest_rotation",
    "parallel_rig",
    "project",
    "rotation_angle",
    "stereo_code",
    "triangulate",
]
