"""From parameters and image-based errors to one motion (§3.2), for many queries at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.estimate import depth_ratio_at_rest
from vmf.geometry import motion
from vmf.optimise import LeastSquares, Stop, levenberg_marquardt
from vmf.solve.costs import COSTS
from vmf.solve.solution import Solutions, StopReason
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_RANK_TOLERANCE = 1e-9
_STOPS = {
    Stop.MAX_ITERATIONS: StopReason.MAX_ITERATIONS,
    Stop.STALLED: StopReason.DIVERGED,
    Stop.NOT_FINITE: StopReason.BEHIND_CAMERA,
}


@dataclass(frozen=True)
class SolverOptions:
    """How to solve: see `solver:` in a spec.

    Attributes
    ----------
    cost : name of the cost.
    cameras : whose equations to use.
    start : `zero`, `linear` (lifted linear solution), or `multi`: these, and the algebraic solution for
        other costs, keeping the lowest cost.
    known_rotation : the rotation of each motion is given and only its translation is solved for.
    max_iterations : Levenberg–Marquardt steps per start.
    noise_px : standard deviation of an error's coordinate, for the covariance; None takes the residuals'.
    """

    cost: str = "geometric"
    cameras: Literal["left", "right", "both"] = "both"
    start: Literal["zero", "linear", "multi"] = "multi"
    known_rotation: bool = False
    max_iterations: int = 100
    noise_px: float | None = None


# Parameters may be anything: what overflows is not finite, and ends as a reason.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def solve(
    task: Task,
    rows: ArrayLike,
    errors: ArrayLike,
    E_c: ArrayLike,
    options: SolverOptions | None = None,
    R_known: ArrayLike | None = None,
) -> Solutions:
    """Solve for the motions that make given image-based errors.

    Parameters
    ----------
    task : the task space.
    rows : (Q, n, 2, 3, k+1) parameters of n targets in both cameras, any gauge; NaN where unknown.
    errors : (Q, n, 2, 2) image-based errors in px, left and right; NaN where not seen.
    E_c : (Q, 4, 4) poses `E_S_from_W` at the start of each motion.
    options : cost, cameras, starts.
    R_known : (Q, 3, 3) rotations of the motions, for `known_rotation`.

    Returns
    -------
    Solutions
        One per query, with the reason where there is no motion.
    """
    options = options or SolverOptions()
    rows, errors, E_c = (np.asarray(a, float) for a in (rows, errors, E_c))
    if options.known_rotation and all(unit == "rad" for _, unit in task.components):
        raise ValueError(f"known_rotation leaves nothing to solve for in {task.name}")
    rows, errors, has_rows = _usable(task, rows, errors, options)
    problem = _Problem(task, rows, errors, E_c, options, R_known)
    seen = ~np.isnan(errors[..., 0])
    n_equations = 2 * seen.sum(axis=1)
    reason = np.full(len(rows), StopReason.CONVERGED, dtype=object)
    least = 1 if options.known_rotation else task.least_targets
    n_cameras = 2 if options.cameras == "both" else 1
    n_targets = seen.reshape(len(seen), seen.shape[1] // n_cameras, n_cameras).any(axis=2).sum(axis=1)
    too_few = (n_equations < problem.n_free) | (n_targets < least)
    reason[too_few] = StopReason.TOO_FEW_EQUATIONS
    reason[~has_rows] = StopReason.NO_PARAMETERS
    ask = np.nonzero(reason == StopReason.CONVERGED)[0]
    m = task.n_motion
    out = _Outcome.empty(len(rows), m)
    if len(ask):
        _solve_asked(problem, ask, reason, out)
    failed = reason != StopReason.CONVERGED
    out.p[failed] = np.nan
    E = task.motion(np.where(failed[:, None], 0.0, out.p), E_c)
    E[failed] = np.nan
    out.covariance[failed] = np.nan
    return Solutions(E, out.p, out.covariance, out.residual_px, out.iterations, out.condition, reason)


@dataclass(frozen=True)
class _Outcome:
    p: Floats
    covariance: Floats
    residual_px: Floats
    iterations: Ints
    condition: Floats

    @classmethod
    def empty(cls, Q: int, m: int) -> _Outcome:
        nan = np.full(Q, np.nan)
        return cls(
            np.full((Q, m), np.nan), np.full((Q, m, m), np.nan), nan, np.zeros(Q, np.int64), nan.copy()
        )


def _usable(
    task: Task, rows: Floats, errors: Floats, options: SolverOptions
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Flatten targets × cameras, orient rows to positive depth, and blank what cannot be used."""
    Q, n = rows.shape[:2]
    camera = {"left": [0], "right": [1], "both": [0, 1]}[options.cameras]
    flat = rows[:, :, camera].reshape(Q, n * len(camera), 3, rows.shape[-1])
    e = errors[:, :, camera].reshape(Q, n * len(camera), 2)
    at_rest = depth_ratio_at_rest(flat, task.identity_lift)
    known = np.isfinite(flat).all(axis=(-1, -2)) & (at_rest != 0.0)
    # The thesis gauge may be negative; what is visible at rest has a positive depth ratio there.
    flat = np.where(known[..., None, None], flat * np.sign(at_rest)[..., None, None], 0.0)
    wanted = np.isfinite(e).all(axis=-1)
    e = np.where((known & wanted)[..., None], e, np.nan)
    answerable = np.any(known & wanted, axis=1) | ~np.any(wanted, axis=1)
    return flat, e, np.asarray(answerable)


class _Problem:
    """The residuals of all queries as functions of the free unknowns of their motions."""

    def __init__(
        self,
        task: Task,
        rows: Floats,
        errors: Floats,
        E_c: Floats,
        options: SolverOptions,
        R_known: ArrayLike | None,
    ) -> None:
        self.task, self.rows, self.E_c, self.options = task, rows, E_c, options
        self.seen = ~np.isnan(errors[..., 0])
        self.errors = np.where(self.seen[..., None], errors, 0.0)
        self.cost = COSTS[options.cost]
        self.given = np.zeros((len(rows), task.n_motion))
        self.free = np.ones(task.n_motion, bool)
        if options.known_rotation:
            if R_known is None:
                raise ValueError("known_rotation needs the rotations")
            E = motion.from_rotation_translation(np.asarray(R_known, float), np.zeros(3))
            self.given = task.coordinates(E, E_c)
            self.free = np.array([unit == "m" for _, unit in task.components])
        self.n_free = int(self.free.sum())

    def full(self, x: Floats, index: Ints) -> Floats:
        """Return all unknowns p (A, m) from the free ones (A, n_free)."""
        p = self.given[index].copy()
        p[:, self.free] = x
        return p

    def residuals(self, x: Floats, index: Ints, cost: str | None = None) -> tuple[Floats, Floats]:
        p = self.full(x, index)
        E_c = self.E_c[index]
        x_bar = self.task.lift(self.task.motion(p, E_c))
        J_lift = self.task.lift_jacobian(p, E_c)[..., self.free]
        function = self.cost if cost is None else COSTS[cost]
        seen = self.seen[index][..., None]
        rows = np.where(seen[..., None], self.rows[index], self._blank)
        r, V = function(rows, self.errors[index], x_bar)
        r, V = np.where(seen, r, 0.0), np.where(seen[..., None], V, 0.0)
        J = V.reshape(len(index), -1, V.shape[-1]) @ J_lift
        return r.reshape(len(index), -1), J

    @property
    def _blank(self) -> Floats:
        blank = np.zeros((3, self.task.n_lift + 1))
        blank[2, -1] = 1.0
        return blank

    def depth_ratios(self, x: Floats, index: Ints) -> Floats:
        """Return `c·x̄` (A, C), positive in front of the camera, 1 where nothing is seen."""
        x_bar = self.task.lift(self.task.motion(self.full(x, index), self.E_c[index]))
        c = self.rows[index][..., 2, :]
        return np.where(self.seen[index], (c @ x_bar[..., None])[..., 0], 1.0)

    def linear_start(self, index: Ints) -> Floats:
        """Return the free unknowns nearest to the lifted linear solution (§6)."""
        rest = self.task.identity_lift
        x_bar = np.broadcast_to(rest, (len(index), len(rest)))
        rows = np.where(self.seen[index][..., None, None], self.rows[index], 0.0)
        r, V = COSTS["algebraic"](rows, self.errors[index], x_bar)
        A = V[..., :-1].reshape(len(index), -1, len(rest) - 1)
        size = np.linalg.norm(A, axis=1)
        # Numbers too large to square have no start of their own.
        usable = np.isfinite(size).all(axis=1) & np.isfinite(r).all(axis=(1, 2))
        A, r = np.where(usable[:, None, None], A, 0.0), np.where(usable[:, None, None], r, 0.0)
        size = np.where(usable[:, None] & (size > 0.0), size, 1.0)
        U, s, Vt = np.linalg.svd(A / size[:, None, :])
        n = s.shape[1]
        # The change of the lift from rest, of minimum norm where the equations leave it free.
        kept = s > 1e-8 * s[:, :1]
        z = -(np.swapaxes(U, -1, -2)[:, :n] @ r.reshape(len(index), -1, 1))[..., 0]
        delta = ((z * kept / np.where(kept, s, 1.0))[:, None, :] @ Vt[:, :n])[:, 0] / size
        x = self._with_unit_rotation(rest[:-1] + delta, Vt[:, -1] / size)
        x = np.where(np.isfinite(x).all(axis=1, keepdims=True), x, rest[:-1])
        lifted = np.concatenate([x, np.ones((len(index), 1))], axis=1)
        return np.asarray(self.task.project(self.task.unlift(lifted), self.E_c[index])[:, self.free])

    def _with_unit_rotation(self, x: Floats, weakest: Floats) -> Floats:
        """Move lifts (A, k) along their weakest direction until their rotation has the norm of one.

        One camera sees no scale about its own centre: "every point in the centre" (R = 0) solves its
        equations best, and the motion lies along the weakest direction from there.
        """
        if self.task.name != "six_dof":
            return x
        rotation = slice(0, 9)
        a = np.square(weakest[:, rotation]).sum(axis=1)
        b = (weakest[:, rotation] * x[:, rotation]).sum(axis=1)
        c = np.square(x[:, rotation]).sum(axis=1) - 3.0
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        ends = np.stack([(-b + sign * root) / np.where(a > 0.0, a, np.inf) for sign in (1.0, -1.0)])
        candidates = x + ends[..., None] * weakest
        R = candidates[..., rotation].reshape(*ends.shape, 3, 3)
        best = np.linalg.det(np.where(np.isfinite(R), R, 0.0)).argmax(axis=0)
        return np.asarray(candidates[best, np.arange(len(x))])

    def minimise(self, start: Floats, index: Ints, cost: str | None = None) -> LeastSquares:
        """Return the minimisers of the queries `index` from start points (A, n_free)."""

        def problem(x: Floats, running: Ints) -> tuple[Floats, Floats]:
            return self.residuals(x, index[running], cost)

        return levenberg_marquardt(problem, start, max_iterations=self.options.max_iterations)


def _solve_asked(problem: _Problem, ask: Ints, reason: NDArray[np.object_], out: _Outcome) -> None:
    options, task = problem.options, problem.task
    starts = []
    if options.start in ("zero", "multi"):
        starts.append(np.zeros((len(ask), problem.n_free)))
    if options.start in ("linear", "multi"):
        starts.append(problem.linear_start(ask))
    fits = [problem.minimise(start, ask) for start in starts]
    if options.start == "multi" and options.cost != "algebraic":
        # The algebraic cost has no pole at zero depth, so it comes home from farther away.
        linear = problem.minimise(starts[-1], ask, "algebraic")
        fits.append(problem.minimise(linear.x, ask))
    cost = np.stack([fit.cost for fit in fits])
    # A fit that ended behind a camera, or not at all, loses against one that ended well.
    ended = np.stack([fit.converged for fit in fits])
    front = np.stack([(problem.depth_ratios(fit.x, ask) > 0.0).all(axis=1) for fit in fits])
    possible = np.stack([task.plausible(problem.full(fit.x, ask), problem.E_c[ask]) for fit in fits])
    finite = np.where(np.isfinite(cost), cost, np.inf)
    order = np.lexsort((finite, ~possible, ~(ended & front)), axis=0)[0]
    pick = (order, np.arange(len(ask)))
    x = np.stack([fit.x for fit in fits])[pick]
    # One name for each motion: angles may have run past π/2 or round the circle.
    E = task.motion(problem.full(x, ask), problem.E_c[ask])
    x = task.coordinates(E, problem.E_c[ask])[:, problem.free]
    stop = np.stack([fit.stop for fit in fits])[pick]
    out.iterations[ask] = np.stack([fit.iterations for fit in fits]).sum(axis=0)
    out.p[ask] = problem.full(x, ask)
    for code, why in _STOPS.items():
        reason[ask[stop == code]] = why
    behind = ~front[pick] & (reason[ask] != StopReason.MAX_ITERATIONS)
    reason[ask[behind]] = StopReason.BEHIND_CAMERA
    r, _ = problem.residuals(x, ask, "geometric")
    n_equations = 2 * problem.seen[ask].sum(axis=1)
    out.residual_px[ask] = np.sqrt(np.square(r).sum(axis=1) / n_equations)
    _covariances(problem, x, ask, reason, out)


def _covariances(problem: _Problem, x: Floats, ask: Ints, reason: NDArray[np.object_], out: _Outcome) -> None:
    """First-order covariance of p from noise in the errors, and the rank of the equations."""
    good = reason[ask] == StopReason.CONVERGED
    x, ask = x[good], ask[good]
    if not len(ask):
        return
    _, J = problem.residuals(x, ask)
    size = np.linalg.norm(J, axis=1)
    scaled = J / np.where(size > 0.0, size, 1.0)[:, None, :]
    s = np.linalg.svd(scaled, compute_uv=False)
    with np.errstate(divide="ignore"):
        out.condition[ask] = np.where(s[:, -1] > 0.0, s[:, 0] / s[:, -1], np.inf)
    deficient = (s[:, -1] <= _RANK_TOLERANCE * s[:, 0]) | (size <= 0.0).any(axis=1)
    reason[ask[deficient]] = StopReason.RANK_DEFICIENT
    x, ask, J = x[~deficient], ask[~deficient], J[~deficient]
    if not len(ask):
        return
    n_equations = 2 * problem.seen[ask].sum(axis=1)
    spare = n_equations - problem.n_free
    sigma = out.residual_px[ask] * np.sqrt(n_equations / np.maximum(spare, 1))
    if problem.options.noise_px is not None:
        sigma = np.full(len(ask), problem.options.noise_px)
    sigma = np.where((spare > 0) | (problem.options.noise_px is not None), sigma, np.nan)
    # p̂ = −(JᵀJ)⁻¹Jᵀ r; an algebraic residual carries its error times the depth ratio.
    U, s, Vt = np.linalg.svd(scaled[~deficient], full_matrices=False)
    gain = np.swapaxes(Vt, -1, -2) / s[:, None, :] @ np.swapaxes(U, -1, -2) / size[~deficient][:, :, None]
    weight = problem.depth_ratios(x, ask) if problem.options.cost == "algebraic" else np.ones(1)
    weight = np.broadcast_to(weight, problem.seen[ask].shape)
    gain = gain * np.repeat(weight, 2, axis=1)[:, None, :]
    free = np.nonzero(problem.free)[0]
    covariance = np.zeros((len(ask), *out.covariance.shape[1:]))
    covariance[:, free[:, None], free] = gain @ np.swapaxes(gain, -1, -2) * np.square(sigma)[:, None, None]
    out.covariance[ask] = covariance
