"""Adding an observation to least squares: triangular factors against other ways to keep them up to date."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, qr_insert, solve_triangular

from vmf.bench.clock import Times, in_turns
from vmf.bench.figure import Effort, Figure, faster
from vmf.estimate import StereoEquations, augmented_rows, update_rank_1, update_rank_k

Floats = NDArray[np.float64]

_LIFT = 13
_UNKNOWNS = 3 * _LIFT - 1
# What recursive least squares starts from instead of nothing: the inverse covariance of zero parameters.
_RLS_EPS = 1e-6


@dataclass(frozen=True)
class Stream:
    """Observations of K targets, all consistent but for noise: many before, and one to be added.

    Attributes
    ----------
    x_bar : (K, m, 13) lifts.
    e : (K, m, 2, 2) errors in both cameras (px).
    """

    x_bar: Floats
    e: Floats

    @property
    def rows(self) -> Floats:
        """Augmented rows (2m, 39) of the first target in the left camera."""
        return augmented_rows(self.x_bar[0], self.e[0, :, 0]).reshape(-1, 3 * _LIFT)


def stream(n_targets: int, m: int) -> Stream:
    """Return m observations of each target."""
    rng = np.random.default_rng(1)
    x_bar = rng.uniform(-1.0, 1.0, (n_targets, m, _LIFT))
    x_bar[..., -1] = 1.0
    ab = rng.uniform(-1.0, 1.0, (n_targets, 1, 2, 2, _LIFT))
    c = rng.uniform(-0.05, 0.05, (n_targets, 1, 2, 1, _LIFT))
    c[..., -1] = 1.0
    rows = np.concatenate([np.broadcast_to(ab, (n_targets, 1, 2, 2, _LIFT)), c], axis=-2)
    abc = (rows @ x_bar[:, :, None, :, None])[..., 0]
    e = abc[..., :2] / abc[..., 2:]
    return Stream(x_bar, e + 0.01 * rng.standard_normal(e.shape))


def figure(effort: Effort) -> Figure:
    """Measure an observation's update of one target and of many against SciPy, NumPy and padasip."""
    m, n_targets = (60, 5) if effort.quick else (400, 100)
    data = stream(n_targets, m)
    before, new = data.rows[:-2], data.rows[-2:]
    R = update_rank_k(np.zeros((3 * _LIFT, 3 * _LIFT)), before)
    many = StereoEquations.of(data.x_bar[:, :-1], data.e[:, :-1]).triangular()
    last = StereoEquations.of(data.x_bar[:, -1:], data.e[:, -1:])
    batch = many.factors()
    many_new = augmented_rows(data.x_bar[:, -1:, None], data.e[:, -1:]).swapaxes(1, 2)
    many_new = many_new.reshape(n_targets, 2, 2, -1)
    Q_1, R_1 = qr(before[:, :-1], mode="economic")

    def inserted() -> tuple[Floats, Floats]:
        Q, R_new = qr_insert(Q_1, R_1, new[:, :-1], len(before), which="row")
        return np.asarray(Q, float), np.asarray(R_new, float)

    candidates: dict[str, Callable[[], Any]] = {
        "shared": lambda: many.with_others(last),
        "batched": lambda: update_rank_k(batch, many_new),
        "single": lambda: update_rank_k(R, new),
        "givens": lambda: update_rank_1(update_rank_1(R, new[0]), new[1]),
        "insert": inserted,
        "anew": lambda: np.linalg.qr(data.rows, mode="r"),
    }
    notes = []
    try:
        rls = Recursive(before)
        candidates["rls"] = lambda: rls.after(new)
    except ImportError:
        notes.append("padasip is not installed (extra `vmf[bench]`): no recursive least squares beside these")
    times = in_turns(candidates, effort.repeats)
    # Four rows of every target, or two of one: stated for one camera of one target.
    pieces = {"shared": 2 * n_targets, "batched": 2 * n_targets}
    each = {name: Times(t.seconds / pieces.get(name, 1)) for name, t in times.items()}
    expected = _solution(np.asarray(np.linalg.qr(data.rows, mode="r")))
    found = {
        "shared": _solution(many.with_others(last).factors()[0, 0]),
        "batched": _solution(update_rank_k(batch, many_new)[0, 0]),
        "single": _solution(candidates["single"]()),
        "givens": _solution(candidates["givens"]()),
        "insert": _inserted_solution(*inserted(), data.rows[:, -1]),
        "anew": expected,
    }
    if "rls" in candidates:
        found["rls"] = candidates["rls"]()
    ours = {
        "shared": f"both cameras and {n_targets} targets at once (shared lifts)",
        "batched": f"{n_targets} targets at once (batched QR)",
        "single": "one target (QR)",
    }
    others = {
        "insert": "scipy.linalg.qr_insert",
        "anew": "numpy.linalg.qr of all rows",
        "rls": "padasip FilterRLS",
        "givens": "Givens rotations in Python",
    }
    rows = [
        faster(
            f"after {m - 1} observations",
            (mine, each[key]),
            (other, each[other_key]),
            f"parameters within {_gap(found[key], expected):.0e} and {_gap(found[other_key], expected):.0e}",
        )
        for key, mine in ours.items()
        for other_key, other in others.items()
        if other_key in each
    ]
    title = "an observation more: seconds per target and camera, 38 unknowns"
    return Figure("updates", title, tuple(rows), tuple(notes))


class Recursive:
    """padasip's recursive least squares after some rows (2m, 39).

    Raises
    ------
    ImportError : padasip is not installed.
    """

    def __init__(self, rows: Floats) -> None:
        from padasip.filters import FilterRLS

        self._filter = FilterRLS(n=_UNKNOWNS, mu=1.0, eps=_RLS_EPS, w="zeros")
        for row in rows:
            self._filter.adapt(row[-1], row[:-1])
        self._covariance, self._weights = np.array(self._filter.R), np.array(self._filter.w)

    def after(self, rows: Floats) -> Floats:
        """Return the parameters (38,) after further rows, and forget these again."""
        self._filter.R, self._filter.w = self._covariance, self._weights.copy()
        for row in rows:
            self._filter.adapt(row[-1], row[:-1])
        return np.asarray(self._filter.w)


def _inserted_solution(Q: Floats, R: Floats, z: Floats) -> Floats:
    return np.asarray(solve_triangular(R, Q.T @ z))


def _solution(R: Floats) -> Floats:
    return np.asarray(solve_triangular(R[:-1, :-1], R[:-1, -1]))


def _gap(one: Floats, other: Floats) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))
