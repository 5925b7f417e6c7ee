"""True against estimated motion, frame by frame (Figs. 5.4, 5.10, 5.13–5.15)."""

from __future__ import annotations

from typing import Any

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
    REFERENCES,
    VERMILLION,
    MethodStyle,
    dress,
    heading,
    message_figure,
    method_styles,
    split_method,
    styled,
)
from vmf.report.tables import (
    check,
    components,
    counted,
    numbers,
    select,
    solved,
    status_counts,
)

LOST_MARKERS = {"refused": ("x", VERMILLION), "diverged": ("+", BLACK)}


@styled
def truth_vs_estimate(errors: pd.DataFrame, trial: int = 0, last: int = 80) -> Figure:
    """Draw the true (line) and estimated (markers) value of each component in the last frames asked.

    Rivals have open markers. The legend counts what everyone answered within these frames.
    """
    check(errors)
    rows = vmf_curve(errors, trial)
    parts = components(rows)
    if not parts:
        return message_figure(f"No frame of trial {trial} was asked of the trained code.")
    rows = _window(rows, last)
    frames = np.unique(numbers(rows, "frame"))
    theirs = beside(errors, trial)
    shown = theirs[numbers(theirs, "frame") >= frames[0]]
    looks = {
        other: style if is_function(other) else style.open
        for other, style in method_styles(theirs["method"].unique()).items()
    }
    panels = frame_panels(parts)
    for part in parts:
        ax = panels.axes[part.name]
        one = select(rows, component=part.name).drop_duplicates("frame", keep="last")
        _values(ax, one)
        for other, look in looks.items():
            _estimates(ax, select(shown, component=part.name, method=other), look)
        mark_lost(ax, one)
        ax.set_ylabel(f"{part.label} ({part.unit})")
    frame_axis(list(panels.axes.values()), frames)
    one = select(rows, component=parts[0].name).drop_duplicates("frame", keep="last")
    handles: list[Artist] = [Line2D([], [], color=GREY, linewidth=0.9, label="true")]
    handles.append(_estimate_handle(METHODS["vmf"], one))
    for other, look in looks.items():
        handles.append(_estimate_handle(look, select(shown, component=parts[0].name, method=other)))
    heading(panels.figure, f"Trained code, trial {trial}: {_said(frames)}", [*handles, *lost_handles(one)])
    return panels.figure


def _said(frames: NDArray[np.float64]) -> str:
    """Say which frames are shown, and whether those between them were asked, too."""
    n, span = len(frames), f"from {frames[0]:,.0f} to {frames[-1]:,.0f}"
    if n == 1:
        return f"the last frame asked, {frames[0]:,.0f}"
    every = n == frames[-1] - frames[0] + 1
    return f"the last {n:,} frames, {span}" if every else f"the last {n:,} frames asked, {span}"


def vmf_curve(errors: pd.DataFrame, trial: int) -> pd.DataFrame:
    """Return the rows of one trial in which vmf was asked the trained code, in order of frames."""
    rows = select(errors, protocol="trained_code", method="vmf", trial=trial)
    return rows.sort_values("frame", kind="stable")


def beside(errors: pd.DataFrame, trial: int) -> pd.DataFrame:
    """Return the same of who answered beside vmf: functions that learned with it, `vmf[name]`, and rivals."""
    rows = select(errors, protocol="trained_code", trial=trial)
    others = (~rows["method"].isin(["vmf", *REFERENCES])).to_numpy(dtype=bool)
    return rows.loc[others].sort_values("frame", kind="stable")


def is_function(method: str) -> bool:
    """Whether a method has learned, and is no rival."""
    return split_method(method)[0] == "vmf"


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
    """Return a legend entry with the count of each way in which a frame had no answer of vmf."""
    handles: list[Artist] = []
    for status, n in status_counts(rows).items():
        if status == "ok":
            continue
        marker, color = LOST_MARKERS.get(status, ("|", GREY))
        label = f"vmf {status} ({n:,} of {len(rows):,} frames)"
        handles.append(
            Line2D([], [], linestyle="none", marker=marker, color=color, markeredgewidth=1.1, label=label)
        )
    return handles


def _window(rows: pd.DataFrame, last: int) -> pd.DataFrame:
    """Return the last `last` frames asked; if none of them was solved, those from as many solved ones on."""
    frames = np.unique(numbers(rows, "frame"))
    answered = np.unique(numbers(solved(rows), "frame"))
    if len(answered) and answered[-1] < frames[-last:][0]:
        frames = answered
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
    # What is open lies below and hides nothing.
    ax.plot(
        numbers(rows, "frame"),
        estimate,
        **_point(style),
        linestyle="none",
        zorder=2.0 if style.filled else 1.8,
        label=style.label,
    )


def _point(style: MethodStyle) -> dict[str, Any]:
    if style.filled:
        return style.point | {"markersize": 2.8}
    return style.point | {"markersize": 2.4, "markeredgewidth": 0.6, "markerfacecolor": "none"}


def _estimate_handle(style: MethodStyle, rows: pd.DataFrame) -> Artist:
    """Return a method's legend entry with what it answered; what has no point has none there either."""
    if rows.empty:
        return Line2D([], [], linestyle="none", label=f"{style.label}: not asked in these frames")
    counts = status_counts(rows)
    if not counts["ok"]:
        return Line2D([], [], linestyle="none", label=f"{style.label}: no point, solved {counted(counts)}")
    return Line2D([], [], linestyle="none", label=f"{style.label}: solved {counted(counts)}", **_point(style))
