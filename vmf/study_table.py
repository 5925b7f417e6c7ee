"""What a study prints, for people and for machines."""

from __future__ import annotations

import json

from vmf.experiment.study import StudyRun, worth_printing
from vmf.table_formats import cell, records


def to_json(run: StudyRun) -> str:
    """Return run directory, quantities, plots, losses and notes as JSON, with all digits."""
    quantities = run.quantities.astype({"n": object})
    quantities["n"] = quantities["n"].where(quantities["n"].notna(), None)
    content = {
        "run_dir": str(run.run_dir),
        "quantities": records(quantities),
        "plots": [str(path) for path in run.plots],
        "losses": [str(loss) for loss in run.losses],
        "notes": list(run.notes),
    }
    return json.dumps(content, indent=2, allow_nan=False)


def as_text(run: StudyRun) -> str:
    """Return one line per quantity, in columns, and where the rest is; components where they are few."""
    shown = worth_printing(run.quantities)
    rows = [
        (
            str(q.quantity),
            str(q.case),
            str(q.component),
            _number(q.value),
            "" if q.unit == "1" else str(q.unit),
        )
        for q in shown.itertuples()
    ]
    widths = [max((len(row[k]) for row in rows), default=0) for k in range(5)]
    lines = []
    for row in rows:
        left = "  ".join(text.ljust(width) for text, width in zip(row[:3], widths[:3], strict=True))
        lines.append(f"{left}  {row[3].rjust(widths[3])} {row[4]}".rstrip())
    if (more := len(run.quantities) - len(shown)) > 0:
        lines.append(f"and {more} of components, see quantities.csv")
    return "\n".join([*lines, f"run directory: {run.run_dir}"])


def _number(value: object) -> str:
    """Return a count with all its digits, anything else with four."""
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return f"{value:,.0f}"
    return cell(value)
