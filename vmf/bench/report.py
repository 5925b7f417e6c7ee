"""The figures of one run: as one JSON file, and as one table."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from enum import Enum
from io import StringIO
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vmf.bench.figure import Figure, Reading, Row
from vmf.bench.machine import Machine
from vmf.errors import InputError
from vmf.experiment.atomic import write_text

_WIDTH = 160
_SUFFIX = {Reading.FASTER: " ×", Reading.SHARE: "", Reading.GROWTH: ""}


@dataclass(frozen=True)
class Report:
    """What was measured in one run.

    Attributes
    ----------
    quick : whether sizes were miniatures, whose ratios say nothing.
    """

    machine: Machine
    quick: bool
    figures: tuple[Figure, ...]


def to_json(report: Report) -> str:
    """Return the report as JSON: `machine`, `quick` and `figures` with their `rows`."""
    return json.dumps(asdict(report), indent=2, allow_nan=False, default=_plain, ensure_ascii=False)


def _plain(value: object) -> Any:
    if isinstance(value, Enum):
        return value.name.lower()
    raise TypeError(f"{type(value).__name__} is not JSON")


def as_text(report: Report) -> str:
    """Return the report as a person reads it."""
    buffer = StringIO()
    console = Console(file=buffer, width=_WIDTH, color_system=None, markup=False, highlight=False)
    for line in _machine(report.machine):
        console.print(line)
    if report.quick:
        console.print("miniature sizes: these ratios say that everything runs, and no more")
    for figure in report.figures:
        console.print()
        console.print(_table(figure))
        for note in figure.notes:
            console.print(f"note: {note}")
    return buffer.getvalue().rstrip()


def write(report: Report, directory: Path) -> Path:
    """Write `bench.json` and `bench.txt` into a directory; return the first's path.

    Raises
    ------
    InputError : the directory cannot be made or written to.
    """
    path = directory / "bench.json"
    writable(directory)
    try:
        write_text(path, to_json(report) + "\n")
        write_text(directory / "bench.txt", as_text(report) + "\n")
    except OSError as error:
        raise InputError(f"--out {directory}: cannot be written: {error.strerror or error}") from None
    return path


def writable(directory: Path) -> None:
    """Make the directory, before minutes are spent on what is to be written there.

    Raises
    ------
    InputError : it cannot be made.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {directory}: cannot be written: {error.strerror or error}") from None


def _machine(machine: Machine) -> list[str]:
    blas = ", ".join(f"{b.name} {b.version} ({b.architecture}, {b.threads} threads)" for b in machine.blas)
    load = "" if machine.load_average is None else f", load {machine.load_average:.1f} at the start"
    versions = ", ".join(f"{name} {version}" for name, version in machine.packages)
    return [
        f"{machine.processor}, {machine.cores} cores, {machine.memory_gib:.0f} GiB, {machine.system}{load}",
        f"Python {machine.python}, vmf {machine.vmf}, {versions}",
        f"BLAS: {blas or 'unknown'}; measured with one thread",
    ]


def _table(figure: Figure) -> Table:
    table = Table(
        title=f"{figure.name} — {figure.title} ({figure.seconds:.0f} s)",
        title_justify="left",
        caption_justify="left",
        caption="~ not run at this size, extrapolated" if any(r.extrapolated for r in figure.rows) else None,
    )
    for heading in ("case", "ours", "against"):
        table.add_column(heading)
    for heading in ("ours", "against", "ratio", "quartiles"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("note")
    for row in figure.rows:
        table.add_row(*(Text(cell) for cell in _cells(row)))
    return table


def _cells(row: Row) -> tuple[str, ...]:
    about = "~" if row.extrapolated else ""
    spread = f"{_short(row.low)} – {_short(row.high)}" if row.repeats > 1 else ""
    return (
        row.case,
        row.ours,
        row.alternative,
        _quantity(row.ours_value, row.unit),
        about + _quantity(row.alternative_value, row.unit),
        f"{about}{_short(row.ratio)}{_SUFFIX[row.reading]}",
        spread,
        row.note,
    )


def _quantity(value: float, unit: str) -> str:
    for factor, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ")):
        if unit == "s" and (value >= factor or factor == 1e-6):
            return f"{_short(value / factor)} {prefix}s"
    if unit == "bytes":
        return f"{_short(value / 1e6)} MB" if value >= 1e6 else f"{_short(value)} bytes"
    return f"{_short(value)} {unit}".rstrip()


def _short(value: float) -> str:
    """Return three significant digits, in full where they are whole numbers."""
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 100.0 else f"{value:.3g}"
