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
    numbers,
    select,
    solved,
    status_counts,
)

LOST_MARKERS = {"refused": ("x", VERMILLION), "diverged": ("+", BLACK)}


@styled
def truth_vs_estimate(errors: pd.DataFrame, trial: int = 0, last: int = 80) -> Figure:
    """Draw the true (line) and estimated (markers) value of each component in the last solved frames.

    Rivals have open markers.
    """
    check(errors)
    rows = vmf_curve(errors, trial)
    parts = components(rows)
    if not parts:
        return message_figure(f"No frame of trial {trial} was asked of the trained code.")
    rows = _window(rows, last)
    shown = beside(errors, trial)
    shown = shown[numbers(shown, "frame") >= numbers(rows, "frame").min(initial=np.inf)]
    others = method_styles(shown["method"].unique())
    panels = frame_panels(parts)
    for part in parts:
        ax = panels.axes[part.name]
        one = select(rows, component=part.name).drop_duplicates("frame", keep="last")
        _values(ax, one)
        for other, style in others.items():
            answers = select(shown, component=part.name, method=other)
            _estimates(ax, answers, style if is_function(other) else style.open)
        mark_lost(ax, one)
        ax.set_ylabel(f"{part.label} ({part.unit})")
    frame_axis(list(panels.axes.values()), np.unique(numbers(rows, "frame")))
    one = select(rows, component=parts[0].name).drop_duplicates("frame", keep="last")
    n_frames, n_solved = len(one), status_counts(one)["ok"]
    text = f"Trained code, trial {trial}: {n_solved} of the last {n_frames} frames asked were solved"
    theirs = [_point_handle(look if is_function(other) else look.open) for other, look in others.items()]
    heading(panels.figure, text, [*_value_handles(n_solved), *theirs, *lost_handles(one)])
    return panels.figure


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


def _point_handle(style: MethodStyle) -> Artist:
    return Line2D([], [], linestyle="none", label=f"estimated by {style.label}", **_point(style))


def _value_handles(n_solved: int) -> list[Artist]:
    handles: list[Artist] = [Line2D([], [], color=GREY, linewidth=0.9, label="true")]
    if n_solved:
        handles.append(_point_handle(METHODS["vmf"]))
    return handles
