"""Two-view maximum likelihood over points and motion: with exact cameras, the Cramér–Rao benchmark."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.geometry import StereoCameras
from vmf.geometry.triangulate import point_from_q, triangulate
from vmf.reconstruct.arun import triangulate_arun
from vmf.reconstruct.pnp import pnp
from vmf.solve import Query, Solutions, TwoViews, Unknowns, drafted, most_likely
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
    noise: Noise | None = None,
) -> Solutions:
    """Return the motions of least reprojection error over both views, both cameras and all points.

    A target needs both cameras in one view and at least one in the other. Starts are the answers of `pnp`
    and of `triangulate_arun`. The covariance is the motion's block of σ²(JᵀJ)⁻¹ of the whole problem, with
    σ from the residuals where no `noise` is given.
    """
    problem, in_stereo = two_views(task, cameras, query, known_rotation)
    draft = drafted(problem, in_stereo)

    def start(method: Callable[..., Solutions], index: Ints) -> Floats:
        some = query.select(index)
        p = method(task, cameras, some, known_rotation=known_rotation).p[:, problem.unknowns.free]
        # A method that could not be asked leaves the start at no motion.
        return np.where(np.isfinite(p), p, 0.0)

    return most_likely(problem, draft, [partial(start, pnp), partial(start, triangulate_arun)], noise)


def two_views(
    task: Task, cameras: StereoCameras, query: Query, known_rotation: bool = False
) -> tuple[TwoViews, Bools]:
    """Return queries as seen by known cameras, and which targets (Q, n) are in stereo in either view."""
    unknowns = Unknowns.of(task, query.E_initial, query.rotations(known_rotation))
    B = point_from_q(cameras)
    before, after = triangulate(cameras, query.initial), triangulate(cameras, query.desired)
    shape = query.initial.shape[:2]
    # Targets × (left, right at the start; left, right at the goal) × (x, y).
    pixels = np.concatenate([query.initial, query.desired], axis=-1).reshape(*shape, 4, 2)
    seen = np.isfinite(pixels).all(axis=-1)
    in_both_views = seen[..., :2].any(axis=-1) & seen[..., 2:].any(axis=-1)
    in_stereo = np.asarray(in_both_views & (seen.sum(axis=-1) >= 3))
    # M E' B is linear in the motion, and the motion in its lift.
    lifted = np.einsum("cri,ijb,jq->crqb", cameras.M, task.embedding, B)
    problem = TwoViews(
        unknowns=unknowns,
        pixels=pixels,
        used=np.asarray(in_stereo & (before.ok | after.ok)),
        before=np.broadcast_to(cameras.M @ B, (*shape, 2, 3, 4)),
        after=np.broadcast_to(lifted, (*shape, *lifted.shape)),
        shift=np.zeros((*shape, 4, 2, 4)),
        q=before.q,
    )
    return problem, in_stereo
