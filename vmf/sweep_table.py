"""What a sweep prints, for people and for machines."""

from __future__ import annotations

import json
from io import StringIO

from rich.console import Console
from rich.table import Table
from rich.text import Text

from vmf.experiment.sweep import PointResult, SweepResult
from vmf.experiment.table import side_by_side
from vmf.table_formats import cell, records

# More rows than this are for `vmf table`.
_MOST_ROWS = 60
_WIDTH = 150


def to_json(result: SweepResult) -> str:
    """Return every point with its directory, settings and end, and the rows of `vmf table` for those done."""
    done = [p.point.path for p in result.points if p.failure is None]
    content = {
        "sweep_dir": str(result.directory),
        "points": [
            {
                "run_dir": str(p.point.path),
                "settings": dict(p.point.settings),
                "status": _status(p),
                "error": None if p.failure is None else str(p.failure),
                "losses": list(p.losses),
            }
            for p in result.points
        ],
        "rows": records(side_by_side(done).rows) if done else [],
        "notes": list(result.notes),
    }
    return json.dumps(content, indent=2, allow_nan=False)


def _status(point: PointResult) -> str:
    if point.failure is not None:
        return "failed"
    return "kept" if point.kept else "done"


def as_text(result: SweepResult) -> str:
    """Return the table that a person reads, how many points there are, and where."""
    buffer = StringIO()
    console = Console(file=buffer, width=_WIDTH, color_system=None, markup=False, highlight=False)
    done = [p.point.path for p in result.points if p.failure is None]
    if 0 < len(done) <= _MOST_ROWS:
        rows = side_by_side(done).rows
        title = None
        if "method" in rows:
            title = "|error| of vmf"
            rows = rows[rows["method"] == "vmf"]
            rows = rows.drop(columns=["method", "angle mean (rad)", "distance mean (m)"])
        if len(rows) <= _MOST_ROWS:
            table = Table(title=title, title_justify="left")
            for name in rows:
                table.add_column(str(name), justify="right")
            for row in rows.itertuples(index=False):
                table.add_row(*(Text(cell(value)) for value in row))
            console.print(table)
    counted = {word: sum(_status(p) == word for p in result.points) for word in ("done", "kept", "failed")}
    said = f"{counted['done']} done now, {counted['kept']} before, {counted['failed']} failed"
    console.print(f"points: {len(result.points)} ({said})")
    console.print(f"sweep directory: {result.directory} (`vmf table` takes it)", soft_wrap=True)
    return buffer.getvalue().rstrip()
