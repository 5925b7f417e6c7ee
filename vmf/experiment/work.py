"""One trial as a piece of work that any process, on any machine, can do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from vmf.data.recording import RecordingData, read
from vmf.errors import InputError
from vmf.experiment import outcome_file
from vmf.experiment.check import check
from vmf.experiment.recorded import recorded_trial, repairs
from vmf.experiment.trial import Outcome, simulated_trial
from vmf.experiment.usage import Stopwatch, Usage
from vmf.spec import Recording, Spec


@dataclass(frozen=True)
class TrialResult:
    """What comes back: files' contents, so that worker and caller need no disk in common.

    Attributes
    ----------
    table : the outcome as `outcome_file` writes it.
    model : content of `model.npz`, from the first trial alone.
    usage : what the trial took.
    """

    table: bytes
    model: bytes | None
    usage: Usage


@dataclass(frozen=True)
class TrialWork:
    """A trial of a simulation, or everything that is learned from a recording.

    Attributes
    ----------
    spec : the experiment; a recording's path is absolute.
    number : of the trial.
    with_rivals : whether the 3-D methods answer the same questions.
    sha256 : of the recording, None for a simulation.
    directory : where the caller wants the result to go; the worker has no use for it.
    """

    spec: Spec
    number: int
    with_rivals: bool
    sha256: str | None = None
    directory: Path | None = None

    def __call__(self) -> TrialResult:
        """Do the work.

        Raises
        ------
        InputError : the spec cannot be carried out, or its recording cannot be read here.
        """
        watch = Stopwatch(thread_only=True)
        if self.sha256 is None:
            outcome = simulated_trial(self.spec, self.number, self.with_rivals, keep_model=self.number == 0)
        else:
            outcome = self._recorded(self.sha256)
        return TrialResult(outcome_file.to_bytes(outcome), outcome.model, watch.read())

    def _recorded(self, sha256: str) -> Outcome:
        source = self.spec.data.recording
        assert source is not None
        if not Path(source.path).is_file():
            raise InputError(
                f"data.recording.path: {source.path} is not there; "
                "a recording has to be at this path wherever its trial is run"
            )
        data = _read(source, self.spec.mounting, sha256)
        if data.sha256 != sha256:
            raise InputError(
                f"data.recording.path: {source.path} is not the file that it was, or elsewhere is"
            )
        check(self.spec, data)
        outcome = recorded_trial(self.spec, data, self.with_rivals)
        lost = data.losses + outcome.data_losses
        return replace(outcome, losses=repairs(data) + outcome.losses, data_losses=lost)


@lru_cache(maxsize=2)
def _read(source: Recording, mounting: str, sha256: str) -> RecordingData:
    """Read a recording, once for all the points that are about it; the checksum tells one that changed."""
    return read(source, mounting, Path.cwd())
