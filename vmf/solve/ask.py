"""Answering queries with a visuomotor function, from the initial or from the desired view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from vmf.data.query import Query
from vmf.geometry import motion
from vmf.solve.solution import Solutions
from vmf.solve.solver import SolverOptions, solve
from vmf.tasks import Task

Floats = NDArray[np.float64]

# codes (…, 4) -> parameters (…, 2, 3, k+1), NaN for a code the function does not know.
Theta = Callable[[Floats], Floats]


def ask(task: Task, theta: Theta, query: Query, options: SolverOptions) -> Solutions:
    """Answer queries with the visuomotor function Θ_S.

    The initial view's stereo codes index the parameters. Where fewer targets have one than the desired
    view, the desired view's parameters are used and the motion is inverted (Ch. 5).
    """
    backwards = _stereo(query.desired).sum(axis=1) > _stereo(query.initial).sum(axis=1)
    # A motion from the desired view needs that pose's tilt, which is not known before the motion is.
    if not task.closed:
        backwards[:] = False
    forwards = _ask_forwards(task, theta, query, options)
    if not backwards.any():
        return forwards
    inverse = _ask_forwards(task, theta, query.select(backwards).reversed(), options)
    return _merge_inverse(task, forwards, inverse, np.nonzero(backwards)[0], query)


def _stereo(pixels: Floats) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(pixels).all(axis=-1))


def _ask_forwards(task: Task, theta: Theta, query: Query, options: SolverOptions) -> Solutions:
    stereo = _stereo(query.initial)
    rows = np.full((*stereo.shape, 2, 3, task.n_lift + 1), np.nan)
    if stereo.any():
        rows[stereo] = theta(query.initial[stereo])
    errors = (query.desired - query.initial).reshape(*stereo.shape, 2, 2)
    errors[~stereo] = np.nan
    R_known = query.truth[:, :3, :3] if options.known_rotation else None
    return solve(task, rows, errors, query.E_initial, options, R_known)


def _merge_inverse(
    task: Task, forwards: Solutions, inverse: Solutions, where: NDArray[np.int64], query: Query
) -> Solutions:
    """Put inverted motions, with covariances carried over to first order, in the places they answer."""
    E = np.array(forwards.E_to_from)
    p, covariance = forwards.p.copy(), forwards.covariance.copy()
    residual, iterations = forwards.residual_px.copy(), forwards.iterations.copy()
    condition, reason = forwards.condition.copy(), forwards.reason.copy()
    ok = inverse.status == "ok"
    # Where the desired view gives no motion either, the initial view's answer stands.
    inverse, where, ok = _take(inverse, ok | (forwards.status[where] != "ok"), where)
    p[where], covariance[where], E[where] = np.nan, np.nan, np.nan
    E[where[ok]] = motion.inverse(inverse.E_to_from[ok])
    E_c = query.E_initial[where[ok]]
    p[where[ok]] = task.coordinates(E[where[ok]], E_c)
    step = 1e-6
    columns = []
    for axis in np.eye(task.n_motion):
        ends = [
            task.coordinates(motion.inverse(task.motion(inverse.p[ok] + s * axis, E_c)), E_c)
            for s in (step, -step)
        ]
        change = ends[0] - ends[1]
        # Angles may wrap between the ends; no true change is near a turn.
        change = np.where(np.abs(change) > np.pi, change - np.sign(change) * 2 * np.pi, change)
        columns.append(change / (2 * step))
    G = np.stack(columns, axis=-1)
    covariance[where[ok]] = G @ inverse.covariance[ok] @ np.swapaxes(G, -1, -2)
    residual[where], iterations[where] = inverse.residual_px, inverse.iterations
    condition[where], reason[where] = inverse.condition, inverse.reason
    return Solutions(E, p, covariance, residual, iterations, condition, reason)


def _take(
    inverse: Solutions, keep: NDArray[np.bool_], where: NDArray[np.int64]
) -> tuple[Solutions, NDArray[np.int64], NDArray[np.bool_]]:
    """Return some of the solutions, the queries they answer, and which are motions."""
    some = Solutions(*(getattr(inverse, f.name)[keep] for f in fields(Solutions)))
    return some, where[keep], some.status == "ok"
