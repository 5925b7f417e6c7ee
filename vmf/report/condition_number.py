"""Condition number of a tile's least-squares system against frame (Figs. 5.19, 5.29, 5.36)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from vmf.report.panels import frame_axis
from vmf.report.style import (
    METHODS,
    SINGLE_IN,
    dress,
    footnote,
    heading,
    log_axis,
    log_limits,
    message_figure,
    new_figure,
    styled,
)

Floats = NDArray[np.float64]


@styled
def condition_number(frames: ArrayLike, condition: ArrayLike) -> Figure:
    """Draw the condition number (F,) of a trial, or median and 5–95 % range of (trials, F), on a log axis."""
    x = np.asarray(frames, dtype=np.float64)
    values = np.atleast_2d(np.asarray(condition, dtype=np.float64))
    if x.ndim != 1 or values.ndim != 2 or values.shape[1] != len(x):
        raise ValueError(f"condition numbers {values.shape} do not fit {x.shape} frames")
    values = np.where(np.isfinite(values) & (values > 0), values, np.nan)
    known = np.asarray(np.isfinite(values).any(axis=0), dtype=np.bool_)
    if not known.any():
        return message_figure("The system was singular at every frame: no condition number.")
    figure = new_figure(SINGLE_IN, 2.3)
    ax = figure.add_subplot()
    dress(ax)
    middle, low, high = _quantiles(values, known)
    color = METHODS["vmf"].color
    ax.plot(x, middle, color=color, linewidth=1.3, label="median")
    if len(values) > 1:
        ax.fill_between(x, low, high, color=color, alpha=0.22, linewidth=0, label="range")
    limits = log_limits(np.concatenate([middle, low, high]))
    if limits is not None:
        log_axis(ax.yaxis, limits, max_labels=7)
    ax.set_xlabel("frame")
    ax.set_ylabel("condition number (1)")
    frame_axis([ax], x)
    if len(values) > 1:
        band = Patch(color=color, alpha=0.22, linewidth=0, label="5 % to 95 %")
        heading(figure, f"{len(values)} trials", [*ax.get_lines()[:1], band])
    _note(figure, values)
    return figure


def _quantiles(values: Floats, known: NDArray[np.bool_]) -> Floats:
    quantiles = np.full((3, values.shape[1]), np.nan)
    quantiles[:, known] = np.nanquantile(values[:, known], [0.5, 0.05, 0.95], axis=0)
    return quantiles


def _note(figure: Figure, values: Floats) -> None:
    singular = int(np.isnan(values).sum())
    if singular:
        footnote(figure, f"Singular, not drawn: {singular:,} of {values.size:,} systems.")
