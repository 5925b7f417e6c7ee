"""True against estimated motion, frame by frame (Figs. 5.4, 5.10, 5.13–5.15)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from vmf.report.panels import frame_axis, frame_panels
from vmf.report.style import (
    BLACK,
    GREY,
    METHODS,
    VERMILLION,
    MethodStyle,
    dress,
    heading,
    message_figure,
    method_styles,
    styled,
)
from vmf.report.tables import (
    check,
    components,
    numbers,
    select,
    solved,
    status_counts,
)

LOST_MARKERS = {"refused": ("x", VERMILLION), "diverged": ("+", BLACK)}


@styled
def truth_vs_estimate(errors: pd.DataFrame, trial: int = 0, last: int = 80) -> Figure:
    """Draw the true (line) and estimated (markers) value of each component in the last solved frames."""
    check(errors)
    rows = vmf_curve(errors, trial)
    parts = components(rows)
    if not parts:
        return message_figure(f"No frame of trial {trial} was asked of the trained code.")
    rows = _window(rows, last)
    shown = other_functions(errors, trial)
    shown = shown[numbers(shown, "frame") >= numbers(rows, "frame").min(initial=np.inf)]
    others = method_styles(shown["method"].unique())
    panels = frame_panels(parts)
    for part in parts:
        ax = panels.axes[part.name]
        one = select(rows, component=part.name).drop_duplicates("frame", keep="last")
        _values(ax, one)
        for other, style in others.items():
            _estimates(ax, select(shown, component=part.name, method=other), style)
        mark_lost(ax, one)
        ax.set_ylabel(f"{part.label} ({part.unit})")
    frame_axis(list(panels.axes.values()), np.unique(numbers(rows, "frame")))
    one = select(rows, component=parts[0].name).drop_duplicates("frame", keep="last")
    n_frames, n_solved = len(one), status_counts(one)["ok"]
    text = f"Trained code, trial {trial}: {n_solved} of the last {n_frames} frames asked were solved"
    theirs = [_point_handle(style) for style in others.values()]
    heading(panels.figure, text, [*_value_handles(n_solved), *theirs, *lost_handles(one)])
    return panels.figure


def vmf_curve(errors: pd.DataFrame, trial: int) -> pd.DataFrame:
    """Return the rows of one trial in which vmf was asked the trained code, in order of frames."""
    rows = select(errors, protocol="trained_code", method="vmf", trial=trial)
    return rows.sort_values("frame", kind="stable")


def other_functions(errors: pd.DataFrame, trial: int) -> pd.DataFrame:
    """Return the same of the functions that learned beside vmf, `vmf[name]`."""
    rows = select(errors, protocol="trained_code", trial=trial)
    beside = rows["method"].astype(str).str.startswith("vmf[").to_numpy(dtype=bool)
    return rows.loc[beside].sort_values("frame", kind="stable")


def mark_lost(ax: Axes, rows: pd.DataFrame) -> None:
    """Mark the frames without an answer on the frame axis."""
    lost = rows.loc[(rows["status"] != "ok").to_numpy()]
    for status, group in lost.groupby("status", observed=True):
        marker, color = LOST_MARKERS.get(str(status), ("|", GREY))
        frames = numbers(group, "frame")
        ax.plot(
            frames,
            np.zeros(len(frames)),
            linestyle="none",
            marker=marker,
            color=color,
            markersize=4.5,
            markeredgewidth=1.1,
            transform=ax.get_xaxis_transform(),
            clip_on=False,
            zorder=5,
            label=f"_{status}",
        )


def lost_handles(rows: pd.DataFrame) -> list[Artist]:
    """Return a legend entry with the count of each way in which a frame had no answer."""
    handles: list[Artist] = []
    for status, n in status_counts(rows).items():
        if status == "ok":
            continue
        marker, color = LOST_MARKERS.get(status, ("|", GREY))
        label = f"{status} ({n:,} of {len(rows):,} frames)"
        handles.append(
            Line2D([], [], linestyle="none", marker=marker, color=color, markeredgewidth=1.1, label=label)
        )
    return handles


def _window(rows: pd.DataFrame, last: int) -> pd.DataFrame:
    """Return the frames from the last `last` solved ones on; all unsolved, the last `last` of them."""
    frames = np.unique(numbers(solved(rows), "frame"))
    if len(frames) == 0:
        frames = np.unique(numbers(rows, "frame"))
    keep: NDArray[np.bool_] = numbers(rows, "frame") >= frames[-last:][0]
    return rows.loc[keep]


def _values(ax: Axes, rows: pd.DataFrame) -> None:
    ax.plot(numbers(rows, "frame"), numbers(rows, "truth"), color=GREY, linewidth=0.9, label="true")
    _estimates(ax, rows, METHODS["vmf"])
    ax.margins(y=0.08)
    dress(ax)


def _estimates(ax: Axes, rows: pd.DataFrame, style: MethodStyle) -> None:
    answered = (rows["status"] == "ok").to_numpy()
    estimate = np.where(answered, numbers(rows, "estimate"), np.nan)
    point = style.point | {"markersize": 2.8}
    ax.plot(numbers(rows, "frame"), estimate, **point, linestyle="none", label=style.label)


def _point_handle(style: MethodStyle) -> Artist:
    point = style.point | {"markersize": 2.8}
    return Line2D([], [], linestyle="none", label=f"estimated by {style.label}", **point)


def _value_handles(n_solved: int) -> list[Artist]:
    handles: list[Artist] = [Line2D([], [], color=GREY, linewidth=0.9, label="true")]
    if n_solved:
        handles.append(_point_handle(METHODS["vmf"]))
    return handles
