"""Two-view maximum likelihood over points and motion: with exact cameras, the Cramér–Rao benchmark.

For a given motion every target is a triangulation of its own, from up to four views. The cost that is left
depends on the motion alone, with the Jacobian `J_x` less its projection on the point's `J_q` (variable
projection: Golub and Pereyra 1973, Kaufman 1975), so that the work grows with the number of targets and
`JᵀJ` is the Schur complement of the full problem.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.geometry import StereoCameras, motion
from vmf.geometry.triangulate import (
    homogeneous,
    locate,
    point_from_q,
    project_derivative,
    reproject,
    triangulate,
)
from vmf.optimise import LeastSquares, levenberg_marquardt
from vmf.reconstruct.arun import triangulate_arun
from vmf.reconstruct.outcome import Draft, refusals
from vmf.reconstruct.pnp import pnp
from vmf.reconstruct.unknowns import Unknowns
from vmf.solve import Query, Solutions, StopReason
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def bundle(
    task: Task,
    cameras: StereoCameras,
    query: Query,
    *,
    known_rotation: bool = False,
    noise_px: float | None = None,
) -> Solutions:
    """Return the motions of least reprojection error over both views, both cameras and all points.

    A target needs both cameras in one view and at least one in the other. Starts are the answers of `pnp`
    and of `triangulate_arun`. The covariance is the motion's block of σ²(JᵀJ)⁻¹ of the whole problem, with
    σ from the residuals without `noise_px`.
    """
    problem = TwoViews(task, cameras, query, known_rotation)
    unknowns = problem.unknowns
    draft = Draft.of(unknowns, problem.refusals())
    index = draft.asked
    some = query.select(index)
    fits = []
    for method in (pnp, triangulate_arun):
        p = method(task, cameras, some, known_rotation=known_rotation).p[:, unknowns.free]
        # A method that could not be asked leaves the start at no motion.
        fits.append(problem.minimise(np.where(np.isfinite(p), p, 0.0), index))
    draft.take(fits, index)
    _finish(problem, draft, noise_px)
    return draft.solutions()


class TwoViews:
    """The reprojection errors of all targets, each at its best point, as functions of the motion."""

    def __init__(self, task: Task, cameras: StereoCameras, query: Query, known_rotation: bool) -> None:
        self.unknowns = Unknowns.of(task, query, known_rotation)
        self.cameras = cameras
        self.B = point_from_q(cameras)
        before, after = triangulate(cameras, query.initial), triangulate(cameras, query.desired)
        self.from_initial = before.ok
        self.q = np.where(before.ok[..., None], before.q, after.q)
        pixels = np.concatenate([query.initial, query.desired], axis=-1)
        # Targets × (left, right at the start; left, right at the goal) × (x, y).
        self.pixels = pixels.reshape(*pixels.shape[:-1], 4, 2)
        seen = np.isfinite(self.pixels).all(axis=-1)
        in_both_views = seen[..., :2].any(axis=-1) & seen[..., 2:].any(axis=-1)
        self.in_stereo = np.asarray(in_both_views & (seen.sum(axis=-1) >= 3))
        self.used = np.asarray(self.in_stereo & (before.ok | after.ok))
        self.pixels[~(seen & self.used[..., None])] = np.nan

    @property
    def n_equations(self) -> Ints:
        """Coordinates seen (Q,), in both views and both cameras."""
        return np.asarray(np.isfinite(self.pixels).sum(axis=(1, 2, 3)))

    @property
    def n_spare(self) -> Ints:
        """Equations (Q,) beyond the unknowns of points and motion."""
        return np.asarray(self.n_equations - 3 * self.used.sum(axis=1) - self.unknowns.n_free)

    def refusals(self) -> NDArray[np.object_]:
        """Return why queries (Q,) cannot be asked, `CONVERGED` for those that can."""
        reason = refusals(self.used, self.in_stereo, self.unknowns.fewest_targets)
        reason[(self.n_spare < 0) & self.used.any(axis=1)] = StopReason.TOO_FEW_EQUATIONS
        return reason

    def minimise(self, start: Floats, index: Ints) -> LeastSquares:
        """Minimise over the motions of the queries `index` from start points (A, f)."""
        return levenberg_marquardt(lambda x, running: self.residuals(x, index[running]), start)

    def residuals(self, x: Floats, index: Ints) -> tuple[Floats, Floats]:
        """Return reprojection errors (A, 8n) in px and their Jacobian (A, 8n, f) in the motion."""
        E, dE = self.unknowns.motion(x, index), self.unknowns.motion_jacobian(x, index)
        a, j = np.nonzero(self.used[index])
        pixels = self.pixels[index[a], j]
        M = self.cameras.M
        views = np.empty((len(a), 4, 3, 4))
        views[:, :2], views[:, 2:] = M @ self.B, (M @ (E @ self.B)[:, None])[a]
        fit = locate(views, pixels, self._start(E, index, a, j))
        predicted, J_q, depth = reproject(views, fit.x)
        # ∂(M E' B q)/∂x for the desired view; the initial view does not depend on the motion.
        point = homogeneous(fit.x) @ self.B.T
        dh = np.einsum("vri,tfij,tj->tvrf", M, dE[a], point)
        J_x = np.zeros((len(a), 4, 2, dh.shape[-1]))
        J_x[:, 2:] = project_derivative(dh, predicted[:, 2:], depth[:, 2:])
        seen = np.isfinite(pixels)
        r = np.where(seen, predicted - pixels, 0.0).reshape(len(a), 8)
        J_q = np.where(seen[..., None], J_q, 0.0).reshape(len(a), 8, 3)
        J_x = np.where(seen[..., None], J_x, 0.0).reshape(len(a), 8, dh.shape[-1])
        A, n = self.used[index].shape
        r_all, J_all = np.zeros((A, n, 8)), np.zeros((A, n, 8, dh.shape[-1]))
        r_all[a, j], J_all[a, j] = r, _without(J_q, J_x)
        return r_all.reshape(A, 8 * n), J_all.reshape(A, 8 * n, dh.shape[-1])

    def _start(self, E: Floats, index: Ints, a: Ints, j: Ints) -> Floats:
        """Return q (T, 3) to start from; points of the desired view are carried back by the motion."""
        q = self.q[index[a], j]
        later = ~self.from_initial[index[a], j]
        if not later.any():
            return q
        back = np.linalg.solve(self.B, motion.inverse(E[a[later]]) @ self.B)
        h = (back @ homogeneous(q[later])[..., None])[..., 0]
        q[later] = h[:, [0, 1, 3]] / np.where(h[:, 2:3] > 0.0, h[:, 2:3], np.nan)
        return q


def _without(J_q: Floats, J_x: Floats) -> Floats:
    """Return `J_x` (T, 8, f) less what a change of the point, `J_q` (T, 8, 3), makes up for."""
    span = np.linalg.qr(J_q).Q
    return np.asarray(J_x - span @ (np.swapaxes(span, -1, -2) @ J_x))


def _finish(problem: TwoViews, draft: Draft, noise_px: float | None) -> None:
    """Enter residuals, rank and covariances at the minimisers."""
    index = draft.asked
    r, J = problem.residuals(draft.x[index], index)
    square = np.square(r).sum(axis=1)
    draft.residual_px[index] = np.sqrt(square / problem.n_equations[index])
    draft.check_rank(J, index)
    good = draft.reason[index] == StopReason.CONVERGED
    index, square, J = index[good], square[good], J[good]
    spare = problem.n_spare[index].astype(float)
    spare[spare == 0.0] = np.nan
    variance = square / spare if noise_px is None else np.full(len(index), noise_px**2)
    draft.covariance[index] = np.linalg.inv(np.swapaxes(J, -1, -2) @ J) * variance[:, None, None]
