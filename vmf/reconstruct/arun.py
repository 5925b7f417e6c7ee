"""The thesis's rival (§5.3): triangulate every target in each view, then fit a motion to the points.

K. S. Arun, T. S. Huang, S. D. Blostein, "Least-squares fitting of two 3-D point sets", PAMI 1987.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.geometry import StereoCameras, motion, project
from vmf.geometry.triangulate import Triangulation, triangulate
from vmf.optimise import levenberg_marquardt
from vmf.solve import Draft, Query, Solutions, StopReason, Unknowns, moved, refusals
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def triangulate_arun(
    task: Task,
    cameras: StereoCameras,
    query: Query,
    *,
    known_rotation: bool = False,
    noise: Noise | None = None,
) -> Solutions:
    """Return the motions `argmin Σ|E'(p) P_j − P'_j|²` between the points of two triangulations.

    A target needs both cameras in both views. The covariance carries the noise of the codes through
    triangulation and fit; without `noise` it is estimated from the triangulations' residuals.
    `residual_px` is the reprojection error of the moved points in the desired view.
    """
    unknowns = Unknowns.of(task, query.E_initial, query.rotations(known_rotation))
    before, after = triangulate(cameras, query.initial), triangulate(cameras, query.desired)
    used = before.ok & after.ok
    in_stereo = np.asarray(np.isfinite(query.initial + query.desired).all(axis=-1))
    draft = Draft.of(unknowns, refusals(used, in_stereo, unknowns.fewest_targets), used)
    fit = _PointFit(unknowns, before.points, after.points, used)
    fit.minimise(draft)
    _check_reprojection(cameras, query, fit, draft)
    _covariances(fit, before, after, draft, noise)
    return draft.solutions()


def closed_form(unknowns: Unknowns, P: Floats, P_moved: Floats, used: Bools, index: Ints) -> Floats:
    """Return the free unknowns (A, f) of the motions nearest to point pairs (A, n, 3) of the queries `index`.

    The rotation is the task's nearest to the cross-covariance of the centred points: for `six_dof` Arun's,
    never a reflection, for `planar` Procrustes' in the plane. Without a free translation it is a start only.
    """
    weight = used / np.maximum(used.sum(axis=1, keepdims=True), 1)
    a, b = _centroid(P, weight), _centroid(P_moved, weight)
    spread_a = np.where(used[..., None], P - a[:, None], 0.0)
    spread_b = np.where(used[..., None], P_moved - b[:, None], 0.0)
    H = motion.from_rotation_translation(np.swapaxes(spread_b, -1, -2) @ spread_a, np.zeros(3))
    R = unknowns.motion(unknowns.project(H, index), index)[:, :3, :3]
    return unknowns.project(motion.from_rotation_translation(R, b - (R @ a[..., None])[..., 0]), index)


def _centroid(P: Floats, weight: Floats) -> Floats:
    return np.asarray(np.einsum("qn,qni->qi", weight, np.where(weight[..., None] > 0.0, P, 0.0)))


class _PointFit:
    """The distances between moved and found points, as functions of the free unknowns."""

    def __init__(self, unknowns: Unknowns, P: Floats, P_moved: Floats, used: Bools) -> None:
        self.unknowns, self.used = unknowns, used
        self.P = np.where(used[..., None], P, 0.0)
        self.P_moved = np.where(used[..., None], P_moved, 0.0)

    def residuals(self, x: Floats, index: Ints) -> tuple[Floats, Floats]:
        """Return `E' P_j − P'_j` (A, 3n) and its Jacobian (A, 3n, f)."""
        E, dE = self.unknowns.motion(x, index), self.unknowns.motion_jacobian(x, index)
        used = self.used[index][..., None]
        P = self.P[index]
        r = np.where(used, moved(E[:, None], P) - self.P_moved[index], 0.0)
        J = np.where(used[:, None], moved(dE[:, :, None], P[:, None]), 0.0)
        n = 3 * used.shape[1]
        return r.reshape(len(x), n), np.moveaxis(J, 1, -1).reshape(len(x), n, J.shape[1])

    def minimise(self, draft: Draft) -> None:
        """Fit from the closed form, which is the answer where translation is free, and from no motion."""
        index = draft.asked

        def problem(x: Floats, running: Ints) -> tuple[Floats, Floats]:
            return self.residuals(x, index[running])

        nearest = closed_form(self.unknowns, self.P[index], self.P_moved[index], self.used[index], index)
        starts = nearest, np.zeros((len(index), self.unknowns.n_free))
        draft.take([levenberg_marquardt(problem, start) for start in starts], index)
        index = draft.asked
        draft.check_rank_of(self.residuals(draft.x[index], index)[1], index)


def _check_reprojection(cameras: StereoCameras, query: Query, fit: _PointFit, draft: Draft) -> None:
    index = draft.asked
    P = moved(fit.unknowns.motion(draft.x[index], index)[:, None], fit.P[index])
    pixels, depth = project(cameras.M, P[..., None, :])
    used = fit.used[index]
    desired = query.desired[index].reshape(pixels.shape)
    square = np.where(used[..., None, None], np.square(pixels - desired), 0.0)
    draft.residual_px[index] = np.sqrt(square.sum(axis=(1, 2, 3)) / (4 * used.sum(axis=1)))
    behind = (used & (depth <= 0.0).any(axis=-1)).any(axis=1)
    draft.reason[index[behind]] = StopReason.BEHIND_CAMERA


def _covariances(
    fit: _PointFit, before: Triangulation, after: Triangulation, draft: Draft, noise: Noise | None
) -> None:
    """First-order covariance: δx = −(JᵀJ)⁻¹Jᵀ(R δP − δP')."""
    index = draft.asked
    used = fit.used[index]
    _, J = fit.residuals(draft.x[index], index)
    J_t = np.swapaxes(J, -1, -2)
    gain = np.linalg.solve(J_t @ J, J_t).reshape(len(index), J.shape[2], used.shape[1], 3)
    R = fit.unknowns.motion(draft.x[index], index)[:, None, :3, :3]
    C = R @ before.covariance[index] @ np.swapaxes(R, -1, -2) + after.covariance[index]
    C = np.where(used[..., None, None], C, 0.0)
    if noise is None:
        # Each triangulation has four coordinates for three unknowns: one to spare.
        square = 4.0 * (np.square(before.residual_px[index]) + np.square(after.residual_px[index]))
        variance = np.where(used, square, 0.0).sum(axis=1) / (2 * used.sum(axis=1))
    else:
        variance = np.full(len(index), noise.scale_px**2)
    draft.covariance[index] = np.einsum("qfni,qnij,qgnj->qfg", gain, C, gain) * variance[:, None, None]
