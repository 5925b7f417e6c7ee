"""`vmf train` and `vmf compare-3d`: one experiment from its spec to its run directory."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data.recording import RecordingData
from vmf.errors import InputError, Loss
from vmf.experiment import protocols
from vmf.experiment.atomic import write_bytes, write_text
from vmf.experiment.build import check_solver, rig_model
from vmf.experiment.calibration_sweep import crossing, only_swept
from vmf.experiment.parallel import run_all
from vmf.experiment.recorded import recorded_folds, recorded_trial
from vmf.experiment.rejected import rejected_notes, rejected_targets
from vmf.experiment.run_directory import RunDirectory
from vmf.experiment.statistics import SUMMARY, paired_differences, summarise
from vmf.experiment.trial import Outcome, simulated_trial
from vmf.report import write_plots
from vmf.spec import (
    CmacApproximator,
    Data,
    LoadedSpec,
    Noise,
    PipelineLearner,
    PolynomialApproximator,
    Solver,
    Spec,
    StructuredLearner,
)

# progress(done, total, what)
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class RunOptions:
    """Where a run goes and how it is worked off; nothing here changes a number."""

    out: Path = Path("runs")
    jobs: int = 1
    resume: bool = False


@dataclass(frozen=True)
class RunResult:
    """What a command prints.

    Attributes
    ----------
    run_dir : the run directory.
    summary : content of `summary.csv`.
    paired : paired differences, None where no rival answered.
    crossovers : content of `crossover.csv`, None without a calibration sweep.
    swept : methods of the summary that the calibration sweep alone asked, too many for a table.
    plots : the figures written.
    losses : what was lost on the way; any loss means exit code 3.
    notes : what was repaired or could not be used without being a loss.
    """

    run_dir: Path
    summary: pd.DataFrame
    paired: pd.DataFrame | None
    crossovers: pd.DataFrame | None
    swept: tuple[str, ...]
    plots: tuple[Path, ...]
    losses: tuple[Loss, ...]
    notes: tuple[str, ...]


def run_experiment(
    loaded: LoadedSpec, command: str, options: RunOptions, progress: Progress | None = None
) -> RunResult:
    """Train, ask, count and draw; `command` is `train` or `compare-3d`, which adds the rivals.

    Raises
    ------
    InputError : the spec cannot be carried out, or its data cannot be read.
    """
    spec = runnable_anywhere(loaded)
    data = _recording(spec, progress)
    _check(spec, data)
    parent = options.out / (spec.name or loaded.path.stem)
    inputs = {} if data is None else {str(data.path): data.sha256}
    run = RunDirectory.unfinished(parent, spec, command, inputs) if options.resume else None
    if run is None:
        run = RunDirectory.create(parent, spec, command, loaded.overrides, inputs)
    try:
        outcomes = _outcomes(spec, data, run, command == "compare-3d", options.jobs, progress)
        losses = () if data is None else data.losses
        notes = repairs(data) + _without_effect(spec) + (_unopposed(spec) if command == "compare-3d" else ())
        result = write_results(run, spec, outcomes, losses, notes)
    except KeyboardInterrupt:
        run.finish("interrupted")
        raise
    except BaseException as error:
        run.finish("failed", error=str(error))
        raise
    for path in run.trials.glob("*"):
        path.unlink()
    if run.trials.exists():
        run.trials.rmdir()
    return result


def repairs(data: RecordingData | None) -> tuple[str, ...]:
    """Return what was mended in a recording without losing anything."""
    return () if data is None else tuple(f"repaired: {repair}" for repair in data.repairs)


def _without_effect(spec: Spec) -> tuple[str, ...]:
    """Return which of the spec's settings decide nothing, being another learner's or another cost's."""
    said = []
    if isinstance(spec.learner, StructuredLearner):
        if spec.approximator != PolynomialApproximator():
            said.append("approximator has no effect with learner.kind: structured")
        default = Solver()
        if spec.solver.cost in ("auto", "ml") and (spec.solver.start, spec.solver.max_iterations) != (
            default.start,
            default.max_iterations,
        ):
            said.append("solver.start and solver.max_iterations have no effect with solver.cost: ml")
    if isinstance(spec.learner, PipelineLearner) and isinstance(spec.approximator, CmacApproximator):
        own = CmacApproximator()
        idle = [k for k in ("epochs", "new_tiles") if getattr(spec.approximator, k) != getattr(own, k)]
        said += [f"approximator.{key} has no effect with learner.kind: pipeline" for key in idle]
    if spec.lift == "thesis" and spec.task != "pan_tilt":
        said.append("lift: thesis has no effect, it is a form of pan_tilt")
    if spec.data.recording is not None and spec.noise != Noise():
        said.append("noise has no effect on a recording")
    return tuple(said)


def _unopposed(spec: Spec) -> tuple[str, ...]:
    if not spec.rivals:
        return ("nothing to compare with: rivals is empty",)
    if rig_model(spec) is None:
        return ("nothing to compare with: no rival without data.recording.calibration",)
    return ()


def runnable_anywhere(loaded: LoadedSpec) -> Spec:
    """Return the spec with the recording's path made absolute: it was relative to the spec's folder."""
    source = loaded.spec.data.recording
    if source is None:
        return loaded.spec
    path = (loaded.path.parent / source.path).resolve()
    data = Data(recording=source.model_copy(update={"path": str(path)}))
    return loaded.spec.model_copy(update={"data": data})


def _recording(spec: Spec, progress: Progress | None) -> RecordingData | None:
    from vmf.data.recording import read

    source = spec.data.recording
    return None if source is None else read(source, spec.mounting, Path.cwd(), progress)


def _check(spec: Spec, data: RecordingData | None) -> None:
    """Refuse before any work what could only fail later."""
    check_solver(spec)
    if data is not None and spec.evaluate.trials != 1:
        raise InputError(
            f"evaluate.trials: found {spec.evaluate.trials}, a recording is one trial: 1 is accepted"
        )
    if spec.name is not None and Path(spec.name).name != spec.name:
        raise InputError(f"name: found {spec.name!r}, the name of a directory without separators is accepted")
    if data is not None and "held_out" in spec.evaluate.protocol and not spec.evaluate.gaps:
        raise InputError("evaluate.gaps: found none, a list of frame counts is accepted")
    if data is not None and spec.evaluate.folds > max(data.tracks.n_frames // 2, 1):
        raise InputError(
            f"evaluate.folds: found {spec.evaluate.folds}, at most half as many blocks as the recording's "
            f"{data.tracks.n_frames} frames are accepted"
        )
    if not spec.evaluate.protocol:
        raise InputError("evaluate.protocol: found none, trained_code and held_out are accepted")
    if spec.data.simulate is not None:
        protocols.checkpoints(spec, spec.data.simulate.frames)
    elif data is not None:
        fewest = min(len(fold.train) for fold in recorded_folds(spec, data.tracks))
        if fewest < 2:
            raise InputError(
                f"evaluate: {fewest} frames of {data.tracks.n_frames} to learn from, 2 or more are accepted; "
                "raise evaluate.train_fraction"
            )
        protocols.checkpoints(spec, fewest)


def _outcomes(
    spec: Spec,
    data: RecordingData | None,
    run: RunDirectory,
    with_rivals: bool,
    jobs: int,
    progress: Progress | None,
) -> list[Outcome]:
    if data is not None:
        return [recorded_trial(spec, data, with_rivals, run.model)]
    run.trials.mkdir(exist_ok=True)
    total = spec.evaluate.trials
    missing = [n for n in range(total) if not _trial_path(run, n).exists()]
    done = total - len(missing)
    if progress is not None:
        progress(done, total, "trials")
    work = partial(_trial, spec, with_rivals, run.path)
    for _ in run_all(work, missing, jobs):
        done += 1
        if progress is not None:
            progress(done, total, "trials")
    return [_load(_trial_path(run, n)) for n in range(total)]


def _trial_path(run: RunDirectory, number: int) -> Path:
    return run.trials / f"{number:06d}.parquet"


def _trial(spec: Spec, with_rivals: bool, run_path: Path, number: int) -> None:
    """Run one trial and leave its outcome on disk, where a later run finds it."""
    run = RunDirectory(run_path, {})
    outcome = simulated_trial(spec, number, with_rivals, run.model if number == 0 else None)
    table = outcome.errors
    table.attrs = {
        "counts": outcome.counts.tolist(),
        "condition": outcome.condition.tolist(),
        "losses": list(outcome.losses),
        # The update map shows one trial.
        "updates": outcome.updates.tolist() if number == 0 else [],
    }
    write_bytes(_trial_path(run, number), table.to_parquet())


def _load(path: Path) -> Outcome:
    table = pd.read_parquet(path)
    more, table.attrs = table.attrs, {}
    return Outcome(
        table,
        np.array(more["counts"], np.int64),
        np.array(more["condition"], float),
        np.array(more["updates"], float).reshape(-1, 4),
        tuple(more["losses"]),
    )


def write_results(
    run: RunDirectory,
    spec: Spec,
    outcomes: list[Outcome],
    losses: tuple[Loss, ...],
    notes: tuple[str, ...],
    cases: tuple[str, ...] | None = None,
) -> RunResult:
    """Write tables and plots of finished trials, and close the run; `cases` are those of the summary."""
    errors = pd.concat([o.errors for o in outcomes], ignore_index=True)
    if errors.empty:
        raise InputError(
            f"evaluate: no view shows {protocols.least_targets(spec)} targets in both cameras, "
            "nothing to ask; lower evaluate.min_targets"
        )
    cases = cases or summary_cases(spec, errors)
    seed = 0 if spec.data.simulate is None else spec.data.simulate.seed
    summary = summarise(errors, cases, seed, spec.evaluate.bootstrap)
    run.write_tables(errors, summary)
    rejected = rejected_targets(errors)
    if len(rejected):
        write_text(run.path / "rejected.csv", rejected.to_csv(index=False))
    found = crossing(spec, errors, seed)
    swept = tuple(method for method in only_swept(spec) if (errors["method"] == method).any())
    errors = errors[~errors["method"].isin(swept)]
    if found is not None:
        write_text(run.path / "crossover.csv", found.crossovers.to_csv(index=False))
    paired = None
    if (~errors["method"].isin(["vmf", "no_motion", "cramer_rao"])).any():
        paired = paired_differences(errors, cases, seed, spec.evaluate.bootstrap)
        write_text(run.path / "paired.csv", paired.to_csv(index=False))
    run.plots.mkdir(exist_ok=True)
    plots = write_plots(
        run.plots,
        errors,
        condition=_condition(outcomes),
        updates=_updates(spec, outcomes[0]),
        paired=paired,
        crossing=None if found is None else (found.curves, found.crossovers),
    )
    losses = losses + _diverged(errors)
    notes = notes + _notes(outcomes) + rejected_notes(errors)
    run.finish("done", losses, notes=list(notes), cases=_case_names(errors), swept=list(swept))
    crossovers = None if found is None else found.crossovers
    return RunResult(run.path, summary, paired, crossovers, swept, plots, losses, notes)


def summary_cases(spec: Spec, errors: pd.DataFrame) -> tuple[str, ...]:
    """Return the cases worth a row of the summary: the checkpoints, and every gap."""
    held_out = errors.loc[errors["protocol"] == "held_out", "case"].unique().tolist()
    if spec.data.simulate is not None:
        frames = protocols.checkpoints(spec, spec.data.simulate.frames)
    else:
        counts = errors.loc[errors["protocol"] == "trained_code", "frame"]
        chosen = spec.evaluate.checkpoints or ()
        frames = tuple(c for c in chosen if (counts == c).any()) or tuple(counts.max() for _ in counts[:1])
    return tuple(dict.fromkeys([*(f"frame={f}" for f in frames), *held_out]))


def _condition(outcomes: list[Outcome]) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
    known = [o for o in outcomes if np.isfinite(o.condition).any()]
    if not known:
        return None
    return known[0].counts, np.stack([o.condition for o in known])


def _updates(spec: Spec, outcome: Outcome) -> tuple[NDArray[np.float64], tuple[int, int], float] | None:
    """Visited codes, image size and tile width of the update map."""
    if not len(outcome.updates):
        return None
    tile = float(getattr(spec.approximator, "tile_px", 32.0))
    if spec.data.simulate is not None:
        from vmf.data.simulate import rig, simulated_rig

        return outcome.updates, rig(simulated_rig(spec.data.simulate))[1], tile
    size = np.ceil(np.nanmax(outcome.updates.reshape(-1, 2), axis=0) + 0.5).astype(int)
    return outcome.updates, (int(size[0]), int(size[1])), tile


def _diverged(errors: pd.DataFrame) -> tuple[Loss, ...]:
    mine = errors[(errors["method"] == "vmf") & (errors["component"] == "angle")]
    n = int((mine["status"] == "diverged").sum())
    return (Loss("vmf", f"of {len(mine)} motions asked for did not converge", n),) if n else ()


def _notes(outcomes: list[Outcome]) -> tuple[str, ...]:
    said = [loss for o in outcomes for loss in o.losses]
    counted = {text: said.count(text) for text in dict.fromkeys(said)}
    return tuple(text if n == 1 else f"{text} (in {n} trials)" for text, n in counted.items())


def _case_names(errors: pd.DataFrame) -> dict[str, str]:
    """Return the case of each held-out trial number, which `errors.parquet` has no column for."""
    held_out = errors[errors["protocol"] == "held_out"]
    pairs = held_out[["trial", "case"]].drop_duplicates()
    return {str(trial): str(case) for trial, case in pairs.itertuples(index=False)}


def read_summary(path: Path) -> pd.DataFrame:
    """Return the content of a run's `summary.csv`.

    Raises
    ------
    InputError : there is none, or it has other columns.
    """
    file = path / "summary.csv"
    try:
        table = pd.read_csv(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: not a readable summary ({error})") from error
    if list(table.columns) != list(SUMMARY):
        raise InputError(f"{file}: found columns {', '.join(table.columns)}, not those of a summary")
    return table


def read_record(path: Path) -> dict[str, Any]:
    """Return the content of a run's `run.json`.

    Raises
    ------
    InputError : there is none, or it is not JSON.
    """
    try:
        record = json.loads((path / "run.json").read_text())
    except OSError as error:
        raise InputError(
            f"{path}: no run.json here ({error.strerror}), the directory of a run is expected"
        ) from error
    except ValueError as error:
        raise InputError(f"{path / 'run.json'}: not JSON ({error})") from error
    if not isinstance(record, dict):
        raise InputError(f"{path / 'run.json'}: not the record of a run")
    return record
