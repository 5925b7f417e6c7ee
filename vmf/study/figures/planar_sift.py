"""What a base saw and where it drove (Figs. 5.52 and 5.53)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import ConnectionPatch
from numpy.typing import NDArray

from vmf.report.style import (
    BLACK,
    DOUBLE_IN,
    GREY,
    INK,
    SINGLE_IN,
    TEXT_PT,
    VERMILLION,
    MethodStyle,
    dress,
    footnote,
    heading,
    method_styles,
    new_figure,
    styled,
)
from vmf.spec.studies import PlanarSiftStudy
from vmf.study.planar_sift import Run, Snapshot

Floats = NDArray[np.float64]

_THIN = {"marker": "", "linewidth": 1.2}
_EXACT = MethodStyle("exact command", BLACK, (0, (1, 1.2)), "", linewidth=0.9)


@styled
def draw_matches(settings: PlanarSiftStudy, views: tuple[Snapshot, Snapshot, Snapshot | None]) -> Figure:
    """Draw the features that the initial view, and that on arrival, share with the desired one."""
    initial, desired, final = views
    pairs = [("initial view", initial)] + ([("on arrival (vmf)", final)] if final is not None else [])
    height, width = desired.image.shape[:2]
    figure = new_figure(DOUBLE_IN, 0.6 + len(pairs) * (0.3 + DOUBLE_IN / 2 * height / width))
    for row, (name, view) in enumerate(pairs):
        left, right = (figure.add_subplot(len(pairs), 2, 2 * row + k) for k in (1, 2))
        matched = view.matches(desired, settings.ratio)
        _picture(left, view, f"{name}: {len(matched)} matches")
        _picture(right, desired, "desired view")
        for i, j in matched.tolist():
            a, b = view.codes[i, :2], desired.codes[j, :2]
            left.plot(*a, marker="o", markersize=3, color=VERMILLION, markerfacecolor="none")
            right.plot(*b, marker="o", markersize=3, color=VERMILLION, markerfacecolor="none")
            ends = (float(a[0]), float(a[1])), (float(b[0]), float(b[1]))
            line = ConnectionPatch(*ends, "data", "data", axesA=left, axesB=right, color=VERMILLION)
            line.set_linewidth(0.4)
            line.set_alpha(0.7)
            figure.add_artist(line)
    footnote(figure, "Left images of the first run; features matched in both cameras.")
    return figure


def _picture(ax: Axes, view: Snapshot, title: str) -> None:
    ax.imshow(view.image, interpolation="nearest")
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(title, fontsize=TEXT_PT, loc="left", color=INK)


@styled
def draw_paths(settings: PlanarSiftStudy, way: Floats, runs: Sequence[Run]) -> Figure:
    """Draw the training's way, and of each run the start, the ways driven and the desired place."""
    figure = new_figure(DOUBLE_IN, 3.3)
    tour, driven = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    looks = _looks(runs)
    dress(tour)
    tour.plot(*_on_paper(way), color=GREY, linewidth=0.6)
    tour.set_title("training, driven by hand", loc="left", color=INK)
    dress(driven)
    driven.set_title("first run: true ways", loc="left", color=INK)
    for run in [run for run in runs if run.number == 0]:
        if run.parking is None:
            continue
        style = looks[run.method]
        driven.plot(*_on_paper(run.parking.true), label=run.method, **(style.line | _THIN))
        _arrow(driven, run.parking.true[-1], style.color)
        _arrow(driven, run.parking.true[0], BLACK)
    first = runs[0]
    driven.plot(*_on_paper(first.goal), marker="s", markersize=7, color=VERMILLION, linestyle="none")
    _arrow(driven, first.goal, VERMILLION)
    x, y = (side / 2 + 0.3 for side in settings.area_m)
    for ax in (tour, driven):
        ax.set_aspect("equal")
        ax.set_xlim(y, -y)
        ax.set_ylim(-x, x)
        ax.set_xlabel("$y$, to the left (m)")
        ax.set_ylabel("$x$, ahead (m)")
    handles = [Line2D([], [], linestyle="none", marker="s", color=VERMILLION, label="desired")]
    driving = {run.method for run in runs if run.number == 0 and run.parking is not None}
    handles += [Line2D([], [], label=s.label, **(s.line | _THIN)) for m, s in looks.items() if m in driving]
    handles += [_not_driven(style.label) for method, style in looks.items() if method not in driving]
    heading(figure, "The base from above; arrows: where it looks", handles)
    stop = f"{100 * settings.stop_m:g} cm and {settings.stop_rad:g} rad"
    footnote(figure, f"Driven by odometry, which drifts, until it is within {stop} of the command.")
    return figure


@styled
def draw_seen(runs: Sequence[Run]) -> Figure:
    """Draw how many features match the desired view on the way there."""
    figure = new_figure(SINGLE_IN, 2.6)
    ax = figure.add_subplot()
    dress(ax)
    looks = _looks(runs)
    drawn = [run for run in runs if len(run.seen)]
    for run in drawn:
        style = looks[run.method]
        # The base turns away at first: one point after the other, not sorted by distance.
        ax.plot(run.seen[:, 0], run.seen[:, 1], **(style.line | {"marker": ".", "linewidth": 0.9}))
    ax.invert_xaxis()
    ax.set_ylim(bottom=0)
    ax.set_xlabel("distance left to the desired place (m)")
    ax.set_ylabel("matches with the desired view")
    handles = [Line2D([], [], label=looks[r.method].label, **looks[r.method].line) for r in drawn]
    heading(figure, "First run", handles)
    return figure


def _not_driven(label: str) -> Line2D:
    """Return the legend entry of a function without a way: it had no command for the first run."""
    return Line2D([], [], linestyle="none", label=f"{label}: not driven, no command")


def _looks(runs: Sequence[Run]) -> dict[str, MethodStyle]:
    names = dict.fromkeys(run.method for run in runs)
    styles = method_styles(name for name in names if name != "exact")
    return {**styles, "exact": _EXACT}


def _on_paper(T: Floats) -> tuple[Floats, Floats]:
    """Return y and x (…,) of poses (…, 4, 4): ahead is up."""
    return T[..., 1, 3], T[..., 0, 3]


def _arrow(ax: Axes, T: Floats, color: str) -> None:
    y, x = _on_paper(T)
    ax.annotate(
        "",
        xy=(y + 0.35 * T[1, 0], x + 0.35 * T[0, 0]),
        xytext=(y, x),
        arrowprops={"arrowstyle": "->", "color": color, "linewidth": 1.0},
    )
