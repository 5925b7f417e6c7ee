"""The thesis's rig and points in front of it, as studies need them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from vmf.data.simulate import rig as intrinsics
from vmf.errors import InputError
from vmf.geometry import StereoCameras, in_view, parallel_rig, stereo_code
from vmf.spec.model import Rig
from vmf.spec.studies import Box

Floats = NDArray[np.float64]

# Points drawn for each one wanted, before a box is said to be out of view.
_TRIES = 200


def rig_cameras(rig: Rig, tilt_deg: ArrayLike = (0.0, 0.0, 0.0)) -> StereoCameras:
    """Return the cameras of a rig whose axes are those of S turned about x, then y, then z."""
    K, _ = intrinsics(rig)
    R = Rotation.from_euler("xyz", np.asarray(tilt_deg, float), degrees=True).as_matrix()
    left = np.array([-rig.baseline_m / 2, 0.0, rig.forward_m])
    return parallel_rig(K, K, rig.baseline_m, R, left)


def visible_points(box: Box, rig: Rig, n: int, rng: np.random.Generator) -> Floats:
    """Return random points (n, 3) of a box that both images show.

    Raises
    ------
    InputError : hardly any point of the box is in view.
    """
    P = rng.uniform(box.low_m, box.high_m, (_TRIES, n, 3))
    shown = in_view(*stereo_code(rig_cameras(rig), P.reshape(-1, 3)), (rig.width_px, rig.height_px))
    found = P.reshape(-1, 3)[shown][:n]
    if len(found) < n:
        raise InputError(
            f"study.box: found {len(found)} of {_TRIES * n} points in both images, at least {n} are accepted"
        )
    return np.asarray(found)
