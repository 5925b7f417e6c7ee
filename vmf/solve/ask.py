"""Answering queries with a visuomotor function, from the initial or from the desired view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from vmf.data.query import Query
from vmf.estimate.noise import Noise
from vmf.geometry import motion
from vmf.solve.function_views import Function, two_views_of
from vmf.solve.known_views import KnownViews
from vmf.solve.maximum_likelihood import drafted, most_likely
from vmf.solve.solution import Solutions, StopReason
from vmf.solve.solver import SolverOptions, solve
from vmf.solve.unknowns import Unknowns
from vmf.solve.views import Views
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# codes (…, 4) -> parameters (…, 2, 3, k+1), NaN for a code the function does not know.
Theta = Callable[[Floats], Floats]


def ask(task: Task, theta: Theta, query: Query, options: SolverOptions) -> Solutions:
    """Answer queries with the visuomotor function Θ_S and one of the costs in `COSTS`."""
    return either_way(task, query, lambda some: _by_rows(task, _rows_at(task, theta, some), some, options))


def ask_most_likely(
    task: Task, function: Function, query: Query, options: SolverOptions, noise: Noise | None
) -> Solutions:
    """Answer queries with the most likely motion and true stereo codes (`cost: ml`, §6.3).

    Starts are the `geometric` solution, which takes the observed codes for true, and no motion. `noise` is
    how pixels scatter; None takes least squares.
    """

    def forwards(some: Query) -> Solutions:
        unknowns = Unknowns.of(task, some.E_initial, some.rotations(options.known_rotation))
        problem, known = two_views_of(function, unknowns, some.of_camera(options.cameras))
        rows = _rows_at(task, lambda codes: function.parameters(codes)[0], some)
        return _most_likely(problem, known, rows, some, options, noise)

    return either_way(task, query, forwards)


def ask_known(
    task: Task, rows: Floats, query: Query, options: SolverOptions, noise: Noise | None
) -> Solutions:
    """Answer queries whose parameters (Q, n, 2, 3, k+1) hold for the initial codes as they were observed.

    With `cost: ml` this is the geometric cost with the loss of `noise`, the codes' own noise being no matter.
    """
    if options.cost != "ml":
        return _by_rows(task, rows, query, options)
    unknowns = Unknowns.of(task, query.E_initial, query.rotations(options.known_rotation))
    problem, known = KnownViews.of(unknowns, rows, query.of_camera(options.cameras))
    return _most_likely(problem, known, rows, query, options, noise)


def _most_likely(
    problem: Views, known: Bools, rows: Floats, query: Query, options: SolverOptions, noise: Noise | None
) -> Solutions:
    draft = drafted(problem, problem.used)
    draft.reason[~known] = StopReason.NO_PARAMETERS
    unknowns = problem.unknowns
    start = replace(options, cost="geometric", noise_px=None)

    def geometric(index: Ints) -> Floats:
        p = _by_rows(unknowns.task, rows[index], query.select(index), start).p[:, unknowns.free]
        return np.where(np.isfinite(p), p, 0.0)

    def at_rest(index: Ints) -> Floats:
        return np.zeros((len(index), unknowns.n_free))

    return most_likely(problem, draft, [geometric, at_rest], noise)


def either_way(task: Task, query: Query, forwards: Callable[[Query], Solutions]) -> Solutions:
    """Answer queries from the initial view, or from the desired one where it has more to say (Ch. 5).

    The initial view's stereo codes index the parameters. Where fewer targets have one than the desired
    view, the desired view's parameters are used and the motion is inverted.
    """
    backwards = _stereo(query.desired).sum(axis=1) > _stereo(query.initial).sum(axis=1)
    # A motion from the desired view needs that pose's tilt, which is not known before the motion is.
    if not task.closed:
        backwards[:] = False
    answers = forwards(query)
    if not backwards.any():
        return answers
    inverse = forwards(query.select(backwards).reversed())
    return _merge_inverse(task, answers, inverse, np.nonzero(backwards)[0], query)


def _stereo(pixels: Floats) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(pixels).all(axis=-1))


def _rows_at(task: Task, theta: Theta, query: Query) -> Floats:
    """Return the parameters (Q, n, 2, 3, k+1) at the initial codes, NaN where there are none."""
    stereo = _stereo(query.initial)
    rows = np.full((*stereo.shape, 2, 3, task.n_lift + 1), np.nan)
    if stereo.any():
        rows[stereo] = theta(query.initial[stereo])
    return rows


def _by_rows(task: Task, rows: Floats, query: Query, options: SolverOptions) -> Solutions:
    errors = (query.desired - query.initial).reshape(*query.initial.shape[:2], 2, 2)
    errors[~_stereo(query.initial)] = np.nan
    return solve(task, rows, errors, query.E_initial, options, query.rotations(options.known_rotation))


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
    weights = forwards.weights.copy()
    weights[where] = inverse.weights
    return Solutions(E, p, covariance, residual, iterations, condition, reason, weights)


def _take(
    inverse: Solutions, keep: NDArray[np.bool_], where: NDArray[np.int64]
) -> tuple[Solutions, NDArray[np.int64], NDArray[np.bool_]]:
    """Return some of the solutions, the queries they answer, and which are motions."""
    some = Solutions(*(getattr(inverse, f.name)[keep] for f in fields(Solutions)))
    return some, where[keep], some.status == "ok"
