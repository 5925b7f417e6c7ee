"""Mean ± standard deviation over trials of the absolute error (Figs. 5.7, 5.16–5.18, 5.30–5.35)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vmf.report.panels import frame_axis, frame_panels, label_error, log_error_axis
from vmf.report.style import (
    REFERENCES,
    MethodStyle,
    footnote,
    heading,
    log_limits,
    message_figure,
    method_handle,
    method_styles,
    styled,
)
from vmf.report.tables import (
    BELOW_BOUND,
    check,
    components,
    count_sentence,
    mean_bound,
    methods,
    numbers,
    select,
    solved,
    trial_numbers,
)

Floats = NDArray[np.float64]
MAX_POINTS = 100


@dataclass(frozen=True)
class Curve:
    """Mean and standard deviation over trials of |error|, both (F,), at frames (F,)."""

    frames: Floats
    mean: Floats
    std: Floats


NO_CURVE = Curve(np.empty(0), np.empty(0), np.empty(0))


@styled
def mean_std_error(errors: pd.DataFrame) -> Figure:
    """Draw mean ± std over trials of |error| of each method per frame, one panel per component."""
    check(errors)
    rows = mean_bound(select(errors, protocol="trained_code"))
    answers = solved(rows)
    names = methods(rows)
    parts = components(rows)
    if not parts:
        return message_figure("No frame was asked of the trained code.")
    if answers.empty:
        return message_figure(f"Trained code: nothing was solved: {count_sentence(rows, names)}.")
    styles = method_styles(names)
    panels = frame_panels(parts, row_height_in=1.7)
    banded = _banded(names)
    frames = np.unique(numbers(rows, "frame"))
    block = math.ceil(len(frames) / MAX_POINTS)
    all_curves = error_curves(answers)
    clipped = False
    for part in parts:
        curves = {m: blocks(all_curves.get((part.name, m), NO_CURVE), block) for m in names}
        clipped |= _panel(panels.axes[part.name], curves, styles, banded)
        label_error(panels.axes[part.name], part)
    frame_axis(list(panels.axes.values()), frames)
    drawn = [m for m in names if m in set(answers["method"].unique())]
    n_trials = len(trial_numbers(rows))
    over = "one trial" if n_trials == 1 else f"mean over {n_trials} trials"
    heading(panels.figure, f"Trained code, {over}", [method_handle(styles[m]) for m in drawn])
    whose = " and ".join(styles[m].label for m in banded)
    note = [f"Band: ± 1 standard deviation over trials of {whose}."] if n_trials > 1 and banded else []
    if clipped:
        note.append("Its lower edge is cut off at the axis where mean − std lies below it, or below zero.")
    if block > 1:
        note.append(f"Each point is the average of {block} frames.")
    if "cramer_rao" in drawn:
        note.append(BELOW_BOUND)
    asked = [m for m in names if m not in REFERENCES]
    footnote(panels.figure, " ".join([*note, f"Solved: {count_sentence(rows, asked)}." if asked else ""]))
    return panels.figure


def _banded(names: list[str]) -> list[str]:
    """Return whose bands are drawn: more than two on a log axis hide each other, so then only vmf's."""
    bands = [m for m in names if m not in REFERENCES]
    return bands if len(bands) <= 2 else bands[:1]


def error_curves(answers: pd.DataFrame) -> dict[tuple[str, str], Curve]:
    """Return mean and sample std over trials of |error| per frame, of each (component, method)."""
    keys = ["component", "method", "frame", "trial"]
    per_trial = answers.groupby(keys, observed=True)["abs_error"].mean()
    stats = per_trial.groupby(level=keys[:3], observed=True).agg(["mean", "std"]).reset_index()
    return {
        (str(component), str(method)): Curve(*(numbers(rows, c) for c in ("frame", "mean", "std")))
        for (component, method), rows in stats.groupby(["component", "method"], observed=True)
    }


def blocks(curve: Curve, length: int) -> Curve:
    """Return the curve averaged over blocks of `length` frames: hundreds of points hide each other.

    The last block takes what is left over.
    """
    starts = np.arange(0, len(curve.frames) - length + 1, length)
    if length == 1 or len(starts) == 0:
        return curve
    sizes = np.diff(np.append(starts, len(curve.frames)))
    averages = (np.add.reduceat(v, starts) / sizes for v in (curve.frames, curve.mean, curve.std))
    return Curve(*averages)


def _panel(ax: Axes, curves: dict[str, Curve], styles: dict[str, MethodStyle], banded: list[str]) -> bool:
    limits = _limits(curves, banded)
    clipped = False
    for order, (method, curve) in enumerate(curves.items()):
        style = styles[method]
        mean = np.where(curve.mean > 0, curve.mean, np.nan)
        step = max(1, len(mean) // 7)
        every = ((order * step // max(1, len(curves))) % step, step)
        # The bound is thin and dashed: it must be seen where the function reaches it.
        top = {"vmf": 4.0, "cramer_rao": 5.0}.get(method, 3.0)
        ax.plot(curve.frames, mean, **style.line, markevery=every, zorder=top, label=method)
        if limits is None or method not in banded or not np.isfinite(curve.std).any():
            continue
        low = np.maximum(curve.mean - curve.std, limits[0])
        clipped |= bool(np.any(curve.mean - curve.std < limits[0]))
        alpha = 0.22 if method == "vmf" else 0.12
        high = curve.mean + curve.std
        ax.fill_between(curve.frames, low, high, color=style.color, alpha=alpha, linewidth=0, label=method)
    log_error_axis(ax, np.empty(0), limits)
    return clipped


def _limits(curves: dict[str, Curve], banded: list[str]) -> tuple[float, float] | None:
    """Hold every mean and upper edge; lower edges go down without end, so at most a third below the means."""
    means = np.concatenate([c.mean for c in curves.values()])
    edges = [edge for c in (curves[m] for m in banded) for edge in (c.mean + c.std, c.mean - c.std)]
    floor = means[means > 0].min(initial=np.inf) / 3
    values = np.concatenate([means, *edges])
    if np.any(values < floor):
        values = np.append(values[values >= floor], floor)
    return log_limits(values, pad=0.03)
