"""The thesis's rig, as studies need it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vmf.data.simulate import rig as intrinsics
from vmf.geometry import StereoCameras, parallel_rig
from vmf.spec.model import Rig


def rig_cameras(rig: Rig, tilt_deg: ArrayLike = (0.0, 0.0, 0.0)) -> StereoCameras:
    """Return the cameras of a rig whose axes are those of S turned about x, then y, then z."""
    K, _ = intrinsics(rig)
    R = Rotation.from_euler("xyz", np.asarray(tilt_deg, float), degrees=True).as_matrix()
    left = np.array([-rig.baseline_m / 2, 0.0, rig.forward_m])
    return parallel_rig(K, K, rig.baseline_m, R, left)
