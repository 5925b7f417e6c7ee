"""The functions that an experiment learns: the spec's own, and others beside it from the same data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data import Tracks
from vmf.errors import Loss
from vmf.experiment import protocols
from vmf.experiment.asking import answer, learn_and_answer
from vmf.experiment.build import build_learner, build_task, wants_exact
from vmf.experiment.errors_table import Asked, solution_rows
from vmf.learn import Learner
from vmf.solve import Solutions
from vmf.spec import Spec
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Answer:
    """What one function answered to one set of questions.

    Attributes
    ----------
    method : its name in the tables.
    task : its task space.
    asked : the questions that it was asked.
    which : (Q,) their numbers among all questions of the set.
    solutions : of these questions.
    """

    method: str
    task: Task
    asked: Asked
    which: Ints
    solutions: Solutions

    def rows(self) -> pd.DataFrame:
        """Return the rows of the tidy table."""
        rows = solution_rows(self.task, self.asked, self.method, self.solutions)
        return rows.assign(query=self.which[rows["query"]])


@dataclass(frozen=True)
class Taught:
    """A function that has learned, and what it answered.

    Attributes
    ----------
    method : its name in the tables.
    learner : which has learned everything.
    answers : one per set of questions.
    counts, condition : (F,) frames learned, and the condition number of a tile of the first view's code.
    """

    method: str
    learner: Learner
    answers: tuple[Answer, ...]
    counts: Ints
    condition: Floats

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be used, in words; the spec's own function needs no name."""
        if self.method == "vmf":
            return self.learner.losses if self.learner.refused is None else ()
        return tuple(f"{self.method}: {loss}" for loss in self.learner.losses)


def nothing_learned(taught: Sequence[Taught]) -> tuple[Loss, ...]:
    """Return why the spec's own function has learned nothing, if that is so."""
    why = taught[0].learner.refused
    return () if why is None else (Loss(taught[0].method, f"nothing was learned: {why}", 1),)


def functions(spec: Spec) -> dict[str, Spec]:
    """Return the spec of every function by its name in the tables, the spec's own first."""
    return {"vmf": spec} | {f"vmf[{other.name}]": other.within(spec) for other in spec.also}


def teach(
    spec: Spec, tracks: Tracks, view: protocols.FirstView | None, questions: Sequence[Asked]
) -> tuple[Taught, ...]:
    """Let every function of a spec learn, and answer.

    Parameters
    ----------
    spec : the experiment.
    tracks : what is learned.
    view : the first view, whose codes the questions of `trained_code` are about.
    questions : at trained codes, asked on the way; others are asked at the end.
    """
    return tuple(_teach(name, one, tracks, view, questions) for name, one in functions(spec).items())


def answer_with(method: str, spec: Spec, learner: Learner, questions: Sequence[Asked]) -> tuple[Answer, ...]:
    """Return a trained function's answers to sets of questions."""
    task = build_task(spec)
    return tuple(
        Answer(method, task, asked, np.arange(len(asked.query)), answer(spec, learner, asked.query))
        for asked in questions
    )


def by_question(taught: Sequence[Taught]) -> list[tuple[Answer, ...]]:
    """Return the answers of all functions to each set of questions."""
    return list(zip(*(one.answers for one in taught), strict=True))


def first_condition(taught: Sequence[Taught]) -> tuple[Ints, Floats]:
    """Return the condition number of a tile, and when it was that, from the first function that has tiles."""
    for one in taught:
        if np.isfinite(one.condition).any():
            return one.counts, one.condition
    return taught[0].counts, taught[0].condition


def _teach(
    method: str, spec: Spec, tracks: Tracks, view: protocols.FirstView | None, questions: Sequence[Asked]
) -> Taught:
    learner = build_learner(spec)
    if not wants_exact(spec):
        tracks = replace(tracks, exact=None)
    on_the_way = [asked for asked in questions if asked.protocol == "trained_code"]
    if not on_the_way or view is None:
        learner.partial_fit(tracks)
        nothing = np.zeros(0, np.int64), np.zeros(0)
        return Taught(method, learner, answer_with(method, spec, learner, questions), *nothing)
    (asked,) = on_the_way
    which = np.nonzero(np.isin(asked.frame, protocols.curve_frames(spec, tracks.n_frames)))[0]
    some = asked.select(which)
    solutions, condition = learn_and_answer(spec, learner, tracks, view, some)
    answers = tuple(
        Answer(method, build_task(spec), some, which, solutions)
        if q is asked
        else answer_with(method, spec, learner, [q])[0]
        for q in questions
    )
    return Taught(method, learner, answers, some.frame, condition)
