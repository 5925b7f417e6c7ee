"""Maximum likelihood: the lifted camera with the least reprojection error (§3.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.linear import Estimate, scaling, standard_error, total_least_squares
from vmf.estimate.robust import LOSSES, Loss, scale_of
from vmf.optimise import LeastSquares, levenberg_marquardt

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Re-weightings of a robust loss: Huber or Tukey weights settle within a few.
_ROBUST_ROUNDS = 10
_MAX_ITERATIONS = 200


def maximum_likelihood(
    R: Floats, n_free: int, x_bar: Floats, e: Floats, loss: Loss = "squared"
) -> tuple[Estimate, NDArray[np.bool_]]:
    """Minimise `Σ |e_i − pred_i|²` over parameters that see every observation in front of the camera.

    Parameters
    ----------
    R : (B, 3k+3, 3k+3) factors of the same equations.
    n_free : entries per row that the task's motions can determine.
    x_bar : (B, N, k+1) lifts.
    e : (B, N, 2) image-based errors in px, NaN where there is none.
    loss : `squared`, or `huber` / `tukey` weights for wrong tracks.

    Returns
    -------
    estimate : of batch shape (B,); `residual_px` is the root mean square of the inliers' coordinates.
    converged : (B,) whether the minimisation ended at a stationary point.
    """
    linear = total_least_squares(R, n_free)
    scale = scaling(R)
    seen = np.asarray(np.isfinite(e).all(axis=-1))
    centred = (e - scale.mean[..., None, :]) / scale.spread[..., None, None]
    target = np.where(seen[..., None], centred, 0.0)
    lifts = np.where(seen[..., None], x_bar @ scale.W, 0.0)
    weight = seen.astype(float)
    facing = scale.apply(linear.rows)
    sign = np.sign(np.where(seen, (lifts @ facing[:, 2, :, None])[..., 0], 0.0).sum(axis=1))
    starts = [facing * np.where(sign < 0.0, -1.0, 1.0)[:, None, None], _affine(lifts, target, x_bar, seen)]
    fits = [_minimise(_unit(start.reshape(len(R), -1)), lifts, target, seen, weight) for start in starts]
    cost = np.stack([np.where(np.isfinite(fit.cost), fit.cost, np.inf) for fit in fits])
    best = cost.argmin(axis=0)
    theta = np.where(best[:, None] == 0, fits[0].x, fits[1].x)
    converged = np.where(best == 0, fits[0].converged, fits[1].converged)
    if loss != "squared":
        affine = _unit(starts[1].reshape(len(R), -1))
        theta, weight, converged = _reweighted([theta, affine], lifts, target, seen, loss)
    r, J = _residuals(theta, lifts, target, seen, weight)
    # One scale is free among the parameters of the observable directions.
    unknowns = 3 * (np.square(scale.W).sum(axis=-2) > 0.0).sum(axis=-1) - 1
    n_used = np.maximum((weight > 0.0).sum(axis=1), 1)
    residual = np.sqrt(np.square(r).sum(axis=1) / (2 * n_used)) * scale.spread
    rows = scale.restore(theta.reshape(len(R), 3, -1))
    sane = np.isfinite(rows).all(axis=(1, 2)) & np.isfinite(residual)
    estimate = Estimate(
        rows,
        linear.rank,
        linear.determined & sane & converged,
        linear.condition,
        residual,
        _relative_error(r, J, n_used, unknowns),
        (2 * seen.sum(axis=1)).astype(np.int64),
    )
    return estimate, converged


def _relative_error(r: Floats, J: Floats, n_used: Ints, unknowns: Ints) -> Floats:
    """Standard error of the least certain direction of unit parameters, the free scale not counted."""
    bad = np.asarray(~(np.isfinite(r).all(axis=1) & np.isfinite(J).all(axis=(1, 2))))
    H = np.where(bad[:, None, None], 0.0, np.swapaxes(J, -1, -2) @ J)
    values = np.linalg.eigvalsh(H)
    smallest = np.take_along_axis(values, (H.shape[-1] - np.maximum(unknowns, 1))[:, None], axis=1)[:, 0]
    noise = standard_error(np.square(r).sum(axis=1), 2 * n_used - unknowns)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bad | ~(smallest > 0.0), np.inf, noise / np.sqrt(np.abs(smallest)))


def _reweighted(
    starts: list[Floats], lifts: Floats, target: Floats, seen: NDArray[np.bool_], loss: Loss
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Re-weight from each start and keep the least scale: the squared fit may sit on wrong tracks."""

    def sizes(theta: Floats) -> Floats:
        r, _ = _residuals(theta, lifts, target, seen, seen.astype(float))
        return np.asarray(np.linalg.norm(r.reshape(*seen.shape, 2), axis=-1))

    ends = []
    for theta in starts:
        for _ in range(_ROBUST_ROUNDS):
            size = sizes(theta)
            weight = np.sqrt(LOSSES[loss](size / scale_of(size, seen)[..., None])) * seen
            fit = _minimise(theta, lifts, target, seen, weight)
            theta = fit.x
        ends.append((theta, weight, fit.converged, scale_of(sizes(theta), seen)))
    best = np.stack([end[3] for end in ends]).argmin(axis=0), np.arange(len(seen))
    theta, weight, converged = (np.stack([end[i] for end in ends])[best] for i in range(3))
    return theta, weight, converged


def _affine(lifts: Floats, target: Floats, x_bar: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Scaled rows (B, 3, k+1) of the affine camera: equal depths everywhere, so none is negative."""
    gram = np.swapaxes(lifts, -1, -2)
    inverse = np.linalg.pinv(gram @ lifts, rcond=1e-10, hermitian=True)
    one = np.where(seen, x_bar[..., -1], 0.0)
    right = np.concatenate([target, one[..., None]], axis=-1)
    return np.swapaxes(inverse @ (gram @ right), -1, -2)


def _minimise(
    theta: Floats, lifts: Floats, target: Floats, seen: NDArray[np.bool_], weight: Floats
) -> LeastSquares:
    def problem(x: Floats, index: Ints) -> tuple[Floats, Floats]:
        return _residuals(x, lifts[index], target[index], seen[index], weight[index])

    return levenberg_marquardt(problem, theta, normalise=_unit, max_iterations=_MAX_ITERATIONS)


def _unit(theta: Floats) -> Floats:
    norm = np.linalg.norm(theta, axis=-1, keepdims=True)
    return theta / np.where(norm > 0.0, norm, 1.0)


def _residuals(
    theta: Floats, lifts: Floats, target: Floats, seen: NDArray[np.bool_], weight: Floats
) -> tuple[Floats, Floats]:
    """Weighted residuals (A, 2N) of scaled pixels, Jacobians (A, 2N, 3(k+1)); NaN behind the camera."""
    A, N, n = lifts.shape
    a, b, c = np.moveaxis(theta.reshape(A, 3, n), 1, 0)
    depth = (lifts @ c[..., None])[..., 0]
    depth = np.where(seen, np.where(depth > 0.0, depth, np.nan), 1.0)
    pred = np.stack([(lifts @ a[..., None])[..., 0], (lifts @ b[..., None])[..., 0]], -1) / depth[..., None]
    r = (pred - target) * weight[..., None]
    J = np.zeros((A, N, 2, 3, n))
    scaled = lifts * (weight / depth)[..., None]
    J[:, :, 0, 0] = J[:, :, 1, 1] = scaled
    J[:, :, :, 2] = -pred[..., None] * scaled[:, :, None, :]
    return r.reshape(A, 2 * N), J.reshape(A, 2 * N, 3 * n)
