"""Putting queries to a learner, with the solver that a spec asks for."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from vmf.data import Query, Tracks
from vmf.experiment.build import solver_options
from vmf.experiment.errors_table import Asked
from vmf.experiment.protocols import FirstView
from vmf.learn import Learner, StructuredLearner
from vmf.reconstruct import bundle
from vmf.solve import Solutions, ask, concatenate, solve
from vmf.spec import Spec

Floats = NDArray[np.float64]


def answer(spec: Spec, learner: Learner, query: Query) -> Solutions:
    """Answer a query with what the learner knows now."""
    if _maximum_likelihood(spec, learner):
        assert isinstance(learner, StructuredLearner)
        cameras = learner.cameras
        if cameras is not None:
            # Motion and true codes together: two-view maximum likelihood, with the learned cameras (§6.3).
            known = spec.solver.known == "rotation"
            seen = query.of_camera(spec.solver.cameras)
            return bundle(learner.task, cameras, seen, known_rotation=known, noise_px=learner.noise_px)
    options = solver_options(spec, learner.noise_px)
    return ask(learner.task, lambda codes: learner.parameters(codes).rows, query, options)


def answer_all(spec: Spec, learner: Learner, questions: Iterable[Asked]) -> list[Solutions]:
    """Answer questions of several kinds."""
    return [answer(spec, learner, asked.query) for asked in questions]


def learn_and_answer(
    spec: Spec, learner: Learner, tracks: Tracks, view: FirstView, asked: Asked
) -> tuple[Solutions, Floats]:
    """Learn block by block, and answer each question with what was known after its frame.

    Returns
    -------
    answers : one per question.
    condition : (F,) condition number of a tile of the first view's code at each question.
    """
    counts = asked.frame
    rows, answers, condition = [], [], []
    in_turn = _maximum_likelihood(spec, learner)
    for i, (begin, end) in enumerate(zip(np.append(0, counts[:-1]), counts, strict=True)):
        learner.partial_fit(tracks.select_frames(int(begin), int(end)))
        if in_turn:
            answers.append(answer(spec, learner, asked.query.select(np.array([i]))))
        else:
            rows.append(learner.parameters(view.codes).rows)
        condition.append(learner.condition(view.codes[0]))
    if counts[-1] < tracks.n_frames:
        learner.partial_fit(tracks.select_frames(int(counts[-1]), tracks.n_frames))
    if in_turn:
        return concatenate(answers), np.array(condition)
    query = asked.query
    errors = (query.desired - query.initial).reshape(*query.initial.shape[:2], 2, 2)
    options = solver_options(spec, learner.noise_px)
    R_known = query.truth[:, :3, :3] if options.known_rotation else None
    # The questions differ in what was known, not in how they are solved: all at once.
    solved = solve(learner.task, np.stack(rows), errors, query.E_initial, options, R_known)
    return solved, np.array(condition)


def _maximum_likelihood(spec: Spec, learner: Learner) -> bool:
    return isinstance(learner, StructuredLearner) and spec.solver.cost in ("auto", "ml")
