"""From parameters and image-based errors to one motion (§3.2), for many queries at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.estimate import sign_at_rest
from vmf.optimise import LeastSquares, levenberg_marquardt
from vmf.solve.costs import COSTS
from vmf.solve.lifted_views import LiftedViews
from vmf.solve.outcome import Draft
from vmf.solve.solution import Solutions, StopReason
from vmf.solve.unknowns import Unknowns
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_RANK_TOLERANCE = 1e-9


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
    if options.known_rotation and R_known is None:
        raise ValueError("known_rotation needs the rotations")
    unknowns = Unknowns.of(task, E_c, R_known if options.known_rotation else None)
    flat, e, has_rows = _usable(task, rows, errors, options)
    problem = _Problem(unknowns, flat, e, options)
    n_cameras = 2 if options.cameras == "both" else 1
    used = np.asarray(problem.seen.reshape(*rows.shape[:2], n_cameras).any(axis=2))
    reason = np.full(len(rows), StopReason.CONVERGED, dtype=object)
    least = 1 if options.known_rotation else task.least_targets
    too_few = (problem.n_equations < unknowns.n_free) | (used.sum(axis=1) < least)
    reason[too_few] = StopReason.TOO_FEW_EQUATIONS
    reason[~has_rows] = StopReason.NO_PARAMETERS
    draft = Draft.of(unknowns, reason, used)
    if len(draft.asked):
        _solve_asked(problem, draft)
        _covariances(problem, draft)
    return draft.solutions()


def _usable(
    task: Task, rows: Floats, errors: Floats, options: SolverOptions
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Flatten targets × cameras, orient rows to positive depth, and blank what cannot be used."""
    Q, n = rows.shape[:2]
    camera = {"left": [0], "right": [1], "both": [0, 1]}[options.cameras]
    flat = rows[:, :, camera].reshape(Q, n * len(camera), 3, rows.shape[-1])
    e = errors[:, :, camera].reshape(Q, n * len(camera), 2)
    sign = sign_at_rest(flat, task.identity_lift)
    known = np.isfinite(flat).all(axis=(-1, -2)) & (sign[..., 0, 0] != 0.0)
    flat = np.where(known[..., None, None], flat * sign, np.nan)
    wanted = np.isfinite(e).all(axis=-1)
    e = np.where((known & wanted)[..., None], e, np.nan)
    answerable = np.any(known & wanted, axis=1) | ~np.any(wanted, axis=1)
    return flat, e, np.asarray(answerable)


class _Problem:
    """The residuals of all queries as functions of the free unknowns of their motions."""

    def __init__(self, unknowns: Unknowns, rows: Floats, errors: Floats, options: SolverOptions) -> None:
        self.unknowns, self.task, self.options = unknowns, unknowns.task, options
        self.seen = ~np.isnan(errors[..., 0])
        self.rows = np.where(self.seen[..., None, None], rows, 0.0)
        self.errors = np.where(self.seen[..., None], errors, 0.0).swapaxes(1, 2)
        self._views = LiftedViews.of(unknowns, rows, self.seen)

    @property
    def n_equations(self) -> Ints:
        """Equations (Q,)."""
        return np.asarray(2 * self.seen.sum(axis=1))

    def residuals(self, x: Floats, index: Ints, cost: str | None = None) -> tuple[Floats, Floats]:
        """Return residuals (A, 2C), all in x before all in y, and their Jacobians (A, 2C, f)."""
        W, errors = self._views.at(x, index), self.errors[index]
        r, J = COSTS[cost or self.options.cost](W, errors)
        A, n = len(index), 2 * errors.shape[-1]
        return r.reshape(A, n), J.reshape(A, J.shape[1], n).swapaxes(1, 2)

    def depth_ratios(self, x: Floats, index: Ints) -> Floats:
        """Return `c·x̄` (A, C), positive in front of the camera, 1 where nothing is seen."""
        return self._views.depth_ratios(x, index)

    def linear_start(self, index: Ints) -> Floats:
        """Return the free unknowns nearest to the lifted linear solution (§6)."""
        rest = self.task.identity_lift
        rows, e = self.rows[index], self.errors[index].swapaxes(1, 2)
        A = (rows[..., :2, :] - e[..., None] * rows[..., 2:, :]).reshape(len(index), -1, len(rest))
        r, A = (A @ rest[:, None])[..., 0], A[..., :-1]
        size = np.linalg.norm(A, axis=1)
        # Numbers too large to square have no start of their own.
        usable = np.isfinite(size).all(axis=1) & np.isfinite(r).all(axis=1)
        A, r = np.where(usable[:, None, None], A, 0.0), np.where(usable[:, None], r, 0.0)
        size = np.where(usable[:, None] & (size > 0.0), size, 1.0)
        U, s, Vt = np.linalg.svd(A / size[:, None, :])
        n = s.shape[1]
        # The change of the lift from rest, of minimum norm where the equations leave it free.
        kept = s > 1e-8 * s[:, :1]
        z = -(np.swapaxes(U, -1, -2)[:, :n] @ r[..., None])[..., 0]
        delta = ((z * kept / np.where(kept, s, 1.0))[:, None, :] @ Vt[:, :n])[:, 0] / size
        x = self._with_unit_rotation(rest[:-1] + delta, Vt[:, -1] / size)
        x = np.where(np.isfinite(x).all(axis=1, keepdims=True), x, rest[:-1])
        lifted = np.concatenate([x, np.ones((len(index), 1))], axis=1)
        return self.unknowns.project(self.task.unlift(lifted), index)

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


def _solve_asked(problem: _Problem, draft: Draft) -> None:
    options, unknowns, ask = problem.options, problem.unknowns, draft.asked
    starts = []
    if options.start in ("zero", "multi"):
        starts.append(np.zeros((len(ask), unknowns.n_free)))
    if options.start in ("linear", "multi"):
        starts.append(problem.linear_start(ask))
    fits = [problem.minimise(start, ask) for start in starts]
    if options.start == "multi" and options.cost != "algebraic":
        # The algebraic cost has no pole at zero depth, so it comes home from farther away.
        linear = problem.minimise(starts[-1], ask, "algebraic")
        fits.append(problem.minimise(linear.x, ask))
    # A fit that ended behind a camera, or not at all, loses against one that ended well.
    front = np.stack([(problem.depth_ratios(fit.x, ask) > 0.0).all(axis=1) for fit in fits])
    ended = np.stack([fit.converged for fit in fits])
    p = [unknowns.full(fit.x, ask) for fit in fits]
    possible = np.stack([problem.task.plausible(motion, unknowns.E_c[ask]) for motion in p])
    best = draft.take(fits, ask, [~(ended & front), ~possible])
    behind = ~front[best] & (draft.reason[ask] != StopReason.MAX_ITERATIONS)
    draft.reason[ask[behind]] = StopReason.BEHIND_CAMERA
    r, _ = problem.residuals(draft.x[ask], ask, "geometric")
    draft.residual_px[ask] = np.sqrt(np.square(r).sum(axis=1) / problem.n_equations[ask])


def _covariances(problem: _Problem, draft: Draft) -> None:
    """First-order covariance of p from noise in the errors, and the rank of the equations."""
    asked, noise_px = draft.asked, problem.options.noise_px
    x = draft.x[asked]
    _, J = problem.residuals(x, asked)
    size = np.linalg.norm(J, axis=1)
    J = J / np.where(size > 0.0, size, 1.0)[:, None, :]
    _, s, Vt = np.linalg.svd(np.linalg.qr(J, mode="r"))
    draft.check_rank(s, size, asked, _RANK_TOLERANCE)
    regular = draft.reason[asked] == StopReason.CONVERGED
    ask, x, J, s, Vt, size = (a[regular] for a in (asked, x, J, s, Vt, size))
    n_equations = problem.n_equations[ask]
    spare = n_equations - problem.unknowns.n_free
    if noise_px is None:
        sigma = draft.residual_px[ask] * np.sqrt(n_equations / np.maximum(spare, 1))
        sigma = np.where(spare > 0, sigma, np.nan)
    else:
        sigma = np.full(len(ask), noise_px)
    # p̂ = −(JᵀJ)⁻¹Jᵀ r; an algebraic residual carries its error times the depth ratio.
    gain = np.swapaxes(Vt, -1, -2) / s[:, None, :]
    if problem.options.cost == "algebraic":
        U_t = np.swapaxes(J @ gain, -1, -2)
        gain = gain @ (U_t * np.tile(problem.depth_ratios(x, ask), 2)[:, None, :])
    gain = gain / size[:, :, None]
    draft.covariance[ask] = gain @ np.swapaxes(gain, -1, -2) * np.square(sigma)[:, None, None]
