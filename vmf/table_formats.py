"""A table in the formats that papers, pages and programs take."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Any

import pandas as pd

from vmf.experiment.table import SideBySide

# Backslash and braces need more than a backslash before them.
_LATEX = {char: f"\\{char}" for char in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "–": "--",
}


def markdown(table: pd.DataFrame) -> str:
    """Return a Markdown table with four significant digits."""
    lines = [_escaped(table.columns), ["---"] * len(table.columns)]
    lines += [_escaped(map(cell, row)) for row in table.itertuples(index=False)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _escaped(cells: Iterable[str]) -> list[str]:
    return [cell.replace("|", "\\|") for cell in cells]


def latex(table: pd.DataFrame) -> str:
    """Return a LaTeX `tabular` (package booktabs) with four significant digits, numbers to the right."""
    numeric = [all(isinstance(v, int | float) for v in table[column]) for column in table]
    rows = [" & ".join(_tex(cell(v)) for v in row) + r" \\" for row in table.itertuples(index=False)]
    head = " & ".join(_tex(str(column)) for column in table.columns) + r" \\"
    columns = "".join("r" if is_number else "l" for is_number in numeric)
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *rows, r"\bottomrule"]
    return "\n".join([*lines, r"\end{tabular}"])


def _tex(text: str) -> str:
    return "".join(_LATEX.get(char, char) for char in text)


def csv(table: pd.DataFrame) -> str:
    """Return CSV with all digits."""
    return table.to_csv(index=False).rstrip()


def to_json(found: SideBySide) -> str:
    """Return rows, notes and losses as JSON, with all digits."""
    losses = [str(loss) for loss in found.losses]
    content = {"rows": records(found.rows), "notes": list(found.notes), "losses": losses}
    return json.dumps(content, indent=2, allow_nan=False)


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the rows as JSON has them, `None` where there is no number."""
    return [
        {str(key): None if isinstance(v, float) and v != v else v for key, v in row.items()}
        for row in table.to_dict("records")
    ]


def cell(value: object) -> str:
    """Return what stands in a cell: four significant digits, a dash for nothing."""
    if value is None or value != value:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


FORMATS: dict[str, Callable[[pd.DataFrame], str]] = {"markdown": markdown, "csv": csv, "latex": latex}
