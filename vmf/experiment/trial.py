"""One trial: learn frame by frame, ask on the way and at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data.simulate import (
    Disturbed,
    Simulation,
    disturbed_views,
    held_out_questions,
    trained_code_truth,
    trial_streams,
)
from vmf.errors import Loss
from vmf.estimate.noise import Noise
from vmf.experiment import model_file, protocols
from vmf.experiment.bound import bound_rows
from vmf.experiment.build import build_task, rig_model
from vmf.experiment.calibration_sweep import sweep_rows
from vmf.experiment.errors_table import Asked, no_motion_rows, odometry_rows
from vmf.experiment.filmed import observe
from vmf.experiment.functions import Answer, by_question, first_condition, nothing_learned, teach
from vmf.experiment.system import reconstructed_off
from vmf.geometry import StereoCameras, inverse
from vmf.reconstruct import disturb, label, reconstruct
from vmf.spec import Spec
from vmf.spec.model import Rival

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
    data_losses : what of a recording could not be used, and that nothing was learned.
    model : the trained model as the content of a file, None where it was not wanted.
    points : (P, 3) how far reconstructed points of held-out questions are from the true ones (m), if asked.
    """

    errors: pd.DataFrame
    counts: Ints
    condition: Floats
    updates: Floats
    losses: tuple[str, ...]
    data_losses: tuple[Loss, ...] = ()
    model: bytes | None = None
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))


def simulated_trial(spec: Spec, trial: int, with_rivals: bool, keep_model: bool = False) -> Outcome:
    """Run one simulated trial; its random numbers depend on the spec's seed and its own number alone.

    Parameters
    ----------
    spec : the experiment.
    trial : number of the trial.
    with_rivals : whether the 3-D methods answer the same questions, and the calibration sweep is made.
    keep_model : whether the trained model is wanted.

    Raises
    ------
    InputError : the workspace hardly ever shows all targets.
    """
    for_training, for_queries = trial_streams(spec, trial)
    filmed = observe(spec, trial, for_training)
    simulation = filmed.simulation
    disturbed = disturbed_views(simulation, spec, for_training) if spec.noise.point_m > 0.0 else None
    tracks = simulation.tracks
    view = protocols.first_view(tracks, spec.evaluate.min_targets or 1)
    questions: list[Asked] = []
    if "trained_code" in spec.evaluate.protocol and view is not None:
        counts = protocols.curve_frames(spec, tracks.n_frames)
        asked = trained_code_asked(view, counts, simulation, disturbed, spec.noise.drifts)
        questions.append(replace(asked, trial=trial))
    if "held_out" in spec.evaluate.protocol:
        questions.append(held_out_asked(spec, trial, for_queries))
    taught = teach(spec, tracks, view, questions)
    learner = taught[0].learner
    model = model_file.to_bytes(model_file.Model(spec, learner)) if keep_model else None
    errors = error_table(spec, questions, by_question(taught), learner.noise, with_rivals, with_rivals)
    counts, condition = first_condition(taught)
    losses = filmed.notes + tuple(loss for one in taught for loss in one.losses)
    lost = nothing_learned(taught)
    points = _points_off(spec, questions) if with_rivals else np.zeros((0, 3))
    return Outcome(errors, counts, condition, tracks.pixels, losses, lost, model, points)


def _points_off(spec: Spec, questions: list[Asked]) -> Floats:
    """Return how far (P, 3) the points of held-out questions are off when reconstructed (m)."""
    rig = rig_model(spec)
    assert rig is not None
    off = [
        reconstructed_off(rig, asked.query, asked.truth)
        for asked in questions
        if asked.protocol == "held_out" and asked.truth is not None
    ]
    return np.concatenate([np.zeros((0, 3)), *off])


def held_out_asked(spec: Spec, trial: int, rng: np.random.Generator) -> Asked:
    """Return a simulated trial's questions about new targets at new poses."""
    assert spec.data.simulate is not None
    n = spec.data.simulate.frames
    query, truth = held_out_questions(spec, rng)
    case = np.full(len(query), f"frame={n}")
    return Asked("held_out", trial, np.full(len(query), n), case, query, truth=truth)


def trained_code_asked(
    view: protocols.FirstView,
    counts: Ints,
    simulation: Simulation,
    disturbed: Disturbed | None,
    drifts: bool = False,
) -> Asked:
    """Return a simulated trial's questions at trained codes with their truth, and odometry if it drifts."""
    if disturbed is None:
        seen = protocols.pixels_of(simulation.tracks, view.targets)
    else:
        seen = disturbed.pixels[:, view.targets]
    asked = protocols.trained_code_questions(view, counts, simulation.E_true, seen)
    truth = trained_code_truth(simulation, view.frame, counts - 1, view.targets, disturbed)
    E = simulation.tracks.E_S_from_W
    drifted = E[counts - 1] @ inverse(E[view.frame])
    return replace(asked, truth=truth, odometry=drifted if drifts else None)


def error_table(
    spec: Spec,
    questions: list[Asked],
    answers: Sequence[Sequence[Answer]],
    noise: Noise | None,
    with_rivals: bool,
    with_sweep: bool,
) -> pd.DataFrame:
    """Return the tidy table of the functions' answers, the rivals', the bound's and no motion's.

    Rivals and the calibration sweep are asked if wanted; there is a bound where the truth is known. `noise`
    is what the learner has found.
    """
    source = spec.data.simulate
    sticks = source is not None and any(lost.shows == "edge" for lost in source.lost)
    if source is not None and spec.noise.outlier_ratio == 0.0 and not sticks:
        # Least squares is the rivals' best where all noise is Gaussian.
        noise = None
    methods = rivals(spec, noise) if with_rivals else ()
    tables = []
    task = build_task(spec)
    for asked, answered in zip(questions, answers, strict=True):
        tables += [one.rows() for one in answered]
        tables += [rival.answer(asked).rows() for rival in methods]
        if asked.truth is not None:
            tables.append(bound_rows(spec, asked))
        tables.append(no_motion_rows(task, asked))
        if asked.odometry is not None:
            tables.append(odometry_rows(task, asked))
        if with_sweep:
            tables += sweep_rows(spec, asked, noise)
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


@dataclass(frozen=True)
class Reconstruction:
    """A rival: a 3-D method with cameras, exact or off.

    Attributes
    ----------
    spec : the experiment.
    rival : the method and how far its cameras are off.
    cameras : those cameras.
    noise : how pixels scatter.
    """

    spec: Spec
    rival: Rival
    cameras: StereoCameras
    noise: Noise | None

    def answer(self, asked: Asked) -> Answer:
        """Return its answers, at trained codes to as many questions as its curve has points."""
        spec, rival = self.spec, self.rival
        which = np.arange(len(asked.query))
        if asked.protocol == "trained_code" and rival.curve_points is not None:
            asking = spec.evaluate
            which = protocols.thinned(asked.frame, rival.curve_points, asking.checkpoints, asking.curve_last)
        some, task = asked.select(which), build_task(spec)
        known = spec.solver.known == "rotation"
        found = reconstruct(
            rival.method, task, self.cameras, some.query, known_rotation=known, noise=self.noise
        )
        return Answer(label(rival.method, rival.error), task, some, which, found)


def rivals(spec: Spec, noise: Noise | None) -> tuple[Reconstruction, ...]:
    """Return the spec's 3-D methods; none where nothing says what the cameras are.

    They are given the same noise model as the learned function is solved with.
    """
    model = rig_model(spec)
    if model is None:
        return ()
    return tuple(Reconstruction(spec, r, disturb(model, r.error), noise) for r in spec.rivals)
