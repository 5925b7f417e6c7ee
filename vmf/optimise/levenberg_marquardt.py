"""Levenberg–Marquardt over a batch of problems, each with its own damping and its own end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
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
_TINY = np.finfo(float).tiny


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
    n_problems = len(x)
    stop = np.full(n_problems, int(Stop.MAX_ITERATIONS), dtype=np.int64)
    iterations = np.zeros(n_problems, dtype=np.int64)
    index = np.arange(n_problems)
    r, J = problem(x, index)
    cost = 0.5 * np.einsum("qn,qn->q", r, r)
    H, g = _normal_equations(r, J)
    now = _State(x, cost, H, g, np.full(n_problems, _FIRST_DAMPING), np.full(n_problems, 2.0))
    alive = np.isfinite(cost) & np.isfinite(now.diagonal).all(axis=1)
    stop[~alive] = Stop.NOT_FINITE
    done = alive & now.flat(gradient_tolerance)
    stop[done] = Stop.GRADIENT
    x, cost = now.x.copy(), now.cost.copy()
    index, now = index[alive & ~done], now.some(alive & ~done)
    for iteration in range(1, max_iterations + 1):
        if len(index) == 0:
            break
        step, gain_expected = now.step()
        x_new = now.x + step
        if normalise is not None:
            x_new = normalise(x_new)
        r, J = problem(x_new, index)
        cost_new = 0.5 * np.einsum("an,an->a", r, r)
        H, g = _normal_equations(r, J)
        finite = np.isfinite(cost_new) & np.isfinite(_diagonal(H)).all(axis=1)
        gain = now.cost - np.where(finite, cost_new, np.inf)
        accept = finite & (gain >= 0.0)
        small_step = _norm(step) <= step_tolerance * (_norm(now.x) + step_tolerance)
        small_gain = accept & (np.maximum(gain, gain_expected) <= cost_tolerance * now.cost)
        ratio = np.where(accept, gain / np.maximum(gain_expected, _TINY), 0.0)
        easier = np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.minimum(ratio, 1.0) - 1.0) ** 3)
        damping = now.damping * np.where(accept, easier, now.growth)
        growth = np.where(accept, 2.0, 2.0 * now.growth)
        now = now.replaced(accept, _State(x_new, cost_new, H, g, damping, growth))
        at_rest = now.flat(gradient_tolerance)
        # A step may be small because nothing larger was accepted: that is no stationary point.
        forced = small_step & ~accept & (now.damping > _HARD_DAMPING)
        if forced.any():
            forced &= ~now.nearly_flat()
        stalled = (now.damping > _LARGEST_DAMPING) | forced
        ended = stalled | small_gain | small_step | at_rest
        if ended.any() or iteration == max_iterations:
            x[index], cost[index], iterations[index] = now.x, now.cost, iteration
            for condition, reason in (
                (small_gain, Stop.COST),
                (small_step, Stop.STEP),
                (stalled, Stop.STALLED),
                (at_rest, Stop.GRADIENT),
            ):
                stop[index[condition]] = reason
            index, now = index[~ended], now.some(~ended)
    return LeastSquares(x, cost, iterations, stop)


@dataclass(frozen=True)
class _State:
    """Problems still running: points, costs, normal equations, and how damping goes."""

    x: Floats
    cost: Floats
    H: Floats
    g: Floats
    damping: Floats
    growth: Floats

    @property
    def diagonal(self) -> Floats:
        return _diagonal(self.H)

    def some(self, which: NDArray[np.bool_]) -> _State:
        return _State(*(getattr(self, f.name)[which] for f in fields(self)))

    def replaced(self, accept: NDArray[np.bool_], new: _State) -> _State:
        """Return the new state where it is accepted; damping is new in any case."""
        if accept.all():
            return new

        def chosen(one: Floats, other: Floats) -> Floats:
            return np.where(accept.reshape(-1, *[1] * (one.ndim - 1)), one, other)

        x, cost = chosen(new.x, self.x), chosen(new.cost, self.cost)
        return _State(x, cost, chosen(new.H, self.H), chosen(new.g, self.g), new.damping, new.growth)

    def step(self) -> tuple[Floats, Floats]:
        """Return damped steps (A, m) and the gains that they promise (A,)."""
        diagonal = self.diagonal
        # Columns without any influence get unit damping, so that their step is zero and not undefined.
        blind = diagonal <= 1e-14 * diagonal.max(axis=1, keepdims=True) + _TINY
        scaled = self.damping[:, None] * np.where(blind, 1.0, diagonal)
        A = self.H.copy()
        np.einsum("aii->ai", A)[...] += scaled
        step = _solve(A, -self.g)
        return step, 0.5 * np.einsum("am,am->a", step, scaled * step - self.g)

    def flat(self, tolerance: float) -> NDArray[np.bool_]:
        scale = np.sqrt(self.diagonal * (2.0 * self.cost[:, None]))
        return np.asarray((np.abs(self.g) <= tolerance * scale + _TINY).all(axis=1))

    def nearly_flat(self) -> NDArray[np.bool_]:
        # Residuals that the last bits of x make cannot be told from none.
        size = np.sqrt(self.diagonal.sum(axis=1)) * (1.0 + _norm(self.x))
        return np.asarray(self.flat(_NEARLY_FLAT) | (np.sqrt(2.0 * self.cost) <= _ROUNDING * size))


def _diagonal(H: Floats) -> Floats:
    return np.asarray(np.einsum("aii->ai", H))


def _norm(x: Floats) -> Floats:
    return np.asarray(np.sqrt(np.einsum("am,am->a", x, x)))


def _normal_equations(r: Floats, J: Floats) -> tuple[Floats, Floats]:
    J_t = np.swapaxes(J, -1, -2)
    return J_t @ J, (J_t @ r[..., None])[..., 0]


def _solve(A: Floats, b: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.solve(A, b[..., None])[..., 0])
    except np.linalg.LinAlgError:
        # One singular problem must not stop the others.
        return np.asarray((np.linalg.pinv(A, hermitian=True) @ b[..., None])[..., 0])
