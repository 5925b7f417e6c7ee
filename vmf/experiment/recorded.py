"""An experiment on a recording: learn from some of its time, ask about the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data import Tracks
from vmf.data.recording import RecordingData
from vmf.errors import InputError, Loss
from vmf.experiment import model_file, protocols
from vmf.experiment.build import build_task
from vmf.experiment.errors_table import Asked
from vmf.experiment.functions import by_question, first_condition, nothing_learned, teach
from vmf.experiment.parallel import one_blas_thread
from vmf.experiment.trial import Outcome, error_table
from vmf.geometry import inverse, rotation_angle
from vmf.spec import Spec

# A larger share than this of a motion outside of the task space is worth a word; less than so much is none.
_OUT_OF_THE_TASK, _STILL = 0.2, 1e-6


def recorded_trial(spec: Spec, data: RecordingData, with_rivals: bool) -> Outcome:
    """Learn and ask, once per fold; the model of the last fold is the one that is kept.

    Raises
    ------
    InputError : nothing can be asked: no pair of frames shares enough targets.
    """
    one_blas_thread()
    return _all_folds(spec, data.tracks, with_rivals)


def _all_folds(spec: Spec, tracks: Tracks, with_rivals: bool) -> Outcome:
    tables: list[pd.DataFrame] = []
    losses: list[str] = []
    lost: tuple[Loss, ...] = ()
    outcome = Outcome(pd.DataFrame(), np.zeros(0, np.int64), np.zeros(0), tracks.pixels, ())
    for number, fold in enumerate(recorded_folds(spec, tracks)):
        train = tracks.select(fold.train)
        view, questions = _trained_code(spec, train, number)
        asked = questions + held_out_questions(spec, tracks, fold, number)
        taught = teach(spec, train, view, asked)
        last = taught[0].learner
        if number == 0 and questions:
            counts, condition = first_condition(taught)
            outcome = replace(outcome, counts=counts, condition=condition, updates=train.pixels)
        tables.append(error_table(spec, asked, by_question(taught), last.noise, with_rivals, with_rivals))
        losses += [*_unasked(spec, asked), *_out_of_the_task(spec, asked)]
        lost += nothing_learned(taught)
        said = [loss for one in taught for loss in one.losses]
        losses += [f"fold {number}: {loss}" if spec.evaluate.folds > 1 else loss for loss in said]
    errors = pd.concat(tables, ignore_index=True)
    if errors.empty:
        raise InputError(nothing_to_ask(spec))
    model = model_file.to_bytes(model_file.Model(spec, last))
    return replace(outcome, errors=errors, losses=tuple(losses), data_losses=lost, model=model)


def recorded_folds(spec: Spec, tracks: Tracks) -> tuple[protocols.Fold, ...]:
    """Return the blocks of time to learn from and to ask about; all to learn from if nothing is held out."""
    if "held_out" not in spec.evaluate.protocol:
        everything = np.arange(tracks.n_frames)
        return (protocols.Fold(everything, everything[:0]),)
    return protocols.folds(spec, tracks.n_frames)


def held_out_questions(spec: Spec, tracks: Tracks, fold: protocols.Fold, number: int) -> list[Asked]:
    """Return the questions about a fold's test block, if the spec wants any."""
    if "held_out" not in spec.evaluate.protocol:
        return []
    return protocols.held_out_pairs(spec, tracks, fold.test, number)


def _trained_code(spec: Spec, train: Tracks, number: int) -> tuple[protocols.FirstView | None, list[Asked]]:
    view = protocols.first_view(train, protocols.least_targets(spec))
    if "trained_code" not in spec.evaluate.protocol or view is None:
        return view, []
    counts = protocols.askable(spec, view, protocols.curve_frames(spec, train.n_frames))
    if not len(counts):
        return view, []
    return view, [replace(protocols.trained_code_questions(view, counts, train.E_S_from_W), trial=number)]


def _unasked(spec: Spec, asked: list[Asked]) -> list[str]:
    """Return what the spec wants asked and the data give no question for."""
    least = protocols.least_targets(spec)
    said = []
    if "trained_code" in spec.evaluate.protocol and all(a.protocol != "trained_code" for a in asked):
        said.append(f"trained_code: no later view shows {least} targets of the first, nothing was asked")
    if "held_out" in spec.evaluate.protocol:
        cases = {str(case) for a in asked for case in a.case[:1]}
        missing = [f"gap={gap}" for gap in spec.evaluate.gaps if f"gap={gap}" not in cases]
        said += [f"{case}: no two frames that far apart share {least} targets" for case in missing]
    return said


def _out_of_the_task(spec: Spec, asked: list[Asked]) -> list[str]:
    """Say how far the robot's motions are from any of the task, if that is a good part of them."""
    task, said = build_task(spec), []
    for questions in asked:
        query = questions.query
        if questions.protocol != "held_out" or not len(query):
            continue
        within = task.motion(task.coordinates(query.truth, query.E_initial), query.E_initial)
        rest = inverse(within) @ query.truth
        parts = []
        for unit, size in (("rad", rotation_angle), ("m", _distance)):
            off, whole = (float(np.median(size(E))) for E in (rest, query.truth))
            if off > _OUT_OF_THE_TASK * whole and off > _STILL:
                parts.append(f"{off:.3g} of {whole:.3g} {unit}")
        if parts:
            said.append(
                f"{questions.case[0]}: the robot's motions are not those of task {spec.task}: in the median, "
                f"{' and '.join(parts)} are left out"
            )
    return said


def _distance(E: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(E[:, :3, 3], axis=1))


def nothing_to_ask(spec: Spec) -> str:
    """Return the line that says why a recording gives no question."""
    gaps = ", ".join(str(g) for g in spec.evaluate.gaps)
    return (
        f"evaluate: no two frames {gaps} apart share {protocols.least_targets(spec)} targets; "
        "lower evaluate.min_targets or evaluate.gaps, or record longer tracks"
    )


def repairs(data: RecordingData | None) -> tuple[str, ...]:
    """Return what was mended in a recording without losing anything."""
    return () if data is None else tuple(f"repaired: {repair}" for repair in data.repairs)
