"""`vmf train` and `vmf compare-3d`: one experiment from its spec to its run directory."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data.recording import RecordingData
from vmf.errors import InputError, Loss, UnfinishedError
from vmf.experiment import outcome_file, protocols
from vmf.experiment.atomic import write_bytes
from vmf.experiment.build import idle_solver_settings, rig_model
from vmf.experiment.calibration_sweep import crossing, only_swept
from vmf.experiment.check import check
from vmf.experiment.errors_table import joined
from vmf.experiment.parallel import Crew, Failure, Why, crew, run_all
from vmf.experiment.recorded import recorded_trial, repairs
from vmf.experiment.rejected import rejected_notes, rejected_targets
from vmf.experiment.run_directory import RunDirectory
from vmf.experiment.statistics import SUMMARY, beyond, paired_differences, summarise
from vmf.experiment.system import condition_table, point_errors
from vmf.experiment.trial import Outcome
from vmf.experiment.usage import Usage
from vmf.experiment.work import TrialResult, TrialWork
from vmf.regular_file import open_regular
from vmf.spec import (
    CmacApproximator,
    Data,
    LoadedSpec,
    Noise,
    PipelineLearner,
    PolynomialApproximator,
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
    check(spec, data)
    parent = options.out / (spec.name or loaded.path.stem)
    inputs = {} if data is None else {str(data.path): data.sha256}
    run = RunDirectory.unfinished(parent, spec, command, inputs) if options.resume else None
    if run is None:
        run = RunDirectory.create(parent, spec, command, loaded.overrides, inputs)
    try:
        outcomes = _outcomes(spec, data, run, command == "compare-3d", options.jobs, progress)
        lost = tuple(loss for outcome in outcomes for loss in outcome.data_losses)
        losses = lost if data is None else data.losses + lost
        notes = repairs(data) + remarks(spec, command)
        result = write_results(run, spec, outcomes, losses, notes)
    except KeyboardInterrupt:
        run.finish("interrupted")
        raise
    except BaseException as error:
        run.finish("failed", error=str(error))
        raise
    run.remove_trials()
    return result


def remarks(spec: Spec, command: str) -> tuple[str, ...]:
    """Return what of a spec does nothing in this command."""
    return _without_effect(spec) + (_unopposed(spec) if command == "compare-3d" else ())


def _without_effect(spec: Spec) -> tuple[str, ...]:
    """Return which of the spec's settings decide nothing, being another learner's or another cost's."""
    said = list(idle_solver_settings(spec))
    if isinstance(spec.learner, StructuredLearner) and spec.approximator != PolynomialApproximator():
        said.append("approximator has no effect with learner.kind: structured")
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


def _outcomes(
    spec: Spec,
    data: RecordingData | None,
    run: RunDirectory,
    with_rivals: bool,
    jobs: int,
    progress: Progress | None,
) -> list[Outcome]:
    if data is not None:
        outcome = recorded_trial(spec, data, with_rivals)
        assert outcome.model is not None
        write_bytes(run.model, outcome.model)
        return [outcome]
    total = spec.evaluate.trials
    works = [TrialWork(spec, number, with_rivals) for number in run.missing_trials(total)]
    done = total - len(works)
    if progress is not None:
        progress(done, total, "trials")
    lost = []
    workers: Crew[TrialWork, TrialResult] = crew(jobs, len(works))
    with workers:
        for work, result in run_all(workers, works):
            if isinstance(result, Failure):
                if result.why is not Why.LOST:
                    raise result.error()
                lost.append(f"trial {work.number}: {result}")
                continue
            run.keep_trial(work.number, result.table, result.model)
            done += 1
            if progress is not None:
                progress(done, total, "trials")
    if lost:
        raise UnfinishedError(*lost, f"{done} of {total} trials are on disk, --resume goes on from there")
    return [outcome_file.load(run.trial(n)) for n in range(total)]


def write_results(
    run: RunDirectory,
    spec: Spec,
    outcomes: list[Outcome],
    losses: tuple[Loss, ...],
    notes: tuple[str, ...],
    cases: tuple[str, ...] | None = None,
    *,
    draw: bool = True,
    pdf: bool = True,
    usage: Callable[[], Usage] | None = None,
) -> RunResult:
    """Write tables and plots of finished trials, and close the run.

    Parameters
    ----------
    run : where to.
    spec : what was asked for.
    outcomes : of all trials.
    losses, notes : what is to be said beside what the outcomes say.
    cases : those of the summary, by default the spec's.
    draw, pdf : whether plots are wanted, and as PDF beside PNG.
    usage : says what it took, if not this process alone.

    Raises
    ------
    InputError : there was nothing to ask.
    """
    errors = joined([o.errors for o in outcomes])
    if errors.empty:
        raise InputError(
            f"evaluate: no view shows {protocols.least_targets(spec)} targets in both cameras, "
            "nothing to ask; lower evaluate.min_targets"
        )
    cases = cases or summary_cases(spec, errors)
    seed = 0 if spec.data.simulate is None else spec.data.simulate.seed
    resamples = spec.evaluate.bootstrap
    later, later_cases = beyond(errors, sorted(set(spec.evaluate.beyond)))
    tables = [(errors, cases)] + [(later, later_cases)] * (not later.empty)
    summary = pd.concat([summarise(*one, seed, resamples) for one in tables], ignore_index=True)
    found = crossing(spec, errors, seed)
    crossovers = None if found is None else found.crossovers
    swept = tuple(method for method in only_swept(spec) if (errors["method"] == method).any())
    listed = errors[~errors["method"].isin(swept)]
    paired = None
    if (~listed["method"].isin(["vmf", "no_motion", "cramer_rao"])).any():
        compared = [
            paired_differences(part[~part["method"].isin(swept)], names, seed, resamples)
            for part, names in tables
        ]
        paired = pd.concat(compared, ignore_index=True)
    condition = _condition(outcomes)
    rejected = rejected_targets(errors)
    run.write_tables(
        errors,
        summary=summary,
        paired=paired,
        crossover=crossovers,
        rejected=rejected if len(rejected) else None,
        condition=None if condition is None else condition_table(*condition),
        points=point_errors([o.points for o in outcomes]),
    )
    plots: tuple[Path, ...] = ()
    if draw:
        # Matplotlib is slow to load, and many processes of a sweep never draw.
        from vmf.report import write_plots

        run.plots.mkdir(exist_ok=True)
        plots = write_plots(
            run.plots,
            listed,
            condition=condition,
            updates=_updates(spec, outcomes[0]),
            paired=paired,
            crossing=None if found is None else (found.curves, found.crossovers),
            pdf=pdf,
        )
    losses = losses + _diverged(listed)
    notes = notes + _notes(outcomes) + rejected_notes(listed)
    run.finish(
        "done",
        losses,
        usage and usage(),
        notes=list(notes),
        cases=_case_names(listed),
        swept=list(swept),
    )
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
    mine = (errors["method"] == "vmf") & (errors["component"] == "angle")
    n = int((mine & (errors["status"] == "diverged")).sum())
    return (Loss("vmf", f"of {mine.sum()} motions asked for did not converge", n),) if n else ()


def _notes(outcomes: list[Outcome]) -> tuple[str, ...]:
    said = [loss for o in outcomes for loss in o.losses]
    counted = {text: said.count(text) for text in dict.fromkeys(said)}
    return tuple(text if n == 1 else f"{text} (in {n} trials)" for text, n in counted.items())


def _case_names(errors: pd.DataFrame) -> dict[str, str]:
    """Return the case of each held-out trial number, which `errors.parquet` has no column for."""
    held_out = np.flatnonzero(errors["protocol"] == "held_out")
    trials, first = np.unique(errors["trial"].to_numpy()[held_out], return_index=True)
    return dict(zip(map(str, trials), errors["case"].iloc[held_out[first]].tolist(), strict=True))


def read_summary(path: Path) -> pd.DataFrame:
    """Return the content of a run's `summary.csv`.

    Raises
    ------
    InputError : there is none, or it has other columns.
    """
    file = path / "summary.csv"
    try:
        with open_regular(file) as stream:
            table = pd.read_csv(stream)
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
        with open_regular(path / "run.json") as stream:
            record = json.loads(stream.read())
    except OSError as error:
        raise InputError(
            f"{path}: no run.json here ({error.strerror}), the directory of a run is expected"
        ) from error
    except ValueError as error:
        raise InputError(f"{path / 'run.json'}: not JSON ({error})") from error
    if not isinstance(record, dict):
        raise InputError(f"{path / 'run.json'}: not the record of a run")
    return record
