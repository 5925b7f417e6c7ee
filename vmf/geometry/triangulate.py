"""Points from their pixels in two or more views, by minimum reprojection error.

A point is sought as `q = (x_L, y_L, δ)`: its pixel in the left camera at the initial view and its disparity
there. In q the code of a parallel rig is linear, far points are near zero and not near infinity, and all
three unknowns are pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.geometry.camera import StereoCameras
from vmf.optimise import LeastSquares, levenberg_marquardt

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_MAX_ITERATIONS = 50


@dataclass(frozen=True)
class Triangulation:
    """Points triangulated from stereo codes.

    Attributes
    ----------
    points : (…, 3) points in S (m); NaN where not `ok`.
    q : (…, 3) the same points as left pixel and disparity (px); NaN where not `ok`.
    residual_px : (…,) root mean square reprojection error over the four coordinates.
    covariance : (…, 3, 3) of the points for a noise of 1 px on every coordinate (m²).
    ok : (…,) whether both cameras see the point, in front of both, and the minimisation converged.
    """

    points: Floats
    q: Floats
    residual_px: Floats
    covariance: Floats
    ok: Bools


def triangulate(cameras: StereoCameras, codes: ArrayLike) -> Triangulation:
    """Return the maximum-likelihood points of stereo codes (…, 4), NaN where a camera does not see them.

    The noise is taken as equal and independent on all four coordinates.
    """
    codes = np.asarray(codes, float)
    shape, flat = codes.shape[:-1], codes.reshape(math.prod(codes.shape[:-1]), 4)
    index = np.nonzero(np.isfinite(flat).all(axis=1))[0]
    B = point_from_q(cameras)
    pixels = flat[index].reshape(len(index), 2, 2)
    views = np.broadcast_to(cameras.M @ B, (len(index), 2, 3, 4))
    fit = locate(views, pixels, linear_start(views, pixels))
    predicted, J, depth = reproject(views, fit.x)
    in_front = fit.converged & (fit.x[:, 2] > 0.0) & (depth > 0.0).all(axis=1)
    index, q, J = index[in_front], fit.x[in_front], J.reshape(len(J), 4, 3)[in_front]
    error = (predicted - pixels)[in_front]
    points, J_point = points_of(B, q)
    out = Triangulation(
        np.full((len(flat), 3), np.nan),
        np.full((len(flat), 3), np.nan),
        np.full(len(flat), np.nan),
        np.full((len(flat), 3, 3), np.nan),
        np.zeros(len(flat), bool),
    )
    out.points[index], out.q[index], out.ok[index] = points, q, True
    out.residual_px[index] = np.sqrt(np.mean(np.square(error), axis=(1, 2)))
    J_t = np.swapaxes(J, -1, -2)
    out.covariance[index] = J_point @ np.linalg.inv(J_t @ J) @ np.swapaxes(J_point, -1, -2)
    return Triangulation(
        out.points.reshape(*shape, 3),
        out.q.reshape(*shape, 3),
        out.residual_px.reshape(shape),
        out.covariance.reshape(*shape, 3, 3),
        out.ok.reshape(shape),
    )


def point_from_q(cameras: StereoCameras) -> Floats:
    """Return `B` (4, 4) that takes `(x_L, y_L, 1, δ)` to the point's homogeneous coordinates in S.

    Raises
    ------
    ValueError : the cameras share a centre, so that no depth can be seen.
    """
    left, right = cameras.M
    centre = np.append(-np.linalg.solve(left[:, :3], left[:, 3]), 1.0)
    # The right image of the left centre, focal length times baseline (px m) for a parallel rig.
    px_m = float(np.linalg.norm(right @ centre))
    if px_m <= np.finfo(float).eps * float(np.linalg.norm(right)):
        raise ValueError("triangulation needs two cameras with different centres")
    B = np.linalg.inv(np.vstack([left, [0.0, 0.0, 0.0, 1.0]]))
    B[:, 3] /= px_m
    return B


def points_of(B: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Return points (…, 3) in S of left pixels and disparities q (…, 3), and ∂P/∂q (…, 3, 3)."""
    h = homogeneous(q) @ B.T
    P = h[..., :3] / h[..., 3:]
    varying = B[:, [0, 1, 3]]
    return P, (varying[:3] - P[..., None] * varying[3]) / h[..., 3:, None]


def homogeneous(q: Floats) -> Floats:
    """Return `(x_L, y_L, 1, δ)` (…, 4) of q (…, 3)."""
    return np.insert(q, 2, 1.0, axis=-1)


def linear_start(views: Floats, pixels: Floats) -> Floats:
    """Return q (T, 3) by the direct linear transform from views (T, V, 3, 4), pixels (T, V, 2) or NaN.

    The third entry of `(x_L, y_L, 1, δ)` being 1, rows are in pixels times the depth ratio between a view
    and the first: they need no further normalisation, and are exact for a parallel rig.
    """
    rows = views[..., :2, :] - pixels[..., None] * views[..., 2:, :]
    rows = np.where(np.isfinite(pixels)[..., None], rows, 0.0).reshape(len(views), 2 * views.shape[1], 4)
    A, b = rows[..., [0, 1, 3]], -rows[..., 2:3]
    A_t = np.swapaxes(A, -1, -2)
    return np.asarray(np.linalg.solve(A_t @ A, A_t @ b)[..., 0])


def reproject(views: Floats, q: Floats, shift: Floats | None = None) -> tuple[Floats, Floats, Floats]:
    """Return what views of `(x_L, y_L, 1, δ)` see of q.

    Parameters
    ----------
    views : (T, V, 3, 4) camera matrices times `B`.
    q : (T, 3) points (px).
    shift : (T, V, 2, 4) added to the pixels, linear in `(x_L, y_L, 1, δ)`; nothing by default.

    Returns
    -------
    pixels : (T, V, 2) px; NaN behind the camera.
    J : (T, V, 2, 3) their derivatives with respect to q.
    depth : (T, V) homogeneous depths, 1 in the left camera of the initial view.
    """
    point = homogeneous(q)[:, None, :, None]
    h = (views @ point)[..., 0]
    depth = np.where(h[..., 2] > 0.0, h[..., 2], np.nan)
    pixels = h[..., :2] / depth[..., None]
    J = project_derivative(views[..., [0, 1, 3]], pixels, depth)
    if shift is None:
        return pixels, J, h[..., 2]
    return pixels + (shift @ point)[..., 0], J + shift[..., [0, 1, 3]], h[..., 2]


def project_derivative(dh: Floats, pixels: Floats, depth: Floats) -> Floats:
    """Return derivatives (…, 2, n) of pixels (…, 2) from those (…, 3, n) of the point in the camera."""
    return np.asarray((dh[..., :2, :] - pixels[..., None] * dh[..., 2:, :]) / depth[..., None, None])


def locate(views: Floats, pixels: Floats, start: Floats) -> LeastSquares:
    """Minimise the reprojection error of T points over q, each in its own V views.

    Parameters
    ----------
    views : (T, V, 3, 4) camera matrices times `B`.
    pixels : (T, V, 2) px; NaN where not seen.
    start : (T, 3) start points.
    """
    seen = np.isfinite(pixels)
    n = 2 * pixels.shape[1]

    def problem(q: Floats, index: Ints) -> tuple[Floats, Floats]:
        predicted, J, _ = reproject(views[index], q)
        look = seen[index]
        r = np.where(look, predicted - pixels[index], 0.0)
        J = np.where(look[..., None], J, 0.0)
        return r.reshape(len(q), n), J.reshape(len(q), n, 3)

    return levenberg_marquardt(problem, start, max_iterations=_MAX_ITERATIONS)
