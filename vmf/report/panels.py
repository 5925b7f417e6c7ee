"""Small multiples: one panel per component, angles beside lengths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from vmf.report.style import DOUBLE_IN, INK, SINGLE_IN, dress, log_axis, log_limits, new_figure
from vmf.report.tables import Component

Floats = NDArray[np.float64]
Cell = tuple[int, int]


@dataclass(frozen=True)
class Panels:
    """A figure and the axes of each component."""

    figure: Figure
    axes: dict[str, Axes]


def frame_panels(parts: Sequence[Component], row_height_in: float = 1.45) -> Panels:
    """Return panels over frames: x shared and labelled below each column only."""
    cells = column_cells(parts)
    rows = 1 + max(row for row, _ in cells)
    columns = 1 + max(column for _, column in cells)
    width = SINGLE_IN if columns == 1 else DOUBLE_IN
    figure = new_figure(width, rows * row_height_in + 0.9)
    grid = figure.add_gridspec(rows, columns)
    axes: dict[str, Axes] = {}
    for part, (row, column) in zip(parts, cells, strict=True):
        first = next(iter(axes.values()), None)
        ax = figure.add_subplot(grid[row, column], sharex=first)
        lowest = row == max(r for r, c in cells if c == column)
        ax.tick_params(labelbottom=lowest)
        if lowest:
            ax.set_xlabel("frame")
        dress(ax)
        axes[part.name] = ax
    figure.align_ylabels()
    return Panels(figure, axes)


def column_cells(parts: Sequence[Component]) -> list[Cell]:
    """Place components two or three abreast: angles beside lengths if as many, above them if nearly."""
    kinds = _by_unit(parts)
    if len(kinds) == 2 and len(kinds[0]) == len(kinds[1]) > 1:
        return [_find(kinds, part)[::-1] for part in parts]
    if len(kinds) == 2 and max(map(len, kinds)) == 3 and min(map(len, kinds)) == 2:
        return [_find(kinds, part) for part in parts]
    columns = len(parts) if len(parts) <= 3 else 2
    return [divmod(i, columns) for i in range(len(parts))]


def row_cells(parts: Sequence[Component]) -> list[Cell]:
    """Place components up to four abreast, angles above lengths."""
    if len(parts) <= 3:
        return [(0, i) for i in range(len(parts))]
    kinds = _by_unit(parts)
    if max(len(kind) for kind in kinds) <= 4:
        return [_find(kinds, part) for part in parts]
    return [divmod(i, 4) for i in range(len(parts))]


def _by_unit(parts: Sequence[Component]) -> list[list[Component]]:
    units = list(dict.fromkeys(part.unit for part in parts))
    return [[part for part in parts if part.unit == unit] for unit in units]


def _find(kinds: list[list[Component]], part: Component) -> Cell:
    kind = next(i for i, group in enumerate(kinds) if part in group)
    return kind, kinds[kind].index(part)


def frame_axis(axes: Sequence[Axes], frames: Floats) -> None:
    """Scale the shared frame axis: logarithmic when the frames themselves are spaced so, but for the last."""
    first = axes[0]
    if _grow(frames):
        limits = log_limits(frames, pad=0.02)
        assert limits is not None
        for ax in axes:
            log_axis(ax.xaxis, limits, max_labels=7)
        return
    span = float(frames[-1] - frames[0]) or 1.0
    first.set_xlim(float(frames[0]) - 0.02 * span, float(frames[-1]) + 0.02 * span)
    first.xaxis.set_major_locator(MaxNLocator(6, integer=True, steps=[1, 2, 2.5, 5, 10]))


def curve_alone(frames: Floats) -> Floats:
    """Return the frames to draw as a curve: a run at the end of a logarithmic axis is one upright line."""
    if not _grow(frames):
        return frames
    return np.union1d(_without_run(frames), frames[-1:])


def _grow(frames: Floats) -> bool:
    """Whether the steps between frames grow with them, but for a run at the end."""
    gaps = np.diff(_without_run(frames))
    if len(gaps) <= 3 or frames[0] <= 0:
        return False
    return bool(gaps[-1] > 5 * gaps[0] and frames[-1] > 10 * frames[0])


def _without_run(frames: Floats) -> Floats:
    """Return the frames without a run at the end in which every one is there."""
    jumps = np.flatnonzero(np.diff(frames) > 1)
    if len(jumps) == 0 or jumps[-1] == len(frames) - 2:
        return frames
    return frames[: jumps[-1] + 1]


def log_error_axis(ax: Axes, values: Floats, limits: tuple[float, float] | None = None) -> None:
    """Make y logarithmic over the values, or say that there is none."""
    limits = limits or log_limits(values)
    if limits is None:
        ax.set_yticks([])
        ax.text(0.5, 0.5, "no answer", transform=ax.transAxes, ha="center", va="center")
    else:
        log_axis(ax.yaxis, limits, max_labels=6)


def label_error(ax: Axes, part: Component) -> None:
    """Name the component above its panel and the absolute error and its unit beside it."""
    ax.set_title(part.label, loc="left", pad=3, color=INK)
    ax.set_ylabel(f"|error| ({part.unit})")
