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

# As many points as are wanted, or this many, are drawn so many times before a box counts as out of view.
_TRIES = 200
_LEAST = 16


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
    cameras, size = rig_cameras(rig), (rig.width_px, rig.height_px)
    found = np.zeros((0, 3))
    for _ in range(_TRIES):
        P = rng.uniform(box.low_m, box.high_m, (max(n, _LEAST), 3))
        found = np.concatenate([found, P[in_view(*stereo_code(cameras, P), size)]])
        if len(found) >= n:
            return found[:n]
    raise InputError(
        f"study.box: found {len(found)} of {_TRIES * max(n, _LEAST)} points in both images, "
        f"at least {n} are accepted"
    )
