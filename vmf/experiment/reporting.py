"""`vmf report`: finished runs to one page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vmf.errors import InputError, Loss
from vmf.experiment.atomic import write_text
from vmf.experiment.program import program, program_of
from vmf.experiment.run import read_record, read_summary
from vmf.experiment.statistics import SUMMARY
from vmf.experiment.study import QUANTITIES_FILE, read_quantities
from vmf.experiment.table import side_by_side
from vmf.report.page import (
    Page,
    Run,
    Runs,
    Table,
    configs,
    counted,
    decoded,
    flat,
    frame_table,
    numbers_in,
    render,
    run_sections,
    thesis,
    thesis_part,
)
from vmf.report.page.numbers import listed

# Programs that are named where runs are of several.
_MOST_PROGRAMS = 4
_NO_RUN = "no finished run, a run directory or a directory of runs is expected"
_ERRORS_FILE = "errors.parquet"
_ENDINGS = ("-compare-3d-sweep", "-sweep")


@dataclass(frozen=True)
class ReportResult:
    """What became of a report.

    Attributes
    ----------
    path : the page.
    size : of it, in bytes.
    runs : how many finished runs are on it.
    notes : what a reader should know about them.
    losses : what was left out: runs that are not finished or damaged, and what is missing or
        damaged of others.
    """

    path: Path
    size: int
    runs: int
    notes: tuple[str, ...]
    losses: tuple[Loss, ...]


def report(paths: Sequence[Path], output: Path, about_thesis: bool | None = None) -> ReportResult:
    """Write one self-contained HTML page of finished runs.

    Parameters
    ----------
    paths : run directories, or directories of run directories such as a sweep's.
    output : the page.
    about_thesis : whether the thesis's numbers are put beside ours; by default if a run is of one of its
        experiments.

    Raises
    ------
    InputError : a path is no finished run and holds none, a config of the thesis cannot be read, or the page
        cannot be written.
    """
    found: list[Run] = []
    losses: list[Loss] = []
    for path in paths:
        finished, lost = finished_runs(path)
        found += [run for run in finished if all(run.path != other.path for other in found)]
        losses += lost
    if not found and losses:
        why = "" if losses[0].what == _NO_RUN else f" ({losses[0].what})"
        raise InputError(f"{losses[0].place}: {_NO_RUN}{why}")
    runs = Runs(tuple(found))
    said: tuple[str, ...] = ()
    others = runs.all
    if about_thesis is not False:
        known = counted(found, thesis(), configs())
        about_thesis = bool(about_thesis or known.runs)
        said = known.notes
    if about_thesis:
        runs, others = Runs(known.runs, known.points), known.others
        losses += _without_figures(runs)
    notes = (*_notes(found, runs if about_thesis else None), *said)
    page = Page(
        "The thesis beside ours" if about_thesis else "Report of " + _names(found),
        str(program()),
        thesis_part(runs) if about_thesis else None,
        None if about_thesis else _overview(others),
        run_sections(others),
        notes,
    )
    text = render(page)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        write_text(output, text)
    except OSError as error:
        raise InputError(f"-o: {output}: {error.strerror}") from error
    return ReportResult(output, len(text.encode()), len(found), notes, tuple(dict.fromkeys(losses)))


def finished_runs(path: Path) -> tuple[list[Run], list[Loss]]:
    """Return the finished runs at or in a directory, and what is missing: whole runs, or a file of one."""
    runs: list[Run] = []
    losses: list[Loss] = []
    unfinished = 0
    for directory in _directories(path):
        try:
            record = read_record(directory)
            if record.get("status") != "done":
                unfinished += 1
                continue
            run, damaged = _run(directory, record)
        except InputError as error:
            losses.append(Loss(str(directory), f"damaged, the run is left out: {error}", 1))
            continue
        runs.append(run)
        losses += damaged
        if runs[-1].quantities is None and not (directory / _ERRORS_FILE).exists():
            losses.append(Loss(str(directory), f"no {_ERRORS_FILE}, what needs every answer is left out", 1))
    if unfinished:
        losses.append(Loss(str(path), "runs that are not finished, left out", unfinished))
    if not runs and not losses:
        losses.append(Loss(str(path), _NO_RUN, 1))
    return runs, losses


def _run(directory: Path, record: dict[str, Any]) -> tuple[Run, list[Loss]]:
    """Return a run and what is lost of its figures; raises `InputError` if one of its tables is damaged."""
    is_study = (directory / QUANTITIES_FILE).exists()
    summary = None if is_study else read_summary(directory)
    quantities = read_quantities(directory) if is_study else None
    if summary is not None:
        numbers_in(directory / "summary.csv", summary, SUMMARY[SUMMARY.index("n") :])
    if quantities is not None:
        numbers_in(directory / QUANTITIES_FILE, quantities, ("value", "ci_low", "ci_high"))
    plots, losses = _figures(directory)
    run = Run(
        name_of(directory, record),
        directory,
        record,
        flat(record.get("spec", {})),
        summary,
        quantities,
        plots,
    )
    run.check()
    return run, losses


def _figures(directory: Path) -> tuple[tuple[Path, ...], list[Loss]]:
    """Return the figures of a run, and those that are damaged."""
    plots: list[Path] = []
    losses: list[Loss] = []
    for path in sorted((directory / "plots").glob("*.png")):
        try:
            decoded(path)
        except InputError as error:
            losses.append(Loss(str(directory), f"the figure is left out: {error}", 1))
        else:
            plots.append(path)
    return tuple(plots), losses


def _without_figures(runs: Runs) -> list[Loss]:
    """Return a loss for every run of a figure of the thesis of which no figures are there."""
    shown = (runs.newest(config) for config in dict.fromkeys(figure.config for figure in thesis().figures))
    return [
        Loss(str(run.path), "no plots, the figures are left out", 1)
        for run in shown
        if run is not None and not (run.path / "plots").is_dir()
    ]


def _directories(path: Path) -> Iterator[Path]:
    if (path / "run.json").exists():
        yield path.resolve()
        return
    if not path.is_dir():
        raise InputError(f"{path}: no such directory, a run directory or a directory of runs is expected")
    for record in sorted(path.glob("*/run.json")):
        if not record.parent.is_symlink():
            yield record.parent.resolve()


def name_of(path: Path, record: dict[str, object]) -> str:
    """Return the name of a run's experiment: its spec's, or that of the directory it was put in."""
    spec = record.get("spec")
    if isinstance(spec, dict) and spec.get("name"):
        return str(spec["name"])
    name = path.parent.name
    if name == "evaluations":
        return f"{path.parents[2].name}, evaluated"
    return next((name.removesuffix(end) for end in _ENDINGS if name.endswith(end)), name)


def _overview(runs: Sequence[Run]) -> Table | None:
    trained = [run.path for run in runs if run.summary is not None]
    if len(trained) < 2:
        return None
    rows = side_by_side(trained).rows
    return frame_table("Runs side by side, with the settings in which they differ", rows)


def _names(runs: Sequence[Run]) -> str:
    names = list(dict.fromkeys(run.name for run in runs))
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _notes(found: Sequence[Run], of_thesis: Runs | None) -> tuple[str, ...]:
    programs = list(dict.fromkeys(program_of(run.record) for run in found))
    more = [f"{len(programs) - _MOST_PROGRAMS} more"] if len(programs) > _MOST_PROGRAMS else []
    shown = listed([*programs[:_MOST_PROGRAMS], *more])
    notes = [f"the runs were made by different programs: {shown}"] if len(programs) > 1 else []
    if of_thesis is not None:
        missing = [f.config for f in thesis().figures if of_thesis.newest(f.config) is None]
        if missing:
            notes.append(f"not run: {', '.join(dict.fromkeys(missing))}")
    return tuple(notes)
