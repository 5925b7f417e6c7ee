"""Error and memory of approximators against the number of codes, and what they take of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vmf.report.style import (
    DOUBLE_IN,
    TEXT_PT,
    dress,
    footnote,
    heading,
    log_axis,
    log_limits,
    new_figure,
    styled,
)
from vmf.spec.studies import ApproximatorsStudy
from vmf.study.figures.lines import line_styles
from vmf.study.result import Quantity

# Exact answers would leave no room for the others.
_FLOOR_PX = 0.003


@styled
def draw_growth(settings: ApproximatorsStudy, growth: pd.DataFrame) -> Figure:
    """Draw error in pixels (one panel per noise), and memory, against the number of codes."""
    names = list(dict.fromkeys(growth["approximator"]))
    styles = line_styles(names)
    figure = new_figure(DOUBLE_IN, 3.4)
    panels = [*settings.noise, None]
    errors = log_limits(growth["pixel_error_px"].clip(lower=_FLOOR_PX).to_numpy(float))
    for place, share in enumerate(panels, start=1):
        ax = figure.add_subplot(1, len(panels), place)
        dress(ax)
        column = "memory_bytes" if share is None else "pixel_error_px"
        rows = growth[growth["noise"] == (settings.noise[0] if share is None else share)]
        for name in names:
            mine = rows[rows["approximator"] == name]
            ax.plot(mine["codes"], mine[column].clip(lower=_FLOOR_PX), **styles[name])
        log_axis(ax.xaxis, _wide(settings.codes), max_labels=4)
        limits = log_limits(growth[column].to_numpy(float)) if share is None else errors
        if limits is not None:
            log_axis(ax.yaxis, limits, max_labels=7)
        ax.set_xlabel("training codes")
        ax.set_ylabel("memory (B)" if share is None else "median |error| (px)")
        title = "memory" if share is None else f"noise {100 * share:g} % of the spread"
        ax.set_title(title, fontsize=TEXT_PT)
    handles = [Line2D([], [], label=name, **styles[name]) for name in names]
    heading(figure, "approximators of Θ over the stereo space", handles)
    footnote(
        figure,
        f"Pixels after motions of up to {settings.move_m:g} m and {settings.turn_rad:g} rad on each axis, at "
        f"{settings.tests} codes that were not visited; codes without an answer are left out. "
        f"Less than {_FLOOR_PX:g} px is drawn as that.",
    )
    return figure


@styled
def draw_times(settings: ApproximatorsStudy, times: Sequence[Quantity]) -> Figure:
    """Draw how long training and asking take, over the first approximator's time."""
    figure = new_figure(DOUBLE_IN, 2.6)
    for place, quantity in enumerate(("time_training_ratio", "time_asking_ratio"), start=1):
        mine = [q for q in times if q.quantity == quantity]
        styles = line_styles([q.case for q in mine])
        ax = figure.add_subplot(1, 2, place)
        dress(ax, grid="x")
        values = np.array([q.value for q in mine])
        limits = log_limits(np.append(values, 1.0), pad=0.1) or (0.1, 10.0)
        log_axis(ax.xaxis, limits, max_labels=6)
        for row, q in enumerate(mine):
            color = styles[q.case]["color"]
            ax.plot([1.0, q.value], [row, row], color=color, linewidth=1.6)
            ax.plot(q.value, row, color=color, marker=styles[q.case]["marker"], markersize=5)
        ax.set_yticks(range(len(mine)), [q.case for q in mine] if place == 1 else [""] * len(mine))
        ax.set_ylim(len(mine) - 0.5, -0.5)
        ax.set_xlabel(f"time of {'training' if place == 1 else 'asking'} over that of the first (1)")
    footnote(
        figure,
        f"Medians of {settings.repeats} turns, each after {settings.timed:,} codes at most and for "
        f"{settings.tests} questions; processor time of one core.",
    )
    return figure


def _wide(codes: Sequence[int]) -> tuple[float, float]:
    return min(codes) / 1.15, max(codes) * 1.15
