"""Levenberg–Marquardt over a batch of problems, each with its own damping and its own end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# problem(x (A, m), index (A,)) -> residuals (A, n), Jacobians (A, n, m) of the problems `index`.
Problem = Callable[[Floats, Ints], tuple[Floats, Floats]]

_FIRST_DAMPING = 1e-4
_LARGEST_DAMPING = 1e16
# Beyond this the damping and not the problem decides how long a step is.
_HARD_DAMPING = 1e3
_ROUNDING = 64 * np.finfo(float).eps
# Rounding keeps the gradient of a minimum from falling below the root of the machine precision.
_NEARLY_FLAT = 1e-6


class Stop(IntEnum):
    """Why an optimisation ended."""

    GRADIENT = 0
    STEP = 1
    COST = 2
    MAX_ITERATIONS = 3
    STALLED = 4
    NOT_FINITE = 5


@dataclass(frozen=True)
class LeastSquares:
    """Minimisers of Q problems.

    Attributes
    ----------
    x : (Q, m) minimisers.
    cost : (Q,) half the squared residual norm.
    iterations : (Q,) steps tried.
    stop : (Q,) `Stop` values.
    """

    x: Floats
    cost: Floats
    iterations: Ints
    stop: Ints

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether each problem ended at a stationary point."""
        return np.asarray(self.stop <= Stop.COST)


def levenberg_marquardt(
    problem: Problem,
    start: Floats,
    *,
    max_iterations: int = 100,
    gradient_tolerance: float = 1e-10,
    step_tolerance: float = 1e-12,
    cost_tolerance: float = 1e-14,
    normalise: Callable[[Floats], Floats] | None = None,
) -> LeastSquares:
    """Minimise ½‖r(x)‖² for each of Q problems (Marquardt 1963, damping after Nielsen 1999).

    Parameters
    ----------
    problem : residuals (A, n) and Jacobians (A, n, m) of the A problems still running.
    start : (Q, m) start points.
    max_iterations : steps tried at most, accepted or not.
    gradient_tolerance : largest cosine between the residual and a column of the Jacobian at the end.
    step_tolerance, cost_tolerance : relative changes below which a problem ends.
    normalise : applied to accepted points, for residuals that do not depend on the scale of x.

    Returns
    -------
    LeastSquares
        A problem whose residuals are not finite at the start ends at once with `Stop.NOT_FINITE`.
    """
    x = np.array(start, float)
    n_problems, m = x.shape
    stop = np.full(n_problems, int(Stop.MAX_ITERATIONS), dtype=np.int64)
    iterations = np.zeros(n_problems, dtype=np.int64)
    damping = np.full(n_problems, _FIRST_DAMPING)
    growth = np.full(n_problems, 2.0)
    everything = np.arange(n_problems)
    r, J = problem(x, everything)
    r, J = np.array(r), np.array(J)
    cost = 0.5 * np.einsum("qn,qn->q", r, r)
    alive = np.isfinite(cost) & np.isfinite(J).all(axis=(1, 2))
    stop[~alive] = Stop.NOT_FINITE
    H, g = _normal_equations(r, J)
    floor = np.finfo(float).tiny

    def flat(which: Ints, tolerance: float = gradient_tolerance) -> NDArray[np.bool_]:
        scale = np.sqrt(np.einsum("aii->ai", H[which]) * 2.0 * cost[which, None])
        return np.asarray((np.abs(g[which]) <= tolerance * scale + floor).all(axis=1))

    def nearly_flat(which: Ints) -> NDArray[np.bool_]:
        # Residuals that the last bits of x make cannot be told from none.
        size = np.sqrt(np.einsum("aii->a", H[which])) * (1.0 + np.linalg.norm(x[which], axis=1))
        return np.asarray(flat(which, _NEARLY_FLAT) | (np.sqrt(2.0 * cost[which]) <= _ROUNDING * size))

    index = everything[alive]
    done = flat(index)
    stop[index[done]] = Stop.GRADIENT
    index = index[~done]
    for _ in range(max_iterations):
        if len(index) == 0:
            break
        iterations[index] += 1
        diagonal = np.einsum("aii->ai", H[index]).copy()
        # Columns without any influence get unit damping, so that their step is zero and not undefined.
        diagonal[diagonal <= 1e-14 * diagonal.max(axis=1, keepdims=True) + floor] = 1.0
        A = H[index].copy()
        A[:, np.arange(m), np.arange(m)] += damping[index, None] * diagonal
        step = _solve(A, -g[index])
        x_new = x[index] + step
        if normalise is not None:
            x_new = normalise(x_new)
        r_new, J_new = problem(x_new, index)
        cost_new = 0.5 * np.einsum("an,an->a", r_new, r_new)
        finite = np.isfinite(cost_new) & np.isfinite(J_new).all(axis=(1, 2))
        cost_new = np.where(finite, cost_new, np.inf)
        gain_expected = 0.5 * np.einsum("am,am->a", step, damping[index, None] * diagonal * step - g[index])
        gain = cost[index] - cost_new
        accept = finite & (gain >= 0.0)
        small_step = np.linalg.norm(step, axis=1) <= step_tolerance * (
            np.linalg.norm(x[index], axis=1) + step_tolerance
        )
        small_gain = accept & (np.maximum(gain, gain_expected) <= cost_tolerance * cost[index])
        ratio = np.where(accept, gain / np.maximum(gain_expected, floor), 0.0)
        taken = index[accept]
        x[taken], cost[taken] = x_new[accept], cost_new[accept]
        H[taken], g[taken] = _normal_equations(r_new[accept], J_new[accept])
        damping[taken] *= np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.minimum(ratio[accept], 1.0) - 1.0) ** 3)
        growth[taken] = 2.0
        refused = index[~accept]
        damping[refused] *= growth[refused]
        growth[refused] *= 2.0
        at_rest = flat(index)
        # A step may be small because nothing larger was accepted: that is no stationary point.
        forced = small_step & ~accept & (damping[index] > _HARD_DAMPING) & ~nearly_flat(index)
        stalled = (damping[index] > _LARGEST_DAMPING) | forced
        for condition, reason in (
            (small_gain, Stop.COST),
            (small_step, Stop.STEP),
            (stalled, Stop.STALLED),
            (at_rest, Stop.GRADIENT),
        ):
            stop[index[condition]] = reason
        index = index[~(stalled | small_gain | small_step | at_rest)]
    return LeastSquares(x, cost, iterations, stop)


def _normal_equations(r: Floats, J: Floats) -> tuple[Floats, Floats]:
    J_t = np.swapaxes(J, -1, -2)
    return J_t @ J, (J_t @ r[..., None])[..., 0]


def _solve(A: Floats, b: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.solve(A, b[..., None])[..., 0])
    except np.linalg.LinAlgError:
        # One singular problem must not stop the others.
        return np.asarray((np.linalg.pinv(A, hermitian=True) @ b[..., None])[..., 0])
