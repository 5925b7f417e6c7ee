"""Motions by the visuomotor function against odometry that drifts (Fig. 5.50)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from vmf.report.panels import frame_axis
from vmf.report.style import (
    DOUBLE_IN,
    GREY,
    MethodStyle,
    dress,
    footnote,
    heading,
    message_figure,
    method_styles,
    new_figure,
    styled,
)
from vmf.report.tables import check, components, numbers, select, solved

Floats = NDArray[np.float64]
ROW_IN = 1.25


@dataclass(frozen=True)
class _Entry:
    """An entry of the motion: its name and unit, the component that it is made of, and how."""

    name: str
    unit: str
    component: str
    of: Callable[[Floats], Floats]


def _same(values: Floats) -> Floats:
    return values


@styled
def odometry(errors: pd.DataFrame, trial: int = 0) -> Figure:
    """Draw entries of the motion by frame, true, by odometry and by each function, and odometry's distance.

    A heading is drawn as the entries r11 and r21 of its rotation, as in the thesis.
    """
    check(errors)
    rows = select(errors, protocol="trained_code", trial=trial).sort_values("frame", kind="stable")
    by_odometry = select(rows, method="odometry")
    if by_odometry.empty:
        return message_figure(f"Odometry does not drift in trial {trial}.")
    entries = _entries(by_odometry)
    functions = [str(m) for m in rows["method"].unique() if str(m).split("[")[0] == "vmf"]
    looks = method_styles([*functions, "odometry"])
    figure = new_figure(DOUBLE_IN, len(entries) * ROW_IN + 0.9)
    grid = figure.add_gridspec(len(entries), 2)
    axes: list[Axes] = []
    for i, entry in enumerate(entries):
        value, off = (figure.add_subplot(grid[i, column]) for column in (0, 1))
        axes += [value, off]
        own = select(by_odometry, component=entry.component)
        frames, measured = numbers(own, "frame"), entry.of(numbers(own, "estimate"))
        truth = entry.of(numbers(own, "truth"))
        value.plot(frames, truth, color=GREY, linewidth=0.9, label="true")
        value.plot(frames, measured, **looks["odometry"].line, label="odometry")
        off.axhline(0.0, color=looks["odometry"].color, linewidth=0.8)
        off.plot(frames, truth - measured, color=GREY, linewidth=0.9, label="true")
        for name in reversed(functions):
            answers = solved(select(rows, method=name, component=entry.component))
            at, there = np.intersect1d(frames, numbers(answers, "frame"), return_indices=True)[:2]
            estimate = entry.of(numbers(answers, "estimate"))[np.isin(numbers(answers, "frame"), at)]
            point = looks[name].point | {"markersize": 1.8, "linestyle": "none", "label": name}
            value.plot(at, estimate, **point)
            off.plot(at, estimate - measured[there], **point)
        for ax in (value, off):
            ax.set_ylim(*_middle(ax))
        value.set_ylabel(f"{entry.name} ({entry.unit})")
        off.set_ylabel(f"difference ({entry.unit})")
        for ax in (value, off):
            dress(ax)
            ax.tick_params(labelbottom=i == len(entries) - 1)
    for ax in axes[-2:]:
        ax.set_xlabel("frame")
    for ax in axes:
        frame_axis([ax], np.unique(numbers(by_odometry, "frame")))
    figure.align_ylabels()
    handles = [
        Line2D([], [], color=GREY, linewidth=0.9, label="true"),
        Line2D([], [], label="odometry", **looks["odometry"].line),
        *(_handle(looks[name]) for name in functions),
    ]
    heading(figure, f"Trained code, trial {trial}: motions since the first frame", handles)
    footnote(figure, "Left: the motion. Right: what it differs from odometry by; far answers are outside.")
    return figure


def _handle(style: MethodStyle) -> Line2D:
    return Line2D([], [], linestyle="none", label=style.label, **(style.point | {"markersize": 2.4}))


def _entries(rows: pd.DataFrame) -> list[_Entry]:
    parts = {part.name: part for part in components(rows)}
    if "heading" in parts:
        turned = [_Entry("$r_{11}$", "1", "heading", np.cos), _Entry("$r_{21}$", "1", "heading", np.sin)]
        moved = [_Entry(f"${n}$", "m", n, _same) for n in ("t_x", "t_y") if n in parts]
        return turned + moved
    overall = ("angle", "distance")
    return [_Entry(p.label, p.unit, n, _same) for n, p in parts.items() if n not in overall]


def _middle(ax: Axes) -> tuple[float, float]:
    """Return limits that hold all but the farthest hundredth of what is drawn."""
    drawn = np.concatenate([np.asarray(line.get_ydata(), float) for line in ax.get_lines()])
    drawn = drawn[np.isfinite(drawn)]
    low, high = np.percentile(drawn, [0.5, 99.5]).tolist()
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin
