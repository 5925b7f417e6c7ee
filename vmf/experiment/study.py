"""`vmf study`: a study from its spec to its run directory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from vmf.errors import InputError, Loss
from vmf.experiment.atomic import write_bytes
from vmf.experiment.parallel import one_blas_thread
from vmf.experiment.run_directory import RunDirectory
from vmf.experiment.usage import Stopwatch, Usage
from vmf.spec import LoadedStudy, StudySpec

COMMAND = "study"
QUANTITIES_FILE = "quantities.csv"
# More rows than this are for files.
_MOST_ROWS = 60


@dataclass(frozen=True)
class StudyFiles:
    """What a study leaves behind: files' contents, so that worker and caller need no disk in common.

    Attributes
    ----------
    contents : by path below the run directory.
    notes : what a reader has to know beside them.
    usage : what it took.
    losses : what was to be found and could not be.
    """

    contents: Mapping[str, bytes]
    notes: tuple[str, ...]
    usage: Usage
    losses: tuple[Loss, ...]

    def write(self, run: RunDirectory) -> None:
        """Write every file, and close the run."""
        run.plots.mkdir(exist_ok=True)
        for name, content in self.contents.items():
            write_bytes(run.path / name, content, run.durable)
        run.finish("done", self.losses, self.usage, notes=list(self.notes), files=sorted(self.contents))


@dataclass(frozen=True)
class StudyWork:
    """A study as a piece of work that any process, on any machine, can do.

    Attributes
    ----------
    spec : what to study.
    directory : where the caller wants the files to go; the worker has no use for it.
    pdf : whether figures, which studies draw always, are wanted as PDF beside PNG.
    """

    spec: StudySpec
    directory: Path
    pdf: bool = True

    def __call__(self) -> StudyFiles:
        """Do the work.

        Raises
        ------
        InputError : the settings leave nothing to study.
        """
        # Studies draw their figures always, so what is slow to load is needed.
        from vmf.report.plots import rendered
        from vmf.study import carry_out

        one_blas_thread()
        watch = Stopwatch(thread_only=True)
        result = carry_out(self.spec.study)
        contents = {QUANTITIES_FILE: _csv(result.table())}
        contents |= {f"{name}.csv": _csv(table) for name, table in result.tables.items()}
        for name, draw in result.drawings.items():
            kinds = rendered(draw(), self.pdf)
            contents |= {f"plots/{name}.{kind}": content for kind, content in kinds.items()}
        return StudyFiles(contents, result.notes, watch.read(), result.losses)


@dataclass(frozen=True)
class StudyRun:
    """What the command prints.

    Attributes
    ----------
    run_dir : the run directory.
    quantities : content of `quantities.csv`.
    plots : the figures written.
    notes : what a reader has to know beside them.
    losses : what was to be found and could not be; any loss means exit code 3.
    """

    run_dir: Path
    quantities: pd.DataFrame
    plots: tuple[Path, ...]
    notes: tuple[str, ...]
    losses: tuple[Loss, ...]


def run_study(loaded: LoadedStudy, out: Path) -> StudyRun:
    """Carry out a study, and write and draw what it found.

    Raises
    ------
    InputError : the settings leave nothing to study, or the directory cannot be made.
    """
    parent = out / (loaded.spec.name or loaded.path.stem)
    run = RunDirectory.create(parent, loaded.spec, COMMAND, loaded.overrides, {})
    try:
        files = StudyWork(loaded.spec, run.path)()
        files.write(run)
    except KeyboardInterrupt:
        run.finish("interrupted")
        raise
    except BaseException as error:
        run.finish("failed", error=str(error))
        raise
    plots = tuple(run.path / name for name in sorted(files.contents) if name.endswith(".png"))
    return StudyRun(run.path, read_quantities(run.path), plots, files.notes, files.losses)


def read_quantities(path: Path) -> pd.DataFrame:
    """Return the content of a study's `quantities.csv`.

    Raises
    ------
    InputError : there is none, or it has other columns.
    """
    from vmf.study import QUANTITIES

    file = path / QUANTITIES_FILE
    names = ("quantity", "case", "component", "unit")
    dtypes = {**dict.fromkeys(names, "object"), "n": "Int64"}
    try:
        table = pd.read_csv(file, dtype=dtypes, keep_default_na=False, na_values=[""])
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: not readable quantities ({error})") from error
    if tuple(table.columns) != QUANTITIES:
        raise InputError(f"{file}: found columns {', '.join(table.columns)}, not those of quantities")
    return table.fillna(dict.fromkeys(names, ""))


def worth_printing(quantities: pd.DataFrame) -> pd.DataFrame:
    """Return all quantities if they are few, else those that are not one of several components."""
    return quantities if len(quantities) <= _MOST_ROWS else quantities[quantities["component"] == ""]


def _csv(table: pd.DataFrame) -> bytes:
    return table.to_csv(index=False).encode()
