"""The result table on standard output, for people and for machines."""

from __future__ import annotations

import json
from io import StringIO
from typing import Any

import pandas as pd
from rich.console import Console
from rich.table import Table
from rich.text import Text

from vmf.experiment.run import RunResult
from vmf.report.calibration_crossover import KINDS
from vmf.table_formats import records

_QUESTIONS = {
    "trained_code": "trained code: from a view of the training itself, same targets",
    "held_out": "held out: new targets, new poses, one shot each",
}
_RECORDED = "held out: a later block of time, one shot per pair of frames"
_WIDTH = 150


def to_json(result: RunResult) -> str:
    """Return the summary as JSON, with `run_dir`, paired differences, plots, losses and notes."""
    return json.dumps(
        {
            "run_dir": str(result.run_dir),
            "summary": records(result.summary),
            "paired": None if result.paired is None else records(result.paired),
            "crossovers": None if result.crossovers is None else records(result.crossovers),
            "plots": [str(path) for path in result.plots],
            "losses": [str(loss) for loss in result.losses],
            "notes": list(result.notes),
        },
        indent=2,
        allow_nan=False,
    )


def as_text(result: RunResult) -> str:
    """Return the tables that a person reads, and where everything is."""
    buffer = StringIO()
    console = Console(file=buffer, width=_WIDTH, color_system=None, markup=False, highlight=False)
    summary = result.summary[~result.summary["method"].isin(result.swept)]
    for protocol in summary["protocol"].unique():
        part = summary[summary["protocol"] == protocol]
        for case in part["case"].unique():
            console.print(_errors(part[part["case"] == case], protocol, case))
    if result.paired is not None and len(result.paired):
        for protocol in result.paired["protocol"].unique():
            console.print(_paired(result.paired[result.paired["protocol"] == protocol], protocol))
    if result.crossovers is not None:
        console.print("where reconstruction with calibration errors falls behind, on held-out questions")
        for line in _crossovers(result.crossovers):
            console.print("  " + line, soft_wrap=True)
    console.print(f"run directory: {result.run_dir}", soft_wrap=True)
    if result.plots:
        console.print(f"plots: {result.plots[0].parent} ({len(result.plots)} figures)", soft_wrap=True)
    return buffer.getvalue().rstrip()


def _question(protocol: str, case: str) -> str:
    if protocol == "held_out" and case.startswith("gap="):
        return _RECORDED
    return _QUESTIONS.get(protocol, protocol)


def _errors(part: pd.DataFrame, protocol: str, case: str) -> Table:
    title = f"|error|, mean (median) — {_question(protocol, case)} — {case}"
    table = Table(title=title, title_justify="left")
    table.add_column("method", no_wrap=True)
    names = part[["component", "unit"]].drop_duplicates().itertuples(index=False)
    components = [(str(name), str(unit)) for name, unit in names]
    for name, unit in components:
        table.add_column(f"{name} ({unit})", justify="right")
    for heading in ("n", "refused", "diverged"):
        table.add_column(heading, justify="right")
    for method in part["method"].unique():
        rows = part[part["method"] == method].set_index("component")
        cells = [_mean_median(rows.loc[name]) for name, _ in components]
        first = rows.iloc[0]
        counts = [str(int(first[key])) for key in ("n", "n_refused", "n_diverged")]
        table.add_row(Text(str(method)), *cells, *counts)
    return table


def _mean_median(row: pd.Series[Any]) -> str:
    return "–" if row["mean"] != row["mean"] else f"{row['mean']:.4f} ({row['median']:.4f})"


def _paired(part: pd.DataFrame, protocol: str) -> Table:
    case = str(part["case"].iloc[-1])
    table = Table(
        title="paired difference of mean |error|, method − vmf [95 % interval], and ratio of medians — "
        + _question(protocol, case),
        title_justify="left",
        caption=_caption(protocol, case),
        caption_justify="left",
    )
    for heading in ("case", "method", "component", "n"):
        table.add_column(heading, no_wrap=True)
    table.add_column("difference", justify="right")
    table.add_column("95 % interval", justify="right")
    table.add_column("median ratio", justify="right")
    for row in part.itertuples():
        if row.component not in ("angle", "distance"):
            continue
        table.add_row(
            str(row.case),
            Text(str(row.method)),
            str(row.component),
            str(row.n),
            f"{row.mean_difference:+.4f} {row.unit}",
            f"[{row.ci_low:+.4f}, {row.ci_high:+.4f}]",
            f"{row.median_ratio:.2f}".replace("nan", "–"),
        )
    return table


def _caption(protocol: str, case: str) -> str:
    if protocol == "trained_code":
        return (
            "The learned function has seen these very targets in every training frame; "
            "reconstruction sees them twice. Positive: vmf is better."
        )
    if case.startswith("gap="):
        return "All methods see the same two views, and nothing else of this time. Positive: vmf is better."
    return "Neither side has seen these targets before. Positive: vmf is better."


def _crossovers(table: pd.DataFrame) -> list[str]:
    """Return one line per case, rival and kind of error: from which error on it is behind `vmf`."""
    lines = []
    several = table["case"].nunique() > 1
    for (case, method, kind, unit), rows in table.groupby(["case", "method", "kind", "unit"], sort=False):
        parts = [_behind(row, str(unit)) for row in rows.itertuples()]
        where = f", {case}" if several else ""
        lines.append(f"{method}, {KINDS[str(kind)]}{where} (n = {rows['n'].iloc[0]}): {'; '.join(parts)}")
    return lines


def _behind(row: Any, unit: str) -> str:
    if row.n == 0:
        return f"{row.component} unknown, nothing was answered"
    if row.crossover != row.crossover:
        return f"{row.component} not within {row.largest:g} {unit}"
    low, high = (f"{row.ci_low:.2g}", f"{row.ci_high:.2g}")
    high = high if row.ci_high == row.ci_high else f"over {row.largest:g}"
    low = low if row.ci_low == row.ci_low else f"over {row.largest:g}"
    return f"{row.component} from {row.crossover:.2g} {unit} [{low}, {high}]"
