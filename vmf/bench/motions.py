"""Solving for motions: all queries at once against one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vmf.bench.clock import Times, in_turns
from vmf.bench.figure import Effort, Figure, faster
from vmf.geometry import StereoCameras, inverse, parallel_rig
from vmf.optimise import levenberg_marquardt
from vmf.solve import COSTS, LiftedViews, SolverOptions, Unknowns, solve
from vmf.tasks import Task, make_task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_TARGETS = 6
_K = np.array([[469.0, 0.0, 344.0], [0.0, 472.0, 255.0], [0.0, 0.0, 1.0]])
# Left camera from S: 10 cm to the left and ahead (Table 5.1).
_L_E_S = np.array([[1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.1], [0.0, 0.0, 0.0, 1.0]])
_REST = np.eye(4)


@dataclass(frozen=True)
class Queries:
    """Motions to solve for, from noisy pixels and exact parameters.

    Attributes
    ----------
    points : (Q, n, 3) targets in S at the start.
    rows : (Q, n, 2, 3, 13) their parameters.
    errors : (Q, n, 2, 2) image-based errors in both cameras (px).
    pixels : (Q, n, 2) of the desired view in the left camera (px).
    """

    task: Task
    points: Floats
    rows: Floats
    errors: Floats
    pixels: Floats

    def __len__(self) -> int:
        return len(self.points)

    def solved(self, cameras: str) -> Floats:
        """Return the unknowns (Q, 6) by one call of the solver, from p = 0."""
        options = SolverOptions(start="zero", cameras="left" if cameras == "left" else "both")
        E_c = np.broadcast_to(_REST, (len(self), 4, 4))
        return solve(self.task, self.rows, self.errors, E_c, options).p


def draw(n: int) -> Queries:
    """Return queries with motions of up to 0.3 rad and 0.3 m about each axis, and 3 px of noise."""
    rng = np.random.default_rng(1)
    task = make_task("six_dof")
    cameras = parallel_rig(_K, _K, 0.2, np.eye(3), np.array([-0.1, 0.0, 0.1]))
    points = np.array([0.0, 0.0, 2.0]) + rng.uniform(-0.5, 0.5, (n, _TARGETS, 3))
    E = task.motion(rng.uniform(-0.3, 0.3, (n, 6)), _REST)
    moved = points @ E[:, :3, :3].swapaxes(-1, -2) + E[:, None, :3, 3]
    before, after = _seen(cameras, points), _seen(cameras, moved)
    after = after + 3.0 * rng.standard_normal(after.shape)
    rows = task.parameters(cameras.M, points[:, :, None])
    return Queries(task, points, rows, after - before, np.ascontiguousarray(after[:, :, 0]))


def _seen(cameras: StereoCameras, points: Floats) -> Floats:
    p = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
    image = (cameras.M @ p[:, :, None, :, None])[..., 0]
    return np.asarray(image[..., :2] / image[..., 2:])


class Lean:
    """The geometric residuals of all queries and nothing else: no missing pixels, no choice of costs.

    Parameters
    ----------
    queries : what to solve.
    """

    def __init__(self, queries: Queries) -> None:
        Q = len(queries)
        unknowns = Unknowns.of(queries.task, np.broadcast_to(_REST, (Q, 4, 4)))
        rows = queries.rows.reshape(Q, -1, 3, 13)
        self._views = LiftedViews.of(unknowns, rows, np.ones(rows.shape[:2], bool))
        self._errors = np.ascontiguousarray(queries.errors.reshape(Q, -1, 2).swapaxes(1, 2))

    def residuals(self, x: Floats, index: Ints) -> tuple[Floats, Floats]:
        """Return residuals (A, 24) and Jacobians (A, 24, 6) of some queries at x (A, 6)."""
        r, J = COSTS["geometric"](self._views.at(x, index), self._errors[index])
        return r.reshape(len(x), -1), J.reshape(len(x), 6, -1).swapaxes(1, 2)

    def minimised(self) -> Floats:
        """Return the minimisers (Q, 6) from p = 0."""
        return levenberg_marquardt(self.residuals, np.zeros((len(self._errors), 6))).x


def one_by_one(queries: Queries, n: int, *, analytic: bool) -> Floats:
    """Return the unknowns (n, 6) of the first queries by `least_squares(method="lm")`, from p = 0."""
    task, found = queries.task, []
    for rows, errors in zip(queries.rows[:n].reshape(n, -1, 3, 13), queries.errors[:n], strict=True):
        residuals, jacobian = _one(task, rows, errors.reshape(-1, 2))
        end = least_squares(residuals, np.zeros(6), jac=jacobian if analytic else "2-point", method="lm")
        found.append(end.x)
    return np.array(found)


def _one(
    task: Task, rows: Floats, errors: Floats
) -> tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]:
    def residuals(x: Floats) -> Floats:
        abc = rows @ task.lift(task.motion(x, _REST))
        return np.asarray((abc[:, :2] / abc[:, 2:] - errors).ravel())

    def jacobian(x: Floats) -> Floats:
        abc = rows @ task.lift(task.motion(x, _REST))
        predicted = abc[:, :2] / abc[:, 2:]
        V = (rows[:, :2] - predicted[..., None] * rows[:, 2:]) / abc[:, 2:, None]
        return np.asarray(V.reshape(-1, 13) @ task.lift_jacobian(x, _REST))

    return residuals, jacobian


def by_opencv(queries: Queries, n: int) -> Floats:
    """Return the unknowns (n, 6) by `solvePnP`: the left camera known, the points known, from p = 0."""
    found = np.tile(np.eye(4), (n, 1, 1))
    for q in range(n):
        start = cv2.Rodrigues(_L_E_S[:3, :3])[0], _L_E_S[:3, 3:].copy()
        _, turn, shift = cv2.solvePnP(
            queries.points[q], queries.pixels[q], _K, None, *start, True, cv2.SOLVEPNP_ITERATIVE
        )
        found[q, :3, :3], found[q, :3, 3:] = cv2.Rodrigues(turn)[0], shift
    return queries.task.coordinates(inverse(_L_E_S) @ found, _REST)


def figure(effort: Effort) -> Figure:
    """Measure batched Levenberg–Marquardt against loops over SciPy's and OpenCV's."""
    n_all, n_loop = (60, 6) if effort.quick else (1000, 100)
    queries = draw(n_all)
    lean = Lean(queries)
    work: dict[str, tuple[int, Callable[[], Floats]]] = {
        "solve": (n_all, lambda: queries.solved("both")),
        "lean": (n_all, lean.minimised),
        "analytic": (n_loop, lambda: one_by_one(queries, n_loop, analytic=True)),
        "differences": (n_loop, lambda: one_by_one(queries, n_loop, analytic=False)),
        "left": (n_all, lambda: queries.solved("left")),
        "opencv": (n_loop, lambda: by_opencv(queries, n_loop)),
    }
    times = in_turns({name: run for name, (_, run) in work.items()}, effort.repeats)
    each = {name: Times(times[name].seconds / n) for name, (n, _) in work.items()}
    found = {name: run()[:n_loop] for name, (_, run) in work.items()}
    ours = (
        ("solve", "solve(): all queries at once, with covariances"),
        ("lean", "batched LM alone, on the leanest residuals"),
    )
    scipy = (
        ("analytic", "least_squares(lm) in a loop, analytic Jacobian"),
        ("differences", "least_squares(lm) in a loop, finite differences"),
    )
    pairs = [(mine, other) for mine in ours for other in scipy]
    pairs.append((("left", "solve(): left camera alone"), ("opencv", "OpenCV solvePnP in a loop")))
    rows = [
        faster(
            f"{n_all} queries",
            (mine, each[key]),
            (other, each[other_key]),
            f"same optimum: motions within {np.abs(found[key] - found[other_key]).max():.0e} rad, m",
        )
        for (key, mine), (other_key, other) in pairs
    ]
    return Figure("motions", f"seconds per 6-DOF motion from {_TARGETS} targets", tuple(rows))
