"""The tidy table of errors: one row per answer and component."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import union_categoricals

from vmf.data import Query, Truth
from vmf.geometry import inverse, rotation_angle
from vmf.solve import Solutions
from vmf.tasks import Task

Floats = NDArray[np.float64]

# The columns of `errors.parquet`, a contract; `case` and `query` are only kept in memory, as are
# `expected_error`, the mean of |error| that the Cramér–Rao bound allows in a question, and `rejected`, the
# targets that were left out of an answer as wrong correspondences, with `BETWEEN` between their names.
COLUMNS = (
    "trial",
    "frame",
    "protocol",
    "method",
    "component",
    "unit",
    "truth",
    "estimate",
    "abs_error",
    "status",
)
BETWEEN = "\x1f"
OVERALL = (("angle", "rad"), ("distance", "m"))


@dataclass(frozen=True)
class Asked:
    """Queries of one kind: what was asked, where, and under which name it is counted.

    Attributes
    ----------
    protocol : `trained_code` or `held_out`.
    trial : number of the trial, or of the case for a recording.
    frame : (Q,) frames learned before the question (simulation) or the frame asked about (recording).
    case : (Q,) case names.
    query : the questions.
    targets : (Q, n) or (1, n) names of the targets asked with, empty beyond them; None numbers them.
    truth : what a simulation knows about them, for the Cramér–Rao bound alone; None for a recording.
    start : (Q,) frames of a recording that show the initial views; None for a simulation.
    odometry : (Q, 4, 4) the same motions by odometry that drifts; None where poses do not.
    """

    protocol: str
    trial: int
    frame: NDArray[np.int64]
    case: NDArray[np.str_]
    query: Query
    targets: NDArray[np.str_] | None = None
    truth: Truth | None = None
    start: NDArray[np.int64] | None = None
    odometry: Floats | None = None

    def select(self, which: NDArray[np.int64]) -> Asked:
        """Return some of the questions, without their truth."""
        targets = np.broadcast_to(self.names, self.query.initial.shape[:2])[which]
        query = self.query.select(which)
        start = None if self.start is None else self.start[which]
        frame, case = self.frame[which], self.case[which]
        return Asked(self.protocol, self.trial, frame, case, query, targets, start=start)

    @property
    def names(self) -> NDArray[np.str_]:
        """Names of the targets, (Q, n) or (1, n)."""
        return (
            np.arange(self.query.initial.shape[1]).astype(str)[None] if self.targets is None else self.targets
        )


def joined(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return the rows of several tables as one, its columns of names as categories in alphabetical order."""
    columns: dict[str, NDArray[Any] | pd.Categorical] = {}
    for name in tables[0].columns:
        parts = [table[name] for table in tables]
        if pd.api.types.is_numeric_dtype(tables[0][name]):
            columns[name] = np.concatenate([part.to_numpy() for part in parts])
        else:
            some = [part.astype("category") for part in parts]
            columns[name] = union_categoricals(some, sort_categories=True)
    return pd.DataFrame(columns, copy=False)


def error_rows(task: Task, asked: Asked, method: str, E: Floats, status: NDArray[np.str_]) -> pd.DataFrame:
    """Return the rows of one method's answers.

    Parameters
    ----------
    task : the task space.
    asked : Q questions.
    method : name in the table.
    E : (Q, 4, 4) answered motions, NaN where there is none.
    status : (Q,) `ok`, `refused` or `diverged`.
    """
    query = asked.query
    p_true = task.coordinates(query.truth, query.E_initial)
    # Recorded motions leave the task space a little (a car pitches): compare within it.
    E_true = task.motion(p_true, query.E_initial)
    ok = status == "ok"
    safe = np.where(ok[:, None, None], E, np.eye(4))
    p = task.coordinates(safe, query.E_initial)
    columns = [_component(name, unit, p_true[:, i], p[:, i]) for i, (name, unit) in in_table_order(task)]
    between = inverse(E_true) @ safe
    angle = (rotation_angle(E_true), rotation_angle(safe), rotation_angle(between))
    moved = tuple(np.linalg.norm(M[:, :3, 3], axis=1) for M in (E_true, safe))
    gap = np.linalg.norm(safe[:, :3, 3] - E_true[:, :3, 3], axis=1)
    columns.append(Column("angle", "rad", angle[0], angle[1], angle[2]))
    columns.append(Column("distance", "m", moved[0], moved[1], gap))
    return tidy(asked, method, columns, status)


def in_table_order(task: Task) -> list[tuple[int, tuple[str, str]]]:
    """Return the task's unknowns with their indices in the order of rows.

    Rotations are unknowns in the order of their angles (z, y, x) and rows in the order of their axes.
    """
    return sorted(enumerate(task.components), key=lambda item: (item[1][1] == "m", item[1][0]))


@dataclass(frozen=True)
class Column:
    """One component of Q motions: its name and unit, and (Q,) truth, estimate and |error|.

    `expected` is the mean |error| of each question where it is known.
    """

    name: str
    unit: str
    truth: Floats
    estimate: Floats
    error: Floats
    expected: Floats | None = None


def _component(name: str, unit: str, truth: Floats, estimate: Floats) -> Column:
    error = np.abs(estimate - truth)
    return Column(name, unit, truth, estimate, around_the_circle(error) if unit == "rad" else error)


def around_the_circle(error: Floats) -> Floats:
    """Return differences of angles (rad), not negative, the shorter way round."""
    return np.asarray(np.minimum(error % (2 * np.pi), 2 * np.pi - error % (2 * np.pi)))


def tidy(asked: Asked, method: str, columns: list[Column], status: NDArray[np.str_]) -> pd.DataFrame:
    """Return the rows of one method's answers, question by question; none but `ok` ones hold a number."""
    n, k = len(asked.query), len(columns)
    ok = np.repeat(status == "ok", k)

    def by_question(values: list[Floats]) -> Floats:
        return np.stack(values, axis=1).ravel()

    table = pd.DataFrame(
        {
            "trial": asked.trial,
            "frame": np.repeat(asked.frame, k),
            "protocol": asked.protocol,
            "method": method,
            "component": [c.name for c in columns] * n,
            "unit": [c.unit for c in columns] * n,
            "truth": by_question([c.truth for c in columns]),
            "estimate": np.where(ok, by_question([c.estimate for c in columns]), np.nan),
            "abs_error": np.where(ok, by_question([c.error for c in columns]), np.nan),
            "status": np.repeat(status, k),
            "case": np.repeat(asked.case, k),
            "query": np.repeat(np.arange(n), k),
        }
    )
    expected = [c.expected for c in columns if c.expected is not None]
    if len(expected) == k:
        table["expected_error"] = np.where(ok, by_question(expected), np.nan)
    return table


def solution_rows(task: Task, asked: Asked, method: str, solutions: Solutions) -> pd.DataFrame:
    """Return the rows of solved motions, and which targets were rejected on the way."""
    rows = error_rows(task, asked, method, solutions.E_to_from, solutions.status)
    wrong = solutions.rejected
    names = np.broadcast_to(asked.names, wrong.shape)
    rejected = np.full(len(wrong), "", object)
    for q in np.nonzero(wrong.any(axis=1))[0]:
        rejected[q] = BETWEEN.join(names[q, wrong[q]])
    return rows.assign(rejected=np.repeat(rejected, len(rows) // max(len(wrong), 1)))


def no_motion_rows(task: Task, asked: Asked) -> pd.DataFrame:
    """Return the rows of the trivial answer, so that a reader sees what an error means."""
    n = len(asked.query)
    return error_rows(task, asked, "no_motion", np.broadcast_to(np.eye(4), (n, 4, 4)), np.full(n, "ok"))


def odometry_rows(task: Task, asked: Asked) -> pd.DataFrame:
    """Return the rows of what odometry that drifts says of the motions."""
    assert asked.odometry is not None
    return error_rows(task, asked, "odometry", asked.odometry, np.full(len(asked.query), "ok"))
