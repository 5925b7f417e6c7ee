"""Rigid motions as 4×4 arrays, named `E_to_from`: `E_B_from_A @ P_A = P_B`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]


def from_rotation_translation(R: ArrayLike, t: ArrayLike) -> Floats:
    """Return motions (…, 4, 4) from rotations (…, 3, 3) and translations (…, 3)."""
    R, t = np.asarray(R, float), np.asarray(t, float)
    shape = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    E = np.zeros((*shape, 4, 4))
    E[..., :3, :3] = R
    E[..., :3, 3] = t
    E[..., 3, 3] = 1.0
    return E


def from_quaternion(position: ArrayLike, quaternion_xyzw: ArrayLike) -> Floats:
    """Return motions (…, 4, 4) from positions (…, 3) and quaternions (…, 4), x y z w, normalised here."""
    q = np.asarray(quaternion_xyzw, float)
    R = Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3)
    return from_rotation_translation(R, position)


def inverse(E: ArrayLike) -> Floats:
    """Return inv(E) of rigid motions (…, 4, 4), by transposition."""
    E = np.asarray(E, float)
    R_t = np.swapaxes(E[..., :3, :3], -1, -2)
    return from_rotation_translation(R_t, -(R_t @ E[..., :3, 3:])[..., 0])


def rotation_angle(E: ArrayLike) -> Floats:
    """Return the geodesic angle (…,) in rad of the rotation of E (…, 3|4, 3|4), accurate near 0 and π."""
    R = np.asarray(E, float)[..., :3, :3]
    return np.asarray(Rotation.from_matrix(R.reshape(-1, 3, 3)).magnitude()).reshape(R.shape[:-2])


def nearest_rotation(A: ArrayLike) -> Floats:
    """Return the rotations (…, 3, 3) nearest to A (…, 3, 3) in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(np.asarray(A, float))
    Vt = Vt.copy()
    Vt[..., 2, :] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def interpolate(times: ArrayLike, E: ArrayLike, at: ArrayLike) -> Floats:
    """Interpolate motions (N, 4, 4) known at increasing `times` (N,) to the times `at` (M,), on SE(3).

    Between neighbours the motion follows the one-parameter subgroup `E_i exp(s log(inv(E_i) E_{i+1}))`.

    Raises
    ------
    ValueError : a time lies outside `times`.
    """
    from scipy.spatial.transform import RigidTransform

    times, E, at = np.asarray(times), np.asarray(E, float), np.asarray(at)
    if len(at) and (at.min() < times[0] or at.max() > times[-1]):
        raise ValueError("interpolation outside the known times")
    i = np.clip(np.searchsorted(times, at, side="right") - 1, 0, max(len(times) - 2, 0))
    j = np.minimum(i + 1, len(times) - 1)
    span = np.where(j > i, times[j] - times[i], 1)
    s = (at - times[i]) / span
    step = RigidTransform.from_matrix(inverse(E[i]) @ E[j]).as_exp_coords()
    return np.asarray(E[i] @ RigidTransform.from_exp_coords(s[:, None] * step).as_matrix())
