"""Levenberg–Marquardt where most unknowns couple to a few shared ones only: points and a motion, say.

Their equations have the shape of an arrow. Every step solves the shared unknowns' equations with the others
eliminated (Schur complement), so that the work grows with the number of the others and not with its cube.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from vmf.optimise.levenberg_marquardt import Stop

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_FIRST_DAMPING = 1e-4
_LARGEST_DAMPING = 1e16
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Equations:
    """Costs and normal equations of A problems with n groups of m unknowns q each, and f shared ones x.

    Attributes
    ----------
    cost : (A,).
    H_xx, H_xq, H_qq : (A, f, f), (A, n, f, m), (A, n, m, m).
    g_x, g_q : (A, f) and (A, n, m) gradients of the cost.
    """

    cost: Floats
    H_xx: Floats
    H_xq: Floats
    H_qq: Floats
    g_x: Floats
    g_q: Floats

    def of(self, which: Ints | Bools) -> Equations:
        """Return the equations of some of the problems."""
        return Equations(*(getattr(self, f.name)[which] for f in fields(self)))

    def put(self, which: Ints, other: Equations) -> None:
        """Overwrite the equations of some of the problems."""
        for field in fields(self):
            getattr(self, field.name)[which] = getattr(other, field.name)

    @property
    def steepness(self) -> Floats:
        """The largest cosine (A,) between the residuals and a column of the Jacobian."""
        scale = 2.0 * self.cost
        x = np.square(self.g_x) / (np.einsum("aii->ai", self.H_xx) * scale[:, None] + _TINY)
        q = np.square(self.g_q) / (np.einsum("anii->ani", self.H_qq) * scale[:, None, None] + _TINY)
        return np.asarray(np.sqrt(np.maximum(x.max(axis=1, initial=0.0), q.max(axis=(1, 2), initial=0.0))))

    def step(self, damping: Floats) -> tuple[Floats, Floats, Floats]:
        """Return steps (A, f) and (A, n, m) for dampings (A,), and the gain (A,) they promise."""
        d_x = _diagonal(np.einsum("aii->ai", self.H_xx)) * damping[:, None]
        d_q = _diagonal(np.einsum("anii->ani", self.H_qq)) * damping[:, None, None]
        H_xx, H_qq = self.H_xx.copy(), self.H_qq.copy()
        np.einsum("aii->ai", H_xx)[...] += d_x
        np.einsum("anii->ani", H_qq)[...] += d_q
        A, n, f, m = self.H_xq.shape
        H_qx = np.swapaxes(self.H_xq, -1, -2)
        gain = _solve(H_qq, np.concatenate([H_qx, self.g_q[..., None]], axis=-1))
        eliminated = self.H_xq.transpose(0, 2, 1, 3).reshape(A, f, m * n) @ gain.reshape(A, m * n, f + 1)
        S, b = H_xx - eliminated[..., :f], self.g_x - eliminated[..., f]
        x = -_solve(S, b[..., None])[..., 0]
        q = -(gain[..., f] + (gain[..., :f] @ x[:, None, :, None])[..., 0])
        promised = 0.5 * (x * (d_x * x - self.g_x)).sum(axis=1) + 0.5 * (q * (d_q * q - self.g_q)).sum(
            axis=(1, 2)
        )
        return x, q, promised


# problem(x (A, f), q (A, n, m), index (A,)) -> equations of the problems `index`; a cost that is not finite
# refuses the step that led there.
ArrowProblem = Callable[[Floats, Floats, Ints], Equations]


@dataclass(frozen=True)
class ArrowFit:
    """Minimisers of Q problems: x (Q, f), q (Q, n, m), cost, iterations and `Stop` values (Q,)."""

    x: Floats
    q: Floats
    cost: Floats
    iterations: Ints
    stop: Ints

    @property
    def converged(self) -> Bools:
        """Whether each problem ended at a stationary point."""
        return np.asarray(self.stop <= Stop.COST)


def minimise_arrow(
    problem: ArrowProblem,
    x: Floats,
    q: Floats,
    *,
    max_iterations: int = 100,
    gradient_tolerance: float = 1e-9,
    step_tolerance: float = 1e-11,
    cost_tolerance: float = 1e-13,
) -> ArrowFit:
    """Minimise the cost of each of Q problems, with damping and stopping of its own.

    Parameters
    ----------
    problem : costs and normal equations of the problems still running.
    x, q : (Q, f) and (Q, n, m) start points.
    max_iterations : steps tried at most.
    gradient_tolerance, step_tolerance, cost_tolerance : as for `levenberg_marquardt`.
    """
    x, q = np.array(x, float), np.array(q, float)
    everything = np.arange(len(x))
    now = problem(x, q, everything)
    stop = np.where(np.isfinite(now.cost), int(Stop.MAX_ITERATIONS), int(Stop.NOT_FINITE)).astype(np.int64)
    iterations = np.zeros(len(x), np.int64)
    damping, growth = np.full(len(x), _FIRST_DAMPING), np.full(len(x), 2.0)
    index = everything[np.isfinite(now.cost)]
    flat = now.of(index).steepness <= gradient_tolerance
    stop[index[flat]] = Stop.GRADIENT
    index = index[~flat]
    for _ in range(max_iterations):
        if not len(index):
            break
        iterations[index] += 1
        here = now.of(index)
        dx, dq, promised = here.step(damping[index])
        new = problem(x[index] + dx, q[index] + dq, index)
        gain = here.cost - np.where(np.isfinite(new.cost), new.cost, np.inf)
        accept = gain >= 0.0
        taken, refused = index[accept], index[~accept]
        x[taken] += dx[accept]
        q[taken] += dq[accept]
        now.put(taken, new.of(accept))
        ratio = np.minimum(gain[accept] / np.maximum(promised[accept], _TINY), 1.0)
        damping[taken] *= np.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        growth[taken] = 2.0
        damping[refused] *= growth[refused]
        growth[refused] *= 2.0
        small_gain = accept & (np.maximum(gain, promised) <= cost_tolerance * here.cost)
        small_step = np.linalg.norm(dx, axis=1) <= step_tolerance * (1.0 + np.linalg.norm(x[index], axis=1))
        small_step &= np.abs(dq).max(axis=(1, 2), initial=0.0) <= step_tolerance * (
            1.0 + np.abs(q[index]).max(axis=(1, 2), initial=0.0)
        )
        at_rest = now.of(index).steepness <= gradient_tolerance
        # A refused step that promised nothing is rounding.
        at_end = small_gain | (~accept & (promised <= cost_tolerance * here.cost))
        stalled = damping[index] > _LARGEST_DAMPING
        for condition, reason in (
            (stalled, Stop.STALLED),
            (at_end, Stop.COST),
            (small_step & accept, Stop.STEP),
            (at_rest, Stop.GRADIENT),
        ):
            stop[index[condition]] = reason
        index = index[~(stalled | at_end | (small_step & accept) | at_rest)]
    return ArrowFit(x, q, now.cost, iterations, stop)


def _diagonal(d: Floats) -> Floats:
    """Return a diagonal with ones where there is no influence, so that the step there is zero."""
    return np.where(d <= 1e-14 * d.max(axis=-1, keepdims=True, initial=0.0) + _TINY, 1.0, d)


def _solve(A: Floats, b: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.solve(A, b))
    except np.linalg.LinAlgError:
        # One singular problem must not stop the others.
        return np.asarray(np.linalg.pinv(A, hermitian=True) @ b)
