"""One point of a sweep: its directory, what of it is on disk, and how it is closed."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from vmf.errors import InputError
from vmf.experiment import outcome_file
from vmf.experiment.parallel import Failure
from vmf.experiment.program import program_of
from vmf.experiment.run import remarks, write_results
from vmf.experiment.run_directory import RunDirectory, holds_something, stored_record
from vmf.experiment.trial import Outcome
from vmf.experiment.usage import Stopwatch, Usage
from vmf.experiment.work import TrialResult, TrialWork
from vmf.spec import Spec

# Without these a point is not done, whatever its record says: a loss of power can leave empty files.
_RESULTS = ("errors.parquet", "summary.csv", "model.npz", "spec.yaml")


@dataclass(frozen=True)
class Point:
    """One point of a sweep.

    Attributes
    ----------
    path : its directory.
    spec : the experiment; a recording's path is absolute.
    overrides : what the sweep says of the spec.
    settings : those of them in which the points differ, by key.
    command : `train` or `compare-3d`.
    """

    path: Path
    spec: Spec
    overrides: tuple[str, ...]
    settings: Mapping[str, str]
    command: str

    def closed(self, inputs: Mapping[str, str]) -> Closed | None:
        """Return what an earlier call made of the same spec, command and inputs, None if it did not end."""
        record = stored_record(self.path)
        same = record.get("command") == self.command and record.get("inputs") == dict(inputs)
        if not same or record.get("status") != "done":
            return None
        if not all(holds_something(self.path / name) for name in _RESULTS):
            return None
        return Closed(tuple(record.get("losses", ())), program_of(record))

    def remove_trials(self) -> None:
        """Remove what only an open point needs, which a call that was killed may have left."""
        RunDirectory(self.path, {}).remove_trials()

    def __str__(self) -> str:
        said = " ".join(f"{key}={value}" for key, value in self.settings.items())
        return f"{self.path} ({said})" if said else str(self.path)


@dataclass(frozen=True)
class Closed:
    """A point that is done: what was lost on the way, and which program made it."""

    losses: tuple[str, ...]
    program: str


@dataclass(frozen=True)
class ClosingWork:
    """Tables and plots of a point whose trials are all on disk.

    Attributes
    ----------
    point : whose.
    plots, pdf : whether figures are drawn, and as PDF beside PNG.
    usage : what the trials took.
    """

    point: Point
    plots: bool
    pdf: bool
    usage: Usage

    def __call__(self) -> Closed:
        """Do the work.

        Raises
        ------
        InputError : no trial found anything to ask, or one on disk is damaged.
        """
        watch = Stopwatch(thread_only=True)
        point, spec = self.point, self.point.spec
        run = RunDirectory(point.path, stored_record(point.path), durable=False)
        outcomes = [_stored(run.trial(n)) for n in range(spec.evaluate.trials)]
        losses = tuple(loss for outcome in outcomes for loss in outcome.data_losses)
        result = write_results(
            run,
            spec,
            outcomes,
            losses,
            remarks(spec, point.command),
            draw=self.plots,
            pdf=self.pdf,
            usage=lambda: self.usage + watch.read(),
        )
        return Closed(tuple(map(str, result.losses)), program_of(run.record))


class OpenPoint:
    """A point under work.

    Attributes
    ----------
    point : which.
    failure : why it cannot be done, None as long as it can.
    missing : numbers of the trials that are not on disk.
    """

    def __init__(self, point: Point, inputs: Mapping[str, str]) -> None:
        self.point = point
        self._directory: RunDirectory | None = None
        self.failure: Failure | None = None
        self.missing: list[int] = []
        self._inputs, self._usage, self._watch = inputs, Usage(), Stopwatch()

    def make_ready(self) -> None:
        """Make its directory, or take that of an earlier call with the trials that serve.

        Raises
        ------
        OSError, InputError : the directory is of no use.
        """
        point, inputs = self.point, self._inputs
        run = RunDirectory.reopened(point.path, point.command, inputs, durable=False)
        if run is None:
            _clear(point.path)
            run = RunDirectory.begin(
                point.path, point.spec, point.command, point.overrides, inputs, durable=False
            )
        else:
            _tidy(point.path)
        self._directory = run
        self.missing = run.missing_trials(point.spec.evaluate.trials)

    def trial(self, number: int) -> TrialWork:
        """Return a trial as a piece of work."""
        point, sha256 = self.point, next(iter(self._inputs.values()), None)
        return TrialWork(point.spec, number, point.command == "compare-3d", sha256, point.path)

    def keep(self, number: int, result: TrialResult) -> None:
        """Leave a trial on disk.

        Raises
        ------
        OSError : there is no room for it.
        """
        assert self._directory is not None
        self._directory.keep_trial(number, result.table, result.model)
        self.missing.remove(number)
        self._usage += result.usage

    def closing(self, plots: bool, pdf: bool) -> ClosingWork:
        """Return the work that remains when no trial is missing."""
        return ClosingWork(self.point, plots, pdf, self._used())

    def fail(self, failure: Failure) -> None:
        """Note why it cannot be done; its trials stay on disk for the next call."""
        self.failure = failure
        if self._directory is not None:
            # What a full disk does not take is said at once all the same.
            with suppress(OSError):
                self._directory.fail(failure, self._used())

    def interrupt(self) -> None:
        """Note that the sweep ends before this point, at whatever moment that is."""
        # What is on disk counts: its directory may be half made, or a worker may have closed it just now.
        record = stored_record(self.point.path)
        if record.get("status") == "running":
            RunDirectory(self.point.path, record, durable=False).finish("interrupted", (), self._used())

    def _used(self) -> Usage:
        return Usage(self._watch.read().wall_s, self._usage.cpu_s, self._usage.peak_memory_mib)


def _stored(trial: Path) -> Outcome:
    """Return a trial's outcome from its file; one that cannot be read is removed, to be made again."""
    try:
        return outcome_file.load(trial)
    except (OSError, ValueError, TypeError, KeyError) as error:
        trial.unlink(missing_ok=True)
        raise InputError(f"{trial}: damaged and removed, the same command makes it again") from error


def _clear(path: Path) -> None:
    """Remove an older run of the same point; the record first, so that half of the rest is nobody's."""
    if not path.exists():
        return
    (path / "run.json").unlink(missing_ok=True)
    for name in ("trials", "plots"):
        shutil.rmtree(path / name, ignore_errors=True)
    for file in (*(path / name for name in _RESULTS), *path.glob("*.csv")):
        file.unlink(missing_ok=True)
    _tidy(path)


def _tidy(path: Path) -> None:
    """Remove what a killed process had half written."""
    for directory in (path, path / "trials", path / "plots"):
        for half in directory.glob(".*.*"):
            half.unlink(missing_ok=True)
