"""Horizontal rows, one per case and method, beside a column of counts: shared by the comparisons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vmf.report.panels import row_cells
from vmf.report.style import DOUBLE_IN, INK, SMALL_PT, MethodStyle, dress, new_figure
from vmf.report.tables import Component

PITCH_IN = 0.175


@dataclass(frozen=True)
class Row:
    """One row of a panel: a method in a case, or a case's heading when `method` is empty."""

    y: float
    case: str
    method: str
    label: str


def build_rows(
    groups: Sequence[tuple[str, str]], methods: dict[str, list[str]], looks: dict[str, MethodStyle]
) -> list[Row]:
    """Return the rows of each (case, heading), its methods below it, downwards from y = 0."""
    rows: list[Row] = []
    y = 0.0
    for case, heading in groups:
        if len(groups) > 1:
            rows.append(Row(y, case, "", heading))
            y += 1
        for method in methods[case]:
            label = looks[method].label.replace(" (", "\n(")
            extra = 0.4 if "\n" in label else 0.0
            y += extra
            rows.append(Row(y, case, method, label))
            y += 1 + extra
        y += 0.3
    return rows


def row_panels(parts: Sequence[Component], rows: Sequence[Row]) -> tuple[Figure, dict[str, Axes], list[Axes]]:
    """Return the figure, the axes of each component, and those at the right end of a full line."""
    cells = row_cells(parts)
    lines, columns = 1 + max(r for r, _ in cells), 1 + max(c for _, c in cells)
    height = (rows[-1].y + 1.2) * PITCH_IN
    figure = new_figure(DOUBLE_IN, lines * (height + 0.62) + 0.75)
    grid = figure.add_gridspec(lines, columns)
    axes: dict[str, Axes] = {}
    for part, (line, column) in zip(parts, cells, strict=True):
        ax = figure.add_subplot(grid[line, column])
        dress(ax, grid="x")
        ax.spines["left"].set_visible(False)
        ax.set_ylim(rows[-1].y + 0.6, -0.6)
        ax.set_yticks([row.y for row in rows])
        ax.tick_params(axis="y", length=0, pad=4)
        ax.set_yticklabels([row.label if column == 0 else "" for row in rows], linespacing=1.05)
        for row, tick in zip(rows, ax.get_yticklabels(), strict=True):
            tick.set_fontweight("normal" if row.method else "bold")
        axes[part.name] = ax
    ends = [axes[p.name] for p, (_, column) in zip(parts, cells, strict=True) if column == columns - 1]
    return figure, axes, ends


def write_column(ax: Axes, offset_pt: float, heading: str, cells: Sequence[tuple[float, str]]) -> None:
    """Write a column of numbers right of the axes, `offset_pt` from its edge to their right end."""
    top = ax.get_ylim()[1]
    for y, text in [(top - 0.45, heading), *cells]:
        ax.annotate(
            text,
            xy=(1.0, y),
            xycoords=ax.get_yaxis_transform(),
            xytext=(offset_pt, 0),
            textcoords="offset points",
            ha="right",
            va="center_baseline",
            fontsize=SMALL_PT,
            color=INK,
            annotation_clip=False,
        )
