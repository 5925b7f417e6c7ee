"""`vmf evaluate`: error statistics of a trained model, on data it has not seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from vmf.data import Tracks
from vmf.data.recording import JOINTS_TOPIC, POSE_TOPIC, TRACKS_TOPIC, RecordingData, read
from vmf.data.recording.output import check_target
from vmf.data.simulate import disturbed_views, simulate, trial_streams
from vmf.errors import InputError
from vmf.experiment import model_file, protocols
from vmf.experiment.errors_table import Asked
from vmf.experiment.evaluation_file import Evaluation, write_evaluation
from vmf.experiment.functions import Answer, answer_with
from vmf.experiment.model_file import Model
from vmf.experiment.parallel import one_blas_thread
from vmf.experiment.recorded import held_out_questions, nothing_to_ask, repairs
from vmf.experiment.run import Progress, RunResult, read_record, write_results
from vmf.experiment.run_directory import RunDirectory, sha256
from vmf.experiment.trial import Outcome, error_table, held_out_asked, trained_code_asked
from vmf.spec import Data, JointSource, PoseSource, Recording, Spec, TrackSource

# What may be asked differently of a model that is already trained.
_OPEN = ("evaluate", "solver", "noise", "rivals", "name")
# What decided which part of the data the model has seen.
_CLOSED = ("evaluate.train_fraction", "evaluate.folds", "evaluate.trials")


def evaluate(
    run_path: Path,
    overrides: tuple[str, ...],
    recording: Path | None,
    progress: Progress | None = None,
    out: Path | None = None,
    mcap: Path | None = None,
) -> RunResult:
    """Evaluate the model of a run; the results go to `RUN/evaluations/`, or below `out`.

    Parameters
    ----------
    run_path : a run directory, or its `latest` link.
    overrides : dotted settings of `evaluate`, `solver`, `noise` and `rivals`.
    recording : another recording of the same rig, None for what the run itself held out.
    progress : is told how far it is.
    out : where to instead.
    mcap : where the evaluation goes as a recording, beside the images of the one that is asked about.

    Raises
    ------
    InputError : no such run, an override that a trained model cannot take, unreadable data, or a recording
        that cannot be written.
    """
    one_blas_thread()
    record = read_record(run_path)
    if record.get("status") != "done":
        raise InputError(f"{run_path}: status {record.get('status')}, a finished run is expected")
    model = model_file.load(run_path / "model.npz")
    spec = _asked_spec(model, overrides, recording)
    if mcap is not None:
        source = spec.data.recording
        check_target(mcap, "--mcap", () if source is None else (Path(source.path),))
    data = None
    if spec.data.recording is not None:
        data = read(spec.data.recording, spec.mounting, Path.cwd(), progress)
    inputs = {str(run_path / "model.npz"): sha256(run_path / "model.npz")}
    if data is not None:
        inputs[str(data.path)] = data.sha256
    parent = run_path.resolve() / "evaluations" if out is None else out / run_path.resolve().parent.name
    if progress is not None:
        progress(0, 1, "evaluation")
    if data is None:
        outcome, answers = _simulated(spec, model)
    else:
        # The recording that was learned from, by whatever name, is asked about what it held out.
        learned = data.sha256 in record.get("inputs", {}).values()
        outcome, answers = _recorded(spec, model, data, everything=not learned)
    run = RunDirectory.create(parent, spec, "evaluate", overrides, inputs)
    try:
        losses = () if data is None else data.losses
        cases = tuple(dict.fromkeys(outcome.errors["case"]))
        notes = repairs(data)
        if mcap is not None:
            notes += write_evaluation(mcap, Evaluation(spec, model, answers, outcome.errors, data), progress)
        result = write_results(run, spec, [outcome], losses, notes, cases)
    except BaseException as error:
        run.finish("interrupted" if isinstance(error, KeyboardInterrupt) else "failed", error=str(error))
        raise
    if progress is not None:
        progress(1, 1, "evaluation")
    return result


def _asked_spec(model: Model, overrides: tuple[str, ...], recording: Path | None) -> Spec:
    spec = model_file.overridden(model, overrides, _OPEN, _CLOSED)
    if recording is None:
        return spec
    source = spec.data.recording or _own_topics(spec)
    source = source.model_copy(update={"path": str(recording)})
    return spec.model_copy(update={"data": Data(recording=source)})


def _own_topics(spec: Spec) -> Recording:
    """Return where `vmf simulate` writes poses and tracks."""
    tracks = TrackSource(topic=TRACKS_TOPIC)
    if spec.task == "pan_tilt":
        return Recording(path="", joints=JointSource(topic=JOINTS_TOPIC), tracks=tracks)
    return Recording(path="", pose=PoseSource(topic=POSE_TOPIC), tracks=tracks)


def _simulated(spec: Spec, model: Model) -> tuple[Outcome, list[Answer]]:
    """Ask the model of trial 0 about its own first view at every training pose, and about new targets."""
    for_training, for_queries = trial_streams(spec, 0)
    questions: list[Asked] = []
    tracks = None
    if "trained_code" in spec.evaluate.protocol:
        simulation = simulate(spec, for_training)
        tracks = simulation.tracks
        learned = model.learner.tracks
        view = None if learned is None else protocols.first_view(learned, 1)
        if view is not None:
            n = tracks.n_frames
            disturbed = None
            if spec.noise.point_m > 0.0:
                disturbed = disturbed_views(simulation, spec, for_training)
            # The first view is the one that was learned; what the newest views show is seen anew.
            asked = trained_code_asked(view, np.arange(2, n + 1), simulation, disturbed)
            questions.append(replace(asked, case=np.full(len(asked.query), f"frame={n}")))
    if "held_out" in spec.evaluate.protocol:
        questions.append(held_out_asked(spec, 0, for_queries))
    return _outcome(spec, model, questions, tracks)


def _recorded(
    spec: Spec, model: Model, data: RecordingData, everything: bool
) -> tuple[Outcome, list[Answer]]:
    """Ask about the block that the run held out, or about all of another recording."""
    tracks = data.tracks
    if "held_out" not in spec.evaluate.protocol:
        raise InputError(
            "evaluate.protocol: a recording is asked about what was held out, held_out is accepted"
        )
    if not everything and "held_out" not in model.spec.evaluate.protocol:
        raise InputError(
            "evaluate.protocol: the model has learned all of this recording, --data FILE.mcap is accepted"
        )
    if everything:
        frames = np.arange(tracks.n_frames)
        fold, number = protocols.Fold(frames[:0], frames), 0
    else:
        number = spec.evaluate.folds - 1
        fold = protocols.folds(spec, tracks.n_frames)[number]
    questions = held_out_questions(spec, tracks, fold, number)
    if not questions:
        raise InputError(nothing_to_ask(spec))
    return _outcome(spec, model, questions, tracks)


def _outcome(
    spec: Spec, model: Model, questions: list[Asked], tracks: Tracks | None
) -> tuple[Outcome, list[Answer]]:
    answers = list(answer_with("vmf", spec, model.learner, questions))
    each = [(answered,) for answered in answers]
    errors = error_table(spec, questions, each, model.learner.noise, True, False)
    updates = np.zeros((0, 4)) if tracks is None else tracks.pixels
    outcome = Outcome(errors, np.zeros(0, np.int64), np.zeros(0), updates, model.learner.losses)
    return outcome, answers
