"""Answers at stereo codes never visited: CMAC against nearest neighbours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from sklearn.neighbors import KNeighborsRegressor

from vmf.approximate import Cmac
from vmf.bench.clock import Times, in_turns
from vmf.bench.figure import Effort, Figure, faster
from vmf.geometry import parallel_rig, project
from vmf.tasks import make_task

Floats = NDArray[np.float64]

_NEIGHBOURS = 8
_K = np.array([[469.0, 0.0, 344.0], [0.0, 472.0, 255.0], [0.0, 0.0, 1.0]])


def pairs(n: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return codes (n, 4) and 6-DOF parameters (n, 78) of points in view, 1.5 to 2.5 m away."""
    cameras = parallel_rig(_K, _K, 0.2, np.eye(3), np.array([-0.1, 0.0, 0.1]))
    points = np.array([0.0, 0.0, 2.0]) + rng.uniform(-0.5, 0.5, (n, 3))
    codes = np.concatenate([project(M, points)[0] for M in cameras.M], axis=1)
    rows = make_task("six_dof").parameters(cameras.M, points[:, None])
    return codes, rows.reshape(n, -1)


class NearestNeighbours:
    """Means of the nearest visited codes' parameters, weighted by the inverse distance, by a k-d tree."""

    def __init__(self, codes: Floats, parameters: Floats) -> None:
        self._tree, self._parameters = cKDTree(codes), parameters

    def predict(self, codes: Floats) -> Floats:
        """Return parameters (M, d) at codes (M, 4)."""
        distance, which = self._tree.query(codes, _NEIGHBOURS)
        weight = 1.0 / np.maximum(distance, 1e-9)
        weight /= weight.sum(axis=1, keepdims=True)
        return np.asarray((weight[:, None, :] @ self._parameters[which])[:, 0])


def figure(effort: Effort) -> Figure:
    """Measure CMAC predictions and updates against SciPy's k-d tree and scikit-learn's regressor."""
    n, m = (300, 50) if effort.quick else (20_000, 1000)
    rng = np.random.default_rng(1)
    codes, theta = pairs(n, rng)
    asked, truth = pairs(m, rng)
    cmac = Cmac(min_support=0.0)
    cmac.partial_fit(codes, theta)
    tree = NearestNeighbours(codes, theta)
    regressor = KNeighborsRegressor(_NEIGHBOURS, weights="distance").fit(codes, theta)
    predict: dict[str, Callable[[], Any]] = {
        "cmac": lambda: cmac.predict(asked).parameters,
        "tree": lambda: tree.predict(asked),
        "sklearn": lambda: regressor.predict(asked),
    }
    # A tree does not grow: pairs to come make it anew, with all that came before.
    all_codes, all_theta = np.concatenate([codes, asked]), np.concatenate([theta, truth])
    update: dict[str, Callable[[], Any]] = {
        "cmac": lambda: cmac.partial_fit(asked, truth),
        "tree": lambda: NearestNeighbours(all_codes, all_theta),
        "sklearn": lambda: KNeighborsRegressor(_NEIGHBOURS, weights="distance").fit(all_codes, all_theta),
    }
    errors = {name: _error(work(), truth) for name, work in predict.items()}
    names = {"tree": "scipy cKDTree", "sklearn": "scikit-learn KNeighborsRegressor"}
    rows = []
    for what, candidates, note in (
        ("predict", predict, "median relative errors {:.0e} and {:.0e}"),
        ("learn", update, "the alternative is built anew"),
    ):
        times = in_turns(candidates, effort.repeats)
        each = {name: Times(t.seconds / m) for name, t in times.items()}
        rows += [
            faster(
                f"{what}, {n} visited",
                (f"Cmac, {m} codes at once", each["cmac"]),
                (other, each[key]),
                note.format(errors["cmac"], errors[key]),
            )
            for key, other in names.items()
        ]
    return Figure("codes", "seconds per stereo code, 78 parameters each", tuple(rows))


def _error(found: Floats, truth: Floats) -> float:
    known = np.isfinite(found).all(axis=1)
    gap = np.linalg.norm(found[known] - truth[known], axis=1) / np.linalg.norm(truth[known], axis=1)
    return float(np.median(gap)) if known.any() else float("inf")
