"""Which targets were left out of answers is counted, and written down by name."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vmf.data import Query
from vmf.experiment.errors_table import Asked, no_motion_rows, solution_rows
from vmf.experiment.rejected import rejected_notes, rejected_targets
from vmf.solve import Solutions, StopReason
from vmf.tasks import make_task


def answered(weights: list[list[float]], names: list[list[str]]) -> pd.DataFrame:
    n, k = len(weights), len(weights[0])
    E = np.broadcast_to(np.eye(4), (n, 4, 4))
    query = Query(np.zeros((n, k, 4)), np.zeros((n, k, 4)), E, E)
    asked = Asked("held_out", 7, np.arange(n), np.full(n, "gap=5"), query, np.array(names))
    nothing = np.zeros((n, 3))
    solutions = Solutions(
        E,
        nothing,
        np.zeros((n, 3, 3)),
        np.zeros(n),
        np.zeros(n, np.int64),
        np.ones(n),
        np.array([StopReason.CONVERGED] * n, dtype=object),
        np.array(weights),
    )
    task = make_task("translation", "general")
    return pd.concat([solution_rows(task, asked, "vmf", solutions), no_motion_rows(task, asked)])


def test_rejected_targets_are_named_question_by_question() -> None:
    nan = float("nan")
    errors = answered(
        [[1.0, 0.0, 0.5], [1.0, 1.0, nan], [0.0, 0.0, 1.0]],
        [["a", "b", "c"], ["d", "e", ""], ["f", "g", "h"]],
    )
    rejected = rejected_targets(errors)
    assert rejected[["frame", "target"]].to_numpy().tolist() == [[0, "b"], [2, "f"], [2, "g"]]
    assert set(rejected["trial"]) == {7}
    assert set(rejected["method"]) == {"vmf"}
    (note,) = rejected_notes(errors)
    assert note.startswith("held_out: 3 targets in 2 of 3 questions")


def test_nothing_is_said_where_nothing_was_rejected() -> None:
    errors = answered([[1.0, 0.3]], [["a", "b"]])
    assert rejected_targets(errors).empty
    assert rejected_notes(errors) == ()
