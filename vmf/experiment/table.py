"""`vmf table`: runs side by side, with only what differs in their specs as columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from vmf.errors import InputError, Loss
from vmf.experiment.errors_table import OVERALL
from vmf.experiment.program import counting_packages, program_of
from vmf.experiment.run import read_record, read_summary
from vmf.experiment.study import COMMAND, QUANTITIES_FILE, read_quantities


@dataclass(frozen=True)
class SideBySide:
    """Runs side by side.

    Attributes
    ----------
    rows : one per run, protocol, case and method: settings that differ, then means, medians and counts;
        of studies, one per run and quantity.
    notes : what makes the runs hard to compare.
    losses : directories whose unfinished runs were left out.
    """

    rows: pd.DataFrame
    notes: tuple[str, ...]
    losses: tuple[Loss, ...]


@dataclass(frozen=True)
class _Run:
    path: Path
    settings: dict[str, Any]
    program: str
    packages: tuple[str, ...]
    swept: tuple[str, ...]
    is_study: bool


def side_by_side(paths: Sequence[Path]) -> SideBySide:
    """Return runs side by side.

    Parameters
    ----------
    paths : run directories, or directories of run directories such as a sweep's, whose finished runs count,
        sorted by their settings.

    Raises
    ------
    InputError : a path is no finished run, and holds none; or some are studies and some are not.
    """
    runs: list[_Run] = []
    losses: list[Loss] = []
    for path in {path.resolve(): path for path in paths}.values():
        if (path / "run.json").exists() or not _inside(path):
            runs.append(_finished(path))
        else:
            found, unfinished = _finished_inside(path)
            runs += found
            losses += [Loss(str(path), "runs that are not finished, left out", unfinished)] * bool(unfinished)
    differing = _differing([run.settings for run in runs])
    runs = _told_apart(runs)
    programs = dict.fromkeys(run.program for run in runs)
    studies = [str(run.path) for run in runs if run.is_study]
    if studies and len(studies) < len(runs):
        raise InputError(f"{studies[0]}: found a study beside experiments, runs of one sort are accepted")
    table = _quantities(runs) if studies else _rows([_summary(run) for run in runs])
    of_run = [runs[number] for number in table.pop("run")]
    head = {key: [run.settings.get(key) for run in of_run] for key in differing}
    if len(programs) > 1:
        head["program"] = [run.program for run in of_run]
    for place, (key, values) in enumerate(head.items()):
        # As objects, whole numbers stay whole beside what is no number.
        table.insert(place, key, pd.Series(values, dtype=object))
    notes = []
    if len(programs) > 1:
        notes.append(f"made by different programs, see the column program: {', '.join(programs)}")
    return SideBySide(table, tuple(notes), tuple(losses))


def _quantities(runs: Sequence[_Run]) -> pd.DataFrame:
    """Return one row per run (by number) and quantity of studies, without columns that are all empty."""
    every = pd.concat({n: read_quantities(run.path) for n, run in enumerate(runs)}, names=["run"])
    every = every.reset_index("run").reset_index(drop=True)
    every["n"] = every["n"].astype(object).where(every["n"].notna(), None)
    return every.drop(columns=[c for c in ("n", "ci_low", "ci_high") if every[c].isna().all()])


def _summary(run: _Run) -> pd.DataFrame:
    """Return a run's summary without what its calibration sweep alone asked, too much for a table."""
    table = read_summary(run.path)
    return table[~table["method"].isin(run.swept)]


def _inside(path: Path) -> list[Path]:
    """Return the runs in a directory; links such as `latest` lead to runs that are there anyway."""
    return sorted(record.parent for record in path.glob("*/run.json") if not record.parent.is_symlink())


def _finished(path: Path) -> _Run:
    record = read_record(path)
    is_study = record.get("command") == COMMAND
    results = path / (QUANTITIES_FILE if is_study else "summary.csv")
    if record.get("status") != "done" or not results.exists():
        raise InputError(f"{path}: status {record.get('status')}, a finished run is expected")
    swept = tuple(record.get("swept") or ())
    settings = _flat(record.get("spec") or {})
    return _Run(path, settings, program_of(record), counting_packages(record), swept, is_study)


def _told_apart(runs: list[_Run]) -> list[_Run]:
    """Name the packages that results depend on beside the program, where these differ."""
    differ = [len(set(versions)) > 1 for versions in zip(*(run.packages for run in runs), strict=True)]

    def named(run: _Run) -> str:
        return ", ".join(
            [run.program, *(p for p, differs in zip(run.packages, differ, strict=True) if differs)]
        )

    return [replace(run, program=named(run)) for run in runs]


def _finished_inside(path: Path) -> tuple[list[_Run], int]:
    runs, unfinished = [], 0
    for inside in _inside(path):
        try:
            runs.append(_finished(inside))
        except InputError:
            unfinished += 1
    if not runs:
        raise InputError(f"{path}: none of {unfinished} runs is finished, a finished run is expected")
    differing = _differing([run.settings for run in runs])
    return sorted(runs, key=lambda run: [_rank(run.settings.get(key)) for key in differing]), unfinished


def _rank(value: Any) -> tuple[bool, float, str]:
    """Return what sorts numbers by size, before everything else."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return (not number, float(value) if number else 0.0, str(value))


def _differing(settings: Sequence[dict[str, Any]]) -> list[str]:
    """Return the keys in which specs differ, the name apart.

    A key that only some specs have, always with the same value, says nothing: its section's kind does, or
    an older program did not know it. Unless a whole section is there in some and null in others.
    """
    keys = dict.fromkeys(key for setting in settings for key in setting if key != "name")
    sections = {key[:i] for key in keys for i, character in enumerate(key) if character == "."}
    null = sections & keys.keys()
    found = []
    for key in keys:
        values = {repr(setting[key]) for setting in settings if key in setting}
        everywhere = all(key in setting for setting in settings)
        optional = key in null or any(key.startswith(f"{section}.") for section in null)
        if len(values) > 1 or (optional and not everywhere):
            found.append(key)
    return found


def _rows(summaries: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Return one row per run (by number), protocol, case and method of summaries."""
    keys = ["run", "protocol", "case", "method"]
    every = pd.concat(dict(enumerate(summaries)), names=["run"]).reset_index("run")
    rows = every.drop_duplicates(keys).reset_index(drop=True)
    table = rows[keys]
    for name, unit in OVERALL:
        mine = table.merge(every[every["component"] == name], "left", keys)
        table = table.assign(**{f"{name} {m} ({unit})": mine[m] for m in ("mean", "median")})
    return table.join(rows[["n", "n_refused", "n_diverged"]])


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        flat: dict[str, Any] = {}
        for key, inner in value.items():
            flat.update(_flat(inner, f"{prefix}.{key}" if prefix else str(key)))
        return flat
    if isinstance(value, list) and value and all(isinstance(inner, dict) for inner in value):
        # Functions have names, other parts of lists their places.
        named = {str(inner.get("name") or i): inner for i, inner in enumerate(value)}
        return _flat(named, prefix) if len(named) == len(value) else {prefix: value}
    return {prefix: value}
