"""A sweep's points when its spec is a study: each is one piece of work."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from vmf.experiment.parallel import Crew, Failure, run_all
from vmf.experiment.point import Closed
from vmf.experiment.program import program_of
from vmf.experiment.run_directory import RunDirectory, holds_something, stored_record
from vmf.experiment.study import COMMAND, QUANTITIES_FILE, StudyFiles, StudyWork
from vmf.spec import StudySpec

StudyWorkers = Crew[StudyWork, StudyFiles]


@dataclass(frozen=True)
class StudyPoint:
    """One point of a sweep over a study.

    Attributes
    ----------
    path : its directory.
    spec : the study.
    overrides : what the sweep says of the spec.
    settings : those of them in which the points differ, by key.
    """

    path: Path
    spec: StudySpec
    overrides: tuple[str, ...]
    settings: Mapping[str, str]

    def closed(self) -> Closed | None:
        """Return what an earlier call made of the same study, None if it did not end or files are missing."""
        record = stored_record(self.path)
        if record.get("command") != COMMAND or record.get("status") != "done":
            return None
        files = [QUANTITIES_FILE, "spec.yaml", *record.get("files", ())]
        if not all(holds_something(self.path / name) for name in files):
            return None
        return Closed(tuple(record.get("losses", ())), program_of(record))

    def begin(self) -> RunDirectory:
        """Make its directory anew, without what an earlier call left there."""
        # The record goes first, so that half of the rest is nobody's.
        with suppress(FileNotFoundError):
            (self.path / "run.json").unlink()
        shutil.rmtree(self.path, ignore_errors=True)
        return RunDirectory.begin(self.path, self.spec, COMMAND, self.overrides, {}, durable=False)

    def __str__(self) -> str:
        said = " ".join(f"{key}={value}" for key, value in self.settings.items())
        return f"{self.path} ({said})" if said else str(self.path)


def carry_out_points(
    points: list[StudyPoint], workers: StudyWorkers, pdf: bool = True
) -> Iterator[tuple[StudyPoint, Closed | Failure]]:
    """Yield each point with its end as they are done; what is interrupted says so in its record."""
    runs: dict[Path, RunDirectory] = {}
    by_path = {point.path: point for point in points}

    def works() -> Iterator[StudyWork]:
        for point in points:
            runs[point.path] = point.begin()
            yield StudyWork(point.spec, point.path, pdf)

    try:
        for work, result in run_all(workers, works()):
            run = runs.pop(work.directory)
            if isinstance(result, Failure):
                run.fail(result)
                yield by_path[work.directory], result
            else:
                result.write(run)
                yield by_path[work.directory], Closed(tuple(map(str, result.losses)), program_of(run.record))
    except BaseException:
        for run in runs.values():
            run.finish("interrupted")
        raise
