"""Absolute error of one trial against frame (Figs. 5.5, 5.11)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vmf.report.panels import curve_alone, frame_axis, frame_panels, label_error, log_error_axis
from vmf.report.style import (
    METHODS,
    MethodStyle,
    footnote,
    heading,
    message_figure,
    method_handle,
    method_styles,
    styled,
)
from vmf.report.tables import (
    check,
    components,
    counted,
    mean_bound,
    numbers,
    select,
    solved,
    status_counts,
)
from vmf.report.truth_vs_estimate import beside, is_function, lost_handles, mark_lost, vmf_curve

Floats = NDArray[np.float64]
MARKERS_UP_TO = 150


@styled
def absolute_error(errors: pd.DataFrame, trial: int = 0) -> Figure:
    """Draw |error| of vmf per frame of one trial, one panel per component, on a log axis.

    Other functions are lines, too; rivals, whose errors know no order of frames, are points.
    """
    check(errors)
    rows = vmf_curve(errors, trial)
    asked = np.unique(numbers(rows, "frame"))
    shown = curve_alone(asked) if len(asked) else asked
    errors = errors.loc[np.isin(numbers(errors, "frame"), shown)]
    rows = vmf_curve(errors, trial)
    parts = components(rows)
    if not parts:
        return message_figure(f"No frame of trial {trial} was asked of the trained code.")
    first = select(rows, component=parts[0].name).drop_duplicates("frame", keep="last")
    counts = status_counts(first)
    if solved(rows).empty:
        return message_figure(f"Trained code, trial {trial}: no frame was solved: {counted(counts)}.")
    panels = frame_panels(parts, row_height_in=1.6)
    bound = mean_bound(select(errors, protocol="trained_code", method="cramer_rao", trial=trial))
    bound = bound.sort_values("frame", kind="stable")
    others_rows = beside(errors, trial)
    others = {
        method: style if is_function(method) else replace(style.open, linestyle="none")
        for method, style in method_styles(others_rows["method"].unique()).items()
    }
    dense = len(first) > MARKERS_UP_TO
    look = METHODS["vmf"].line | {"linewidth": 0.7, "markersize": 0.0 if dense else 2.4}
    for part in parts:
        ax = panels.axes[part.name]
        one = select(rows, component=part.name).drop_duplicates("frame", keep="last")
        error = np.where((one["status"] == "ok").to_numpy(), numbers(one, "abs_error"), np.nan)
        error = np.where(error > 0, error, np.nan)
        ax.plot(numbers(one, "frame"), error, label="vmf", **look)
        drawn = [error, _bound_line(ax, select(bound, component=part.name))]
        for other, style in others.items():
            drawn.append(_other_line(ax, select(others_rows, component=part.name, method=other), style))
        log_error_axis(ax, np.concatenate(drawn))
        mark_lost(ax, one)
        label_error(ax, part)
    frame_axis(list(panels.axes.values()), np.unique(numbers(rows, "frame")))
    text = f"vmf, trained code, trial {trial}: solved {counted(counts)} frames"
    handles = [method_handle(style) for style in others.values()] + lost_handles(first)
    if others:
        handles = [method_handle(METHODS["vmf"]), *handles]
    if len(bound):
        handles = [method_handle(METHODS["cramer_rao"]), *handles]
    heading(panels.figure, text, handles)
    if left_out := len(asked) - len(shown):
        n = left_out + 1
        footnote(
            panels.figure, f"Of the last {n:,} frames, which were all asked, the last is drawn and counted."
        )
    return panels.figure


def _other_line(ax: Axes, rows: pd.DataFrame, style: MethodStyle) -> Floats:
    """Draw |error| of another function at the frames after which it was asked, and return what is drawn."""
    error = np.where((rows["status"] == "ok").to_numpy(), numbers(rows, "abs_error"), np.nan)
    error = np.where(error > 0, error, np.nan)
    look = style.line | {"linewidth": 0.7, "markersize": 2.0, "markeredgewidth": 0.6}
    ax.plot(numbers(rows, "frame"), error, label=style.label, zorder=1.5, **look)
    return error


def _bound_line(ax: Axes, bound: pd.DataFrame) -> Floats:
    """Draw the mean |error| that the Cramér–Rao bound allows at each frame, and return what is drawn."""
    least = numbers(bound, "abs_error")
    least = np.where(least > 0, least, np.nan)
    if len(least):
        ax.plot(numbers(bound, "frame"), least, label="cramer_rao", zorder=3.0, **METHODS["cramer_rao"].line)
    return least
