"""Triangulate once, then minimise the reprojection error of those points in the other view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.geometry import StereoCameras, stereo_code
from vmf.geometry.triangulate import triangulate
from vmf.solve import Draft, Query, Solutions, SolverOptions, StopReason, Unknowns, ask, refusals
from vmf.tasks import Task

Floats = NDArray[np.float64]


def pnp(
    task: Task,
    cameras: StereoCameras,
    query: Query,
    *,
    known_rotation: bool = False,
    noise: Noise | None = None,
) -> Solutions:
    """Return the motions that best reproject the initial view's points in the desired view.

    With the cameras known, the visuomotor function is analytic (Eq. 3.16–3.40), and this is its geometric
    solution: any mix of targets seen left, right or both in the desired view, and the inverse motion where
    the desired view has more targets in stereo. The covariance counts the points as exact.
    """
    unknowns = Unknowns.of(task, query.E_initial, query.rotations(known_rotation))
    noise_px = None if noise is None else noise.scale_px
    options = SolverOptions(cost="geometric", known_rotation=known_rotation, noise_px=noise_px)

    def theta(codes: Floats) -> Floats:
        return _parameters(task, cameras, codes)

    if not query.initial.size:
        nothing = np.zeros(query.initial.shape[:2], bool)
        return Draft.of(unknowns, refusals(nothing, nothing, unknowns.fewest_targets), nothing).solutions()
    solutions = ask(task, theta, query, options)
    # `ask` knows no parameters where no stereo code belongs to a point in front of the cameras.
    solutions.reason[solutions.reason == StopReason.NO_PARAMETERS] = StopReason.BEHIND_CAMERA
    before, after = (np.isfinite(view).any(axis=-1) for view in (query.initial, query.desired))
    few = (before & after).sum(axis=1) < unknowns.fewest_targets
    solutions.reason[few & (solutions.reason == StopReason.RANK_DEFICIENT)] = StopReason.TOO_FEW_EQUATIONS
    return solutions


def _parameters(task: Task, cameras: StereoCameras, codes: Floats) -> Floats:
    """Return the parameters (N, 2, 3, k+1) of the points with stereo codes (N, 4); NaN where there is none.

    Errors are measured from the observed code and the parameters belong to the reprojected point: the
    offset between the two adds multiples of c to a and b (§3).
    """
    points = triangulate(cameras, codes).points
    rows = task.parameters(cameras.M, points[:, None, :])
    offset = (stereo_code(cameras, points)[0] - codes).reshape(-1, 2, 2)
    rows[..., :2, :] += offset[..., None] * rows[..., 2:, :]
    return rows
