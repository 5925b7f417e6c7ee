"""Pinhole cameras as 3×4 matrices `M = K · L_E_S` in the moving frame S (Eq. 3.2), and stereo rigs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Rows: camera axes (x right, y down, z forward) in an S with x forward, y left, z up.
R_CAMERA_FROM_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class StereoCameras:
    """Both camera matrices of a rig, stacked as (2, 3, 4): left, right (px, m)."""

    M: Floats

    @property
    def left(self) -> Floats:
        """The left camera matrix (3, 4)."""
        return np.asarray(self.M[0])

    @property
    def right(self) -> Floats:
        """The right camera matrix (3, 4)."""
        return np.asarray(self.M[1])


def camera_matrix(K: ArrayLike, R_camera_from_S: ArrayLike, p_camera_in_S: ArrayLike) -> Floats:
    """Return `K [R | −R p]` (3, 4), the camera whose centre is at `p_camera_in_S` (m)."""
    R = np.asarray(R_camera_from_S, float)
    p = np.asarray(p_camera_in_S, float)
    return np.asarray(np.asarray(K, float) @ np.column_stack([R, -R @ p]))


def parallel_rig(
    K_left: ArrayLike,
    K_right: ArrayLike,
    baseline_m: float,
    R_camera_from_S: ArrayLike,
    p_left_in_S: ArrayLike,
) -> StereoCameras:
    """Return a rig of parallel cameras, the right one `baseline_m` along the camera's x axis (Table 5.1)."""
    R = np.asarray(R_camera_from_S, float)
    p_left = np.asarray(p_left_in_S, float)
    p_right = p_left + baseline_m * R[0]
    return StereoCameras(np.stack([camera_matrix(K_left, R, p_left), camera_matrix(K_right, R, p_right)]))


def project(M: ArrayLike, P_S: ArrayLike) -> tuple[Floats, Floats]:
    """Project points of S (Eq. 3.3).

    Parameters
    ----------
    M : (…, 3, 4) camera matrices.
    P_S : (…, 3) points in S (m), broadcast against `M`.

    Returns
    -------
    pixels : (…, 2) px; meaningless where the depth is not positive.
    depth : (…,) m.
    """
    M, P_S = np.asarray(M, float), np.asarray(P_S, float)
    p = (M[..., :, :3] @ P_S[..., None])[..., 0] + M[..., :, 3]
    depth = p[..., 2]
    return p[..., :2] / np.where(depth == 0.0, np.nan, depth)[..., None], depth


def stereo_code(cameras: StereoCameras, P_S: ArrayLike) -> tuple[Floats, Floats]:
    """Return stereo codes (…, 4) `x_L, y_L, x_R, y_R` of points (…, 3) of S and their depths (…, 2)."""
    pixels, depth = project(cameras.M, np.asarray(P_S, float)[..., None, :])
    return pixels.reshape(*pixels.shape[:-2], 4), depth


def in_view(codes: ArrayLike, depth: ArrayLike, image_size: tuple[int, int]) -> NDArray[np.bool_]:
    """Tell which codes (…, 4) lie in both images, in front of both cameras (depth (…, 2) > 0)."""
    codes = np.asarray(codes, float)
    size = np.array([*image_size, *image_size], float)
    # Pixel centres have integer coordinates, so an image reaches from −0.5 to size − 0.5.
    inside = (codes >= -0.5) & (codes <= size - 0.5)
    return np.asarray(inside.all(axis=-1) & (np.asarray(depth) > 0.0).all(axis=-1))
