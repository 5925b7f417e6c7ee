"""Solutions of the linear equations, read from their triangular factor alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.rows import homogeneous

Floats = NDArray[np.float64]

# A singular value counts as zero below this share of the largest: rounding of a 39-column factor that has
# seen 10⁵ rows stays two decades under it.
RANK_TOLERANCE = 1e-11


@dataclass(frozen=True)
class Estimate:
    """Parameters of centres, with leading batch axes (…).

    Attributes
    ----------
    rows : (…, 3, k+1) `a, b, c`, up to one scale.
    rank : (…,) numerical rank of the equations.
    determined : (…,) whether the equations fix the parameters, as far as the task lets them.
    condition : (…,) condition number of the observable part of the equations.
    residual_px : (…,) root mean square residual per equation.
    relative_error : (…,) standard error of the least certain direction of the parameters, relative to their
        size; from the residuals, infinite where there are none to spare.
    n_equations : (…,).
    """

    rows: Floats
    rank: NDArray[np.int64]
    determined: NDArray[np.bool_]
    condition: Floats
    residual_px: Floats
    relative_error: Floats
    n_equations: NDArray[np.int64]


def count(R: Floats) -> Floats:
    """Return the number of row pairs (…,) that a factor has seen: the constants' column counts them."""
    n = R.shape[-1] // 3
    return np.asarray(np.rint(np.square(R[..., :, n - 1]).sum(axis=-1)))


def condition_number(R: Floats) -> Floats:
    """Return the condition numbers (…,) of the equations behind factors, as in `least_squares`."""
    s = np.linalg.svd(R[..., :-1, :-1], compute_uv=False)
    smallest = np.where(s > RANK_TOLERANCE * s[..., :1], s, np.inf).min(axis=-1)
    return np.where(s[..., 0] > 0.0, s[..., 0] / smallest, np.inf)


def least_squares(R: Floats, n_free: int) -> Estimate:
    """Solve with the constant of c fixed to 1 (Eq. 3.47); the minimum-norm solution while rank-deficient.

    Parameters
    ----------
    R : (…, 3k+3, 3k+3) factors of augmented rows.
    n_free : entries per row that the task's motions can determine, `k+1` or fewer.
    """
    n = R.shape[-1] // 3
    U, s, Vt = np.linalg.svd(R[..., :-1, :-1])
    kept = s > RANK_TOLERANCE * s[..., :1]
    rank = kept.sum(axis=-1)
    z = (np.swapaxes(U, -1, -2) @ R[..., :-1, -1:])[..., 0]
    scaled = np.where(kept, z / np.where(kept, s, 1.0), 0.0)
    theta = (np.swapaxes(Vt, -1, -2) @ scaled[..., None])[..., 0]
    rows = np.concatenate([theta, np.ones((*theta.shape[:-1], 1))], axis=-1)
    pairs = count(R)
    lost = np.where(kept, 0.0, z)
    squares = R[..., -1, -1] ** 2 + np.square(lost).sum(axis=-1)
    smallest = np.where(kept, s, np.inf).min(axis=-1, initial=np.inf)
    size = np.linalg.norm(rows, axis=-1)
    least = np.where(rank > 0, smallest, 1.0)
    return Estimate(
        rows.reshape(*rows.shape[:-1], 3, n),
        rank,
        np.asarray(rank >= 3 * n_free - 1),
        np.where(rank > 0, s[..., 0] / least, np.inf),
        np.sqrt(squares / np.maximum(2 * pairs, 1)),
        np.where(rank > 0, standard_error(squares, 2 * pairs - rank) / (least * size), np.inf),
        (2 * pairs).astype(np.int64),
    )


@dataclass(frozen=True)
class Scaling:
    """Hartley scaling of one centre's equations: `e = spread · e' + mean`, `x̄' = Wᵀ x̄`.

    Attributes
    ----------
    mean : (…, 2) px.
    spread : (…,) px.
    W : (…, k+1, k+1) observable directions of the lift with unit mean square; zero columns for the rest.
    """

    mean: Floats
    spread: Floats
    W: Floats

    def restore(self, scaled: Floats) -> Floats:
        """Return rows (…, 3, k+1) in pixels and metres from scaled rows."""
        rows = scaled @ np.swapaxes(self.W, -1, -2)
        c = rows[..., 2:, :]
        ab = self.spread[..., None, None] * rows[..., :2, :] + self.mean[..., :, None] * c
        return np.concatenate([ab, c], axis=-2)

    def apply(self, rows: Floats) -> Floats:
        """Return scaled rows (…, 3, k+1) from rows in pixels and metres."""
        c = rows[..., 2:, :]
        ab = (rows[..., :2, :] - self.mean[..., :, None] * c) / self.spread[..., None, None]
        return np.concatenate([ab, c], axis=-2) @ np.swapaxes(np.linalg.pinv(self.W), -1, -2)


def scaling(R: Floats) -> Scaling:
    """Return the Hartley scaling that the factor's own sums define."""
    n = R.shape[-1] // 3
    pairs = np.maximum(count(R), 1.0)
    last = R[..., :, -1]
    mean = (
        np.stack(
            [
                (R[..., :, n - 1] * last).sum(axis=-1),
                (R[..., :, 2 * n - 1] * last).sum(axis=-1),
            ],
            axis=-1,
        )
        / pairs[..., None]
    )
    variance = np.square(last).sum(axis=-1) / pairs - np.square(mean).sum(axis=-1)
    spread = np.sqrt(np.maximum(variance, 0.0) / 2.0)
    spread = np.where(spread > 0.0, spread, 1.0)
    # The first k+1 columns of the first k+1 rows are the factor of the lifts alone.
    X = R[..., :n, :n]
    rms = np.sqrt(np.square(X).sum(axis=-2) / pairs[..., None])
    D = np.where(rms > 0.0, 1.0 / np.where(rms > 0.0, rms, 1.0), 0.0)
    _, s, Vt = np.linalg.svd(X * D[..., None, :])
    observable = s > RANK_TOLERANCE * np.maximum(s[..., :1], np.finfo(float).tiny)
    # Directions of unit mean square: ‖X D v‖² = s² sums over the pairs.
    unit = np.where(observable, np.sqrt(pairs)[..., None] / np.where(observable, s, 1.0), 0.0)
    W = D[..., :, None] * np.swapaxes(Vt, -1, -2) * unit[..., None, :]
    return Scaling(mean, spread, W)


def total_least_squares(R: Floats, n_free: int) -> Estimate:
    """Solve the homogeneous equations: smallest right singular vector after Hartley scaling (§3.2).

    Parameters
    ----------
    R : (…, 3k+3, 3k+3) factors of augmented rows.
    n_free : entries per row that the task's motions can determine, `k+1` or fewer.
    """
    n = R.shape[-1] // 3
    scale = scaling(R)
    T = np.zeros((*R.shape[:-2], 3 * n, 3 * n))
    W, s = scale.W, scale.spread[..., None, None]
    T[..., :n, :n] = W
    T[..., n : 2 * n, n : 2 * n] = W
    T[..., :n, 2 * n :] = scale.mean[..., 0, None, None] * W / s
    T[..., n : 2 * n, 2 * n :] = scale.mean[..., 1, None, None] * W / s
    T[..., 2 * n :, 2 * n :] = W / s
    H = homogeneous(R) @ T
    observable = np.square(W).sum(axis=-2) > 0.0
    # Unobservable directions get the largest singular values: they stay out of the solution.
    columns = np.concatenate([observable] * 3, axis=-1)
    blocked = np.where(columns, 0.0, 2.0 * np.linalg.norm(H, axis=(-2, -1))[..., None] + 1.0)
    H = np.concatenate([H, np.eye(3 * n) * blocked[..., None, :]], axis=-2)
    _, sigma, Vt = np.linalg.svd(H, full_matrices=False)
    solution = Vt[..., -1, :].reshape(*R.shape[:-2], 3, n)
    free = columns.sum(axis=-1)
    top = np.take_along_axis(sigma, np.minimum(3 * n - free, 3 * n - 1)[..., None], axis=-1)[..., 0]
    rank = (sigma > RANK_TOLERANCE * top[..., None]).sum(axis=-1) - (3 * n - free)
    pairs = count(R)
    second = sigma[..., -2]
    determined = (free >= 3 * n_free) & (second > RANK_TOLERANCE * top) & (2 * pairs >= 3 * n_free - 1)
    rows = scale.restore(solution)
    depth = np.sqrt(np.square(solution[..., 2, :]).sum(axis=-1))
    residual = sigma[..., -1] * scale.spread / np.sqrt(np.maximum(2 * pairs, 1)) / np.maximum(depth, 1e-300)
    error = standard_error(np.square(sigma[..., -1]), 2 * pairs - rank)
    with np.errstate(divide="ignore"):
        condition = np.where(second > 0.0, top / second, np.inf)
        relative = np.where(second > 0.0, error / second, np.inf)
    return Estimate(rows, rank, determined, condition, residual, relative, (2 * pairs).astype(np.int64))


def standard_error(squares: Floats, spare: Floats | NDArray[np.int64]) -> Floats:
    """Return the noise (…,) that a sum of squared residuals implies, infinite without equations to spare."""
    return np.where(spare > 0, np.sqrt(squares / np.maximum(spare, 1)), np.inf)


# Estimators that need no more than a factor.
LINEAR: Mapping[str, Callable[[Floats, int], Estimate]] = MappingProxyType(
    {"qr": least_squares, "tls": total_least_squares}
)
