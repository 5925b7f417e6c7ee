"""The runs that a page is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from vmf.errors import InputError

# What the page needs of each table, and what of that are no numbers.
_COLUMNS = {"condition": ("frame", "n", "median"), "points": ("component", "n", "mean", "std")}
_TEXT = ("component",)
# Counted, hence never left open.
_COUNTS = ("frame", "n")
_ANSWERS = ("trial", "frame", "truth", "estimate", "abs_error", "status")
_ASKED = ("protocol", "method", "component")
_IS_TEXT = (*_ASKED, "status")
T = TypeVar("T")


@dataclass(frozen=True)
class Cut:
    """The part of a run that is looked at: frames up to one, and trials from one to before another."""

    frames: int
    trials: range


@dataclass(frozen=True)
class Run:
    """A finished run.

    Attributes
    ----------
    name : of the experiment: the spec's name, or that of its file.
    path : its directory.
    record : content of its `run.json`.
    settings : its spec, flat: value by dotted key, elements of lists by number.
    summary : content of `summary.csv`, None for a study.
    quantities : content of a study's `quantities.csv`, None otherwise.
    plots : its figures (PNG).
    overrides : what makes it from the config of the same name.
    cut : the part of its answers and condition numbers that is looked at, None for all.
    """

    name: str
    path: Path
    record: Mapping[str, Any]
    settings: Mapping[str, Any]
    summary: pd.DataFrame | None
    quantities: pd.DataFrame | None
    plots: tuple[Path, ...]
    overrides: tuple[str, ...] = ()
    cut: Cut | None = None

    @property
    def command(self) -> str:
        """What made it: `train`, `compare-3d`, `evaluate` or `study`."""
        return str(self.record.get("command", ""))

    @property
    def trials(self) -> int | None:
        """How many simulated trials its numbers are over, None where there are none."""
        if self.settings.get("data.simulate.frames") is None:
            return None
        found = self.settings.get("evaluate.trials")
        return found if isinstance(found, int) else None

    @property
    def frames(self) -> int | None:
        """How many simulated frames each trial has, None where there are none."""
        found = self.settings.get("data.simulate.frames")
        return found if isinstance(found, int) else None

    def answers(self, protocol: str, method: str, component: str) -> pd.DataFrame:
        """Return the answers of a method: trial, frame, truth, estimate, abs_error and status."""
        rows = _answers(self.path / "errors.parquet", protocol, method, component)
        if self.cut is None:
            return rows
        trials = (rows["trial"] >= self.cut.trials.start) & (rows["trial"] < self.cut.trials.stop)
        return rows[trials & (rows["frame"] <= self.cut.frames)]

    def check(self) -> None:
        """Raise `InputError` if one of its tables that are read only where they are needed is damaged."""
        self.condition()
        self.points()
        path = self.path / "errors.parquet"
        if path.exists():
            _readable(path, lambda: _read_through(path))

    def condition(self) -> pd.DataFrame | None:
        """Return the condition number of a tile by frame over all trials, None where none was recorded."""
        table = self._table("condition")
        return table if table is None or self.cut is None else table[table["frame"] <= self.cut.frames]

    def points(self) -> pd.DataFrame | None:
        """Return how far reconstructed points are off, None where none were."""
        return self._table("points")

    def _table(self, name: str) -> pd.DataFrame | None:
        path = self.path / f"{name}.csv"
        if not path.exists():
            return None
        table = _readable(path, lambda: pd.read_csv(path))
        if lacking := [column for column in _COLUMNS[name] if column not in table.columns]:
            raise InputError(f"{path}: no column {lacking[0]}, that of a finished run is expected")
        numbers_in(path, table, [column for column in _COLUMNS[name] if column not in _TEXT])
        for column in _COUNTS:
            if column in _COLUMNS[name] and table[column].isna().any():
                raise InputError(f"{path}: damaged, column {column} has a gap, a number is expected")
        return table

    def plot(self, stem: str) -> Path | None:
        """Return the figure of that name, if it was drawn."""
        return next((path for path in self.plots if path.stem == stem), None)


def numbers_in(path: Path, table: pd.DataFrame, columns: Iterable[str]) -> None:
    """Raise `InputError` if a column of a table that was read from a file has something else than numbers."""
    for column in columns:
        strange = table[column][pd.to_numeric(table[column], errors="coerce").isna()].dropna()
        if len(strange):
            raise InputError(
                f"{path}: damaged, column {column} has {strange.iloc[0]!r}, a number is expected"
            )


@lru_cache(maxsize=16)
def _answers(path: Path, protocol: str, method: str, component: str) -> pd.DataFrame:
    columns = list(_ANSWERS)
    if not path.exists():
        return pd.DataFrame(columns=columns)
    wanted = [
        (column, "==", value) for column, value in zip(_ASKED, (protocol, method, component), strict=True)
    ]
    return _readable(path, lambda: pd.read_parquet(path, columns=columns, filters=wanted))


def _read_through(path: Path) -> None:
    """Read all answers, some at a time, as damage may be anywhere in the file."""
    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        for column in (*_ANSWERS, *_ASKED):
            kind = schema.field(column).type
            if (pa.types.is_integer(kind) or pa.types.is_floating(kind)) == (column in _IS_TEXT):
                raise TypeError(f"column {column} is of {kind}")
        for _ in file.iter_batches(columns=[*_ANSWERS, *_ASKED]):
            pass


def _readable(path: Path, read: Callable[[], T]) -> T:
    try:
        return read()
    except (OSError, ValueError, KeyError, TypeError) as error:
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{path}: damaged, the table of a finished run is expected ({line})") from error


@dataclass(frozen=True)
class Runs:
    """Finished runs, in the order in which they were named, and how many points the grid of a sweep has."""

    all: tuple[Run, ...]
    points: Mapping[str, int] = field(default_factory=dict)

    def named(self, config: str) -> tuple[Run, ...]:
        """Return the runs of a config."""
        return tuple(run for run in self.all if run.name == config)

    def newest(self, config: str) -> Run | None:
        """Return the newest run of a config, of those with its own effort if there are any."""
        return max(self.named(config), key=_rank, default=None)


def _rank(run: Run) -> tuple[bool, str]:
    return not run.overrides, str(run.record.get("finished", ""))


def flat(value: Any, prefix: str = "") -> dict[str, Any]:
    """Return a nested spec by dotted keys; elements of lists by their number."""
    if isinstance(value, Mapping):
        items = [(str(key), inner) for key, inner in value.items()]
    elif isinstance(value, list | tuple):
        items = [(str(number), inner) for number, inner in enumerate(value)]
    else:
        return {prefix: value}
    found: dict[str, Any] = {}
    for key, inner in items:
        found |= flat(inner, f"{prefix}.{key}" if prefix else key)
    return found
