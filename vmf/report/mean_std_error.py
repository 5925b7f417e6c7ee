"""Mean ± standard deviation over trials of the absolute error (Figs. 5.7, 5.16–5.18, 5.30–5.35)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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
    split_method,
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
    """Mean and standard deviation of |error| over so many trials, all (F,), at frames (F,)."""

    frames: Floats
    mean: Floats
    std: Floats
    trials: Floats


NO_CURVE = Curve(*(np.empty(0) for _ in range(4)))


@styled
def mean_std_error(errors: pd.DataFrame) -> Figure:
    """Draw mean ± std over trials of |error| of each method per frame, one panel per component."""
    check(errors)
    rows = mean_bound(select(errors, protocol="trained_code"))
    answers = solved(rows)
    names = methods(rows)
    n_trials = len(trial_numbers(rows))
    parts = components(rows)
    if not parts:
        return message_figure("No frame was asked of the trained code.")
    if answers.empty:
        return message_figure(f"Trained code: nothing was solved: {count_sentence(rows, names)}.")
    styles = method_styles(names)
    panels = frame_panels(parts, row_height_in=1.7)
    banded = _banded(names)
    frames = np.unique(numbers(rows, "frame"))
    frame_axis(list(panels.axes.values()), frames)
    bins = frame_bins(frames, next(iter(panels.axes.values())).get_xscale() == "log")
    least = least_trials(n_trials)
    whole = error_curves(rows)
    all_curves = {key: blocks(often(curve, least), bins) for key, curve in whole.items()}
    if not any(np.isfinite(curve.mean).any() for curve in all_curves.values()):
        least, all_curves = 1, {key: blocks(curve, bins) for key, curve in whole.items()}
    clipped = False
    for part in parts:
        curves = {m: all_curves.get((part.name, m), NO_CURVE) for m in names}
        clipped |= _panel(panels.axes[part.name], curves, styles, banded)
        label_error(panels.axes[part.name], part)
    drawn = [
        m for m in names if any(np.isfinite(c.mean).any() for (_, of), c in all_curves.items() if of == m)
    ]
    over = "one trial" if n_trials == 1 else f"mean over {n_trials} trials"
    heading(panels.figure, f"Trained code, {over}", [method_handle(styles[m]) for m in drawn])
    whose = " and ".join(styles[m].label for m in banded)
    note = [f"Band: ± 1 standard deviation over trials of {whose}."] if n_trials > 1 and banded else []
    if clipped:
        note.append("Its lower edge is cut off at the axis where mean − std lies below it, or below zero.")
    if bins.span:
        note.append(f"Each point averages what was asked within {bins.span}.")
    few = least > 1 and any((c.trials < least).any() for c in whole.values())
    if few:
        note.append(f"Lines leave out means over fewer than {least} of the {n_trials} trials.")
    if "cramer_rao" in drawn:
        note.append(BELOW_BOUND)
    asked = [m for m in names if m not in REFERENCES]
    footnote(panels.figure, " ".join([*note, f"Solved: {count_sentence(rows, asked)}." if asked else ""]))
    return panels.figure


def _banded(names: list[str]) -> list[str]:
    """Return whose bands are drawn: more than two on a log axis hide each other, so then only functions'."""
    bands = [m for m in names if m not in REFERENCES]
    if len(bands) > 2:
        bands = [m for m in bands if split_method(m)[0] == "vmf"] or bands
    return bands if len(bands) <= 2 else bands[:1]


def least_trials(n_trials: int) -> int:
    """Return over how many trials a mean has to be to be drawn: a tenth, and three if there are five."""
    return max(math.ceil(n_trials / 10), min(3, math.ceil(n_trials / 2)))


def error_curves(rows: pd.DataFrame) -> dict[tuple[str, str], Curve]:
    """Return mean and sample std over trials of |error| per frame, of each (component, method).

    There is a point after every frame asked, NaN where no trial has an answer.
    """
    keys = ["component", "method", "frame", "trial"]
    per_trial = rows.groupby(keys, observed=True)["abs_error"].mean()
    stats = per_trial.groupby(level=keys[:3], observed=True).agg(["mean", "std", "count"]).reset_index()
    return {
        (str(component), str(method)): Curve(*(numbers(one, c) for c in ("frame", "mean", "std", "count")))
        for (component, method), one in stats.groupby(["component", "method"], observed=True)
    }


def often(curve: Curve, least: int) -> Curve:
    """Return the curve without the means over fewer than so many trials."""
    few = curve.trials < least
    return replace(curve, mean=np.where(few, np.nan, curve.mean), std=np.where(few, np.nan, curve.std))


@dataclass(frozen=True)
class Bins:
    """Edges (B + 1,) between which frames are drawn as one point, and how wide that is, in words."""

    edges: Floats
    span: str


def frame_bins(frames: Floats, logarithmic: bool) -> Bins:
    """Return at most `MAX_POINTS` bins, equally wide on the axis: hundreds of points hide each other.

    Few frames have one each.
    """
    first, last = frames[0], frames[-1]
    width = math.ceil((last - first + 1) / MAX_POINTS)
    if len(frames) <= MAX_POINTS or width == 1:
        return Bins(np.append(frames, last + 1), "")
    if logarithmic:
        edges = np.geomspace(first, last, MAX_POINTS + 1)
        return Bins(np.append(edges[:-1], last + 1), f"1/{MAX_POINTS} of the axis")
    return Bins(np.arange(first, last + width + 1, width), f"{width} frames")


def blocks(curve: Curve, bins: Bins) -> Curve:
    """Return the curve averaged over the frames of each bin; NaN where all are."""
    if not bins.span:
        return curve
    _, where = np.unique(np.searchsorted(bins.edges, curve.frames, side="right"), return_inverse=True)
    known = np.isfinite(curve.mean)
    n_all = np.bincount(where).astype(float)
    n_known = np.bincount(where, known).astype(float)

    def averages(values: Floats, n: Floats) -> Floats:
        sums = np.bincount(where, np.where(known, values, 0.0))
        return np.asarray(np.divide(sums, n, out=np.full(len(n), np.nan), where=n > 0))

    frames = np.where(n_known > 0, averages(curve.frames, n_known), np.bincount(where, curve.frames) / n_all)
    trials = np.bincount(where, curve.trials) / n_all
    return Curve(frames, averages(curve.mean, n_known), averages(curve.std, n_known), trials)


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
        alone = np.isfinite(mean) & ~_beside(np.isfinite(mean))
        if alone.any():
            dot = style.point | {"marker": ".", "linestyle": "none", "zorder": top}
            ax.plot(curve.frames[alone], mean[alone], **dot, label=f"_{method}")
        if limits is None or method not in banded or not np.isfinite(curve.std).any():
            continue
        low = np.maximum(curve.mean - curve.std, limits[0])
        clipped |= bool(np.any(curve.mean - curve.std < limits[0]))
        alpha = 0.22 if method == "vmf" else 0.12
        high = curve.mean + curve.std
        ax.fill_between(curve.frames, low, high, color=style.color, alpha=alpha, linewidth=0, label=method)
    log_error_axis(ax, np.empty(0), limits)
    return clipped


def _beside(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which points (F,) have one beside them that is known, to which a line can be drawn."""
    padded = np.pad(known, 1)
    return padded[:-2] | padded[2:]


def _limits(curves: dict[str, Curve], banded: list[str]) -> tuple[float, float] | None:
    """Hold every mean and upper edge; lower edges go down without end, so at most a third below the means."""
    means = np.concatenate([c.mean for c in curves.values()])
    means = means[np.isfinite(means)]
    edges = [edge for c in (curves[m] for m in banded) for edge in (c.mean + c.std, c.mean - c.std)]
    floor = means[means > 0].min(initial=np.inf) / 3
    values = np.concatenate([means, *edges])
    if np.any(values < floor):
        values = np.append(values[values >= floor], floor)
    return log_limits(values, pad=0.03)
