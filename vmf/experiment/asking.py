"""Putting queries to a learner, with the solver that a spec asks for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.data import Query, Tracks, join
from vmf.estimate.noise import Noise
from vmf.experiment.build import solver_options
from vmf.experiment.errors_table import Asked
from vmf.experiment.protocols import FirstView
from vmf.geometry import StereoCameras
from vmf.learn import Learner, StructuredLearner
from vmf.reconstruct import bundle
from vmf.solve import Function, Solutions, ask, ask_known, ask_most_likely, concatenate
from vmf.spec import Spec

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def answer(spec: Spec, learner: Learner, query: Query) -> Solutions:
    """Answer a query with what the learner knows now."""
    query = _rectified(learner, query)
    options = solver_options(spec, learner)
    if options.cost != "ml":
        wanted = options.cameras
        return ask(learner.task, lambda codes: learner.parameters(codes, wanted).rows, query, options)
    cameras = learner.cameras if isinstance(learner, StructuredLearner) else None
    if cameras is None or not isinstance(learner, StructuredLearner):
        return ask_most_likely(learner.task, _function(learner), query, options, _noise(learner))
    return _answer_structured(spec, learner, cameras, query)


def _answer_structured(
    spec: Spec, learner: StructuredLearner, cameras: StereoCameras, query: Query
) -> Solutions:
    """Answer a query from visited codes with what is known of them, any other with both cameras."""
    options, known = solver_options(spec, learner), _from_visited_codes(learner, query)
    parts = []
    if known.any():
        some = query.select(known)
        codes = some.initial.reshape(-1, 4)
        rows = learner.parameters(codes).rows
        rows = rows.reshape(*some.initial.shape[:2], *rows.shape[1:])
        parts.append(ask_known(learner.task, rows, some, options, _noise(learner)))
    if not len(known) or not known.all():
        # The structured learner's function is that of two cameras, and exact wherever the true code lies.
        seen = query.select(~known).of_camera(spec.solver.cameras)
        noise, known_rotation = _noise(learner), options.known_rotation
        parts.append(bundle(learner.task, cameras, seen, known_rotation=known_rotation, noise=noise))
    order = np.append(np.nonzero(known)[0], np.nonzero(~known)[0])
    return concatenate(parts).select(np.argsort(order))


def _from_visited_codes(learner: StructuredLearner, query: Query) -> Bools:
    """Return which queries (Q,) start where all targets, as far as either camera saw them, were visited."""
    visited = learner.visited(query.initial.reshape(-1, 4)).reshape(query.initial.shape[:2])
    seen: Bools = np.asarray(np.isfinite(query.initial).any(axis=-1))
    return np.asarray((visited | ~seen).all(axis=1) & seen.any(axis=1))


def _noise(learner: Learner) -> Noise | None:
    return None if learner.noise is None else learner.noise.of_a_tracker


def _rectified(learner: Learner, query: Query) -> Query:
    return Query(
        learner.rectified(query.initial), learner.rectified(query.desired), query.E_initial, query.E_desired
    )


def _function(learner: Learner) -> Function:
    def parameters(codes: Floats) -> tuple[Floats, Bools]:
        known = learner.parameters(codes)
        return known.rows, known.own

    return Function(parameters, learner.y_right)


def learn_and_answer(
    spec: Spec, learner: Learner, tracks: Tracks, view: FirstView, asked: Asked
) -> tuple[Solutions, Floats]:
    """Learn block by block, and answer each question with what was known after its frame.

    Returns
    -------
    answers : one per question.
    condition : (F,) condition number of a tile of the first view's code at each question.
    """
    counts, options = asked.frame, solver_options(spec, learner)
    # The most likely motion needs to know all that there is.
    cameras = "both" if options.cost == "ml" else options.cameras
    rows, condition = [], []
    later: dict[int, Query] = {}
    answers: dict[int, Solutions] = {}
    for i, (begin, end) in enumerate(zip(np.append(0, counts[:-1]), counts, strict=True)):
        learner.partial_fit(tracks.select_frames(int(begin), int(end)))
        condition.append(learner.condition(view.codes[0]))
        question = asked.query.select(np.array([i]))
        known = learner.parameters(learner.rectified(view.codes), cameras)
        if options.cost != "ml" or known.own.all():
            later[i] = _rectified(learner, question)
            rows.append(known.rows)
        else:
            answers[i] = answer(spec, learner, question)
    if counts[-1] < tracks.n_frames:
        learner.partial_fit(tracks.select_frames(int(counts[-1]), tracks.n_frames))
    if later:
        # The questions differ in what was known, not in how they are solved: all at once.
        options = solver_options(spec, learner)
        query = join(list(later.values()))
        solved = ask_known(learner.task, np.stack(rows), query, options, _noise(learner))
        answers |= {i: solved.select(np.array([n])) for n, i in enumerate(later)}
    return concatenate([answers[i] for i in range(len(counts))]), np.array(condition)
