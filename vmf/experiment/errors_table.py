"""The tidy table of errors: one row per answer and component."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data import Query
from vmf.geometry import inverse, rotation_angle
from vmf.solve import Solutions
from vmf.tasks import Task

Floats = NDArray[np.float64]

# The columns of `errors.parquet`, a contract; `case` is only kept in memory and in `summary.csv`.
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
    """

    protocol: str
    trial: int
    frame: NDArray[np.int64]
    case: NDArray[np.str_]
    query: Query


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
    # Rotations are unknowns in the order of their angles (z, y, x) and rows in the order of their axes.
    named = sorted(enumerate(task.components), key=lambda item: (item[1][1] == "m", item[1][0]))
    columns = [_component(name, unit, p_true[:, i], p[:, i], None) for i, (name, unit) in named]
    between = inverse(E_true) @ safe
    angle = (rotation_angle(E_true), rotation_angle(safe), rotation_angle(between))
    moved = tuple(np.linalg.norm(M[:, :3, 3], axis=1) for M in (E_true, safe))
    gap = np.linalg.norm(safe[:, :3, 3] - E_true[:, :3, 3], axis=1)
    columns.append(_component("angle", "rad", angle[0], angle[1], angle[2]))
    columns.append(_component("distance", "m", moved[0], moved[1], gap))
    table = pd.concat(columns, keys=range(len(columns)), names=["component_index", "query"])
    table["estimate"] = table["estimate"].where(np.tile(ok, len(columns)))
    table["abs_error"] = table["abs_error"].where(np.tile(ok, len(columns)))
    table["trial"] = asked.trial
    table["frame"] = np.tile(asked.frame, len(columns))
    table["case"] = np.tile(asked.case, len(columns))
    table["protocol"], table["method"] = asked.protocol, method
    table["status"] = np.tile(status, len(columns))
    table = table.sort_index(level=["query", "component_index"]).reset_index(level="query")
    return table[[*COLUMNS, "case", "query"]].reset_index(drop=True)


def _component(name: str, unit: str, truth: Floats, estimate: Floats, error: Floats | None) -> pd.DataFrame:
    if error is None:
        error = np.abs(estimate - truth)
        if unit == "rad":
            error = np.minimum(error % (2 * np.pi), 2 * np.pi - error % (2 * np.pi))
    return pd.DataFrame(
        {"component": name, "unit": unit, "truth": truth, "estimate": estimate, "abs_error": error}
    )


def solution_rows(task: Task, asked: Asked, method: str, solutions: Solutions) -> pd.DataFrame:
    """Return the rows of solved motions."""
    return error_rows(task, asked, method, solutions.E_to_from, solutions.status)


def no_motion_rows(task: Task, asked: Asked) -> pd.DataFrame:
    """Return the rows of the trivial answer, so that a reader sees what an error means."""
    n = len(asked.query)
    return error_rows(task, asked, "no_motion", np.broadcast_to(np.eye(4), (n, 4, 4)), np.full(n, "ok"))
