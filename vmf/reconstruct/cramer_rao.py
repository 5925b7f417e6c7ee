"""The Cramér–Rao bound: the covariance that no unbiased answer to a query can be below (§7).

The noise is Gaussian, equal and independent on all coordinates, so the Fisher information of all unknowns
is `JᵀJ / σ²` with the Jacobian of the noise-free pixels at the truth. Unknown points are taken out of it by
the Schur complement, target by target: the motion's Jacobian less what a change of the point makes up for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.data.query import Truth
from vmf.geometry import StereoCameras
from vmf.geometry.triangulate import project_derivative
from vmf.solve import Draft, Query, StopReason, Unknowns, refusals
from vmf.tasks import Task

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Bound:
    """Bounds of Q motions, at the true ones.

    Attributes
    ----------
    p : (Q, m) true unknowns.
    covariance : (Q, m, m) of p; zero where an unknown is given, NaN unless `ok`.
    error : (Q, m) of an efficient, unbiased Gaussian estimate of p, on the noise that the truth has.
    derivative : (Q, 6, m) change of the motion with p: the rotation vector of `R_trueᵀ R` (rad), then the
        translation (m). It carries covariance and error to the motion, to first order.
    reason : (Q,) `CONVERGED`, or why the information leaves a direction of motion free.
    """

    p: Floats
    covariance: Floats
    error: Floats
    derivative: Floats
    reason: NDArray[np.object_]

    @property
    def ok(self) -> Bools:
        """Which queries (Q,) have a bound."""
        return np.asarray(self.reason == StopReason.CONVERGED)


def cramer_rao(
    task: Task,
    cameras: StereoCameras,
    query: Query,
    truth: Truth,
    noise_px: float,
    *,
    points_known: bool,
    known_rotation: bool = False,
    point_m: float = 0.0,
) -> Bound:
    """Return the Cramér–Rao bounds of the motions of queries with known cameras.

    Parameters
    ----------
    task : the task space.
    cameras : the exact cameras.
    query : Q pairs of views; only their poses and which coordinates are seen count.
    truth : the true targets, and the noise for `Bound.error`.
    noise_px : standard deviation of every coordinate.
    points_known : whether the targets are known where they were, so that the desired view alone is noisy;
        else both views tell about points and motion.
    known_rotation : whether only the translation is asked for.
    point_m : standard deviation of each coordinate by which known targets have moved since (m).

    Raises
    ------
    ValueError : `known_rotation` with a task that only rotates, or `point_m` with unknown points.
    """
    if point_m > 0.0 and not points_known:
        raise ValueError("only known points can be off by a stated distance")
    unknowns = Unknowns.of(task, query.E_initial, query.rotations(known_rotation))
    everything = np.arange(len(query))
    p = task.coordinates(query.truth, query.E_initial)
    x = p[:, unknowns.free]
    E, dE = unknowns.motion(x, everything), unknowns.motion_jacobian(x, everything)
    J_points, J = _jacobians(cameras, query, truth.points, E, dE)
    seen = np.asarray(J.any(axis=(-2, -1)))
    deviation = truth.noise_px[..., None]
    variance = noise_px**2
    if not points_known:
        J = _without_points(J_points, J)
    elif point_m == 0.0:
        J, deviation = J[:, :, 4:], deviation[:, :, 4:]
    else:
        J_moved = J_points[:, :, 4:]
        whiten = _whitening(J_moved, noise_px, point_m)
        J, deviation = whiten @ J[:, :, 4:], whiten @ (deviation[:, :, 4:] + J_moved @ truth.moved[..., None])
        variance = 1.0
    J, deviation = J.reshape(len(p), -1, unknowns.n_free), deviation.reshape(len(p), -1, 1)
    draft = Draft.of(unknowns, refusals(seen, seen, 1), seen)
    draft.x[:] = x
    draft.check_rank_of(J[draft.asked], draft.asked)
    index = draft.asked
    J = J[index]
    J_t = np.swapaxes(J, -1, -2)
    spread = np.linalg.inv(J_t @ J)
    draft.covariance[index] = spread * variance
    error = np.zeros_like(p)
    error[draft.reason != StopReason.CONVERGED] = np.nan
    error[np.ix_(index, unknowns.free)] = (spread @ J_t @ deviation[index])[..., 0]
    return Bound(p, draft.solutions().covariance, error, _derivative(task, p, query), draft.reason)


def _jacobians(
    cameras: StereoCameras, query: Query, points: Floats, E: Floats, dE: Floats
) -> tuple[Floats, Floats]:
    """Return ∂pixels/∂point (Q, n, 8, 3) and ∂pixels/∂motion (Q, n, 8, f), zero where not seen.

    The eight coordinates are left and right of the initial view, then of the desired one.
    """
    P = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
    M = cameras.M
    views = np.empty((len(P), 1, 4, 3, 4))
    views[:, :, :2], views[:, :, 2:] = M, (M @ E[:, None])[:, None]
    h = np.einsum("qnvri,qni->qnvr", np.broadcast_to(views, (*P.shape[:2], 4, 3, 4)), P)
    depth = h[..., 2]
    seen = np.isfinite(np.concatenate([query.initial, query.desired], axis=-1)).reshape(*P.shape[:2], 4, 2)
    seen = seen & (depth > 0.0)[..., None]
    depth = np.where(depth > 0.0, depth, 1.0)
    pixels = h[..., :2] / depth[..., None]
    J_points = project_derivative(views[..., :3], pixels, depth)
    J_motion = np.zeros((*pixels.shape, dE.shape[1]))
    dh = np.einsum("vri,qfij,qnj->qnvrf", M, dE, P)
    J_motion[:, :, 2:] = project_derivative(dh, pixels[:, :, 2:], depth[:, :, 2:])
    rows = (*P.shape[:2], 8)
    J_points, J_motion = (np.where(seen[..., None], J, 0.0) for J in (J_points, J_motion))
    return J_points.reshape(*rows, 3), J_motion.reshape(*rows, dE.shape[1])


def _without_points(J_points: Floats, J: Floats) -> Floats:
    """Return the motion's Jacobian less its projection on the point's, whose rank may be less than 3."""
    U, s, _ = np.linalg.svd(J_points, full_matrices=False)
    U = np.where((s > 8 * _EPS * s[..., :1])[..., None, :], U, 0.0)
    return np.asarray(J - U @ (np.swapaxes(U, -1, -2) @ J))


def _whitening(J_moved: Floats, noise_px: float, point_m: float) -> Floats:
    """Return what makes the coordinates (…, 4) of targets that moved by N(0, s²) independent, of variance 1.

    Their covariance is `σ² I + s² J_P J_Pᵀ`.
    """
    U, s, _ = np.linalg.svd(J_moved)
    variance = np.full(U.shape[:-1], noise_px**2)
    variance[..., :3] += (point_m * s) ** 2
    # Without any noise the direction in which no point can move is exact, to rounding.
    variance = np.maximum(variance, _EPS * variance.max(axis=-1, keepdims=True))
    return np.asarray(np.swapaxes(U, -1, -2) / np.sqrt(np.where(variance > 0.0, variance, 1.0))[..., None])


def _derivative(task: Task, p: Floats, query: Query) -> Floats:
    dE = np.einsum("ijb,qbm->qmij", task.embedding, task.lift_jacobian(p, query.E_initial))
    R = task.motion(p, query.E_initial)[:, None, :3, :3]
    W = np.swapaxes(R, -1, -2) @ dE[..., :3, :3]
    # The skew part alone: the symmetric one is rounding.
    turn = 0.5 * np.stack(
        [W[..., 2, 1] - W[..., 1, 2], W[..., 0, 2] - W[..., 2, 0], W[..., 1, 0] - W[..., 0, 1]], axis=-1
    )
    return np.swapaxes(np.concatenate([turn, dE[..., :3, 3]], axis=-1), -1, -2)
