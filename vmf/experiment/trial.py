"""One trial: learn frame by frame, ask on the way and at the end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data import Query
from vmf.data.simulate import Simulation, disturbed_pixels, held_out_queries, simulate, trial_streams
from vmf.experiment import model_file, protocols
from vmf.experiment.asking import answer, learn_and_answer
from vmf.experiment.build import build_learner, build_task, rig_model
from vmf.experiment.errors_table import Asked, no_motion_rows, solution_rows
from vmf.learn import Learner
from vmf.reconstruct import CalibrationErrorLike, disturb, label, reconstruct
from vmf.solve import Solutions
from vmf.spec import Spec

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Outcome:
    """What a trial found.

    Attributes
    ----------
    errors : the tidy table with `case` and `query`.
    counts, condition : (F,) frames learned, and the condition number of a tile of the first view's code.
    updates : (V, 4) visited codes, for the update map.
    losses : what could not be used, in words.
    """

    errors: pd.DataFrame
    counts: Ints
    condition: Floats
    updates: Floats
    losses: tuple[str, ...]


def simulated_trial(spec: Spec, trial: int, with_rivals: bool, model: Path | None = None) -> Outcome:
    """Run one simulated trial; its random numbers depend on the spec's seed and its own number alone.

    Parameters
    ----------
    spec : the experiment.
    trial : number of the trial.
    with_rivals : whether the 3-D methods answer the same questions.
    model : where to write the trained model.

    Raises
    ------
    InputError : the workspace hardly ever shows all targets.
    """
    for_training, for_queries = trial_streams(spec, trial)
    simulation = simulate(spec, for_training)
    seen = disturbed_pixels(simulation, spec, for_training) if spec.noise.point_m > 0.0 else None
    learner = build_learner(spec)
    questions: list[Asked] = []
    answers: list[Solutions] = []
    counts, condition = _learn(spec, learner, simulation, seen, questions, answers)
    if "held_out" in spec.evaluate.protocol:
        query = held_out_queries(spec, for_queries)
        frames = np.full(len(query), simulation.tracks.n_frames)
        case = np.full(len(query), f"frame={simulation.tracks.n_frames}")
        questions.append(Asked("held_out", trial, frames, case, query))
        answers.append(answer(spec, learner, query))
    if model is not None:
        model_file.save(model, model_file.Model(spec, learner))
    questions = [Asked(q.protocol, trial, q.frame, q.case, q.query) for q in questions]
    errors = error_table(spec, questions, answers, with_rivals)
    return Outcome(errors, counts, condition, simulation.tracks.pixels, learner.losses)


def _learn(
    spec: Spec,
    learner: Learner,
    simulation: Simulation,
    seen: Floats | None,
    questions: list[Asked],
    answers: list[Solutions],
) -> tuple[Ints, Floats]:
    tracks = simulation.tracks
    counts = protocols.curve_frames(spec, tracks.n_frames)
    view = protocols.first_view(tracks, spec.evaluate.min_targets or 1)
    if "trained_code" not in spec.evaluate.protocol or view is None:
        learner.partial_fit(tracks)
        return np.zeros(0, np.int64), np.zeros(0)
    asked = protocols.trained_code_questions(view, counts, simulation.E_true, seen)
    solutions, condition = learn_and_answer(spec, learner, tracks, view, asked)
    questions.append(asked)
    answers.append(solutions)
    return counts, condition


def error_table(
    spec: Spec, questions: list[Asked], answers: list[Solutions], with_rivals: bool
) -> pd.DataFrame:
    """Return the tidy table of the function's answers, of no motion, and of the rivals if wanted."""
    methods = rivals(spec) if with_rivals else {}
    tables = []
    task = build_task(spec)
    for asked, solutions in zip(questions, answers, strict=True):
        tables.append(solution_rows(task, asked, "vmf", solutions))
        tables += [solution_rows(task, asked, name, m(asked.query)) for name, m in methods.items()]
        tables.append(no_motion_rows(task, asked))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def rivals(spec: Spec) -> dict[str, Callable[[Query], Solutions]]:
    """Return the spec's 3-D methods by name; none where nothing says what the cameras are."""
    model = rig_model(spec)
    if model is None:
        return {}
    task = build_task(spec)
    known = spec.solver.known == "rotation"

    def method(name: str, error: CalibrationErrorLike) -> Callable[[Query], Solutions]:
        cameras = disturb(model, error)
        return lambda query: reconstruct(name, task, cameras, query, known_rotation=known)

    return {label(r.method, r.error): method(r.method, r.error) for r in spec.rivals}
