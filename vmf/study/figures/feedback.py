"""The Lyapunov function over time, and the paths of targets in the image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from vmf.report.style import (
    BLACK,
    BLUE,
    DOUBLE_IN,
    GREEN,
    GREY,
    SMALL_PT,
    TEXT_PT,
    VERMILLION,
    dress,
    footnote,
    heading,
    log_axis,
    log_limits,
    new_figure,
    styled,
)
from vmf.spec.studies import FeedbackStudy

if TYPE_CHECKING:
    from vmf.study.feedback import Runs

_COLORS = (GREEN, BLUE, VERMILLION)
_FLOOR = 1e-12


@styled
def draw_lyapunov(settings: FeedbackStudy, done: Mapping[tuple[str, float], Runs]) -> Figure:
    """Draw V over its first value for every start: sources of parameters in columns, noises in rows."""
    sources, noises = settings.sources, settings.pixel_px
    figure = new_figure(DOUBLE_IN, 0.9 + 2.1 * len(noises))
    time = None
    gains = settings.gains_per_s
    colors = [_COLORS[k % len(_COLORS)] for k in range(len(gains))]
    for row, noise_px in enumerate(noises):
        V = {source: _lyapunov(done[source, noise_px]) for source in sources}
        limits = log_limits(np.concatenate([v.ravel() for v in V.values()]))
        for column, source in enumerate(sources):
            ax = figure.add_subplot(len(noises), len(sources), row * len(sources) + column + 1)
            dress(ax)
            runs = done[source, noise_px]
            time = np.arange(len(runs.error_px)) / settings.rate_hz
            for gain, color in zip(gains, colors, strict=True):
                mine = V[source][:, runs.gain == gain]
                ax.plot(time, mine, color=color, linewidth=0.4, alpha=0.45)
                ax.plot(time, np.exp(-2 * gain * time), color=BLACK, linewidth=0.9, linestyle=(0, (3, 2)))
            if limits is not None:
                log_axis(ax.yaxis, limits, max_labels=6)
            ax.set_xlim(0.0, time[-1])
            if row == 0:
                ax.set_title(f"{source} parameters", fontsize=TEXT_PT)
            if row == len(noises) - 1:
                ax.set_xlabel("time (s)")
            if column == 0:
                noise = "exact images" if noise_px == 0.0 else f"{noise_px:g} px in images"
                ax.set_ylabel(f"V / V(0), {noise} (1)")
    handles = [Line2D([], [], color=c, label=f"λ = {g:g} / s") for g, c in zip(gains, colors, strict=True)]
    handles.append(Line2D([], [], color=BLACK, linestyle=(0, (3, 2)), label="exp(−2λt)"))
    heading(figure, "Lyapunov function V = ½ ‖s* − s‖²", handles)
    footnote(
        figure,
        f"{settings.starts} random starts within {settings.travel_m:g} m and {settings.turn_rad:g} rad on "
        f"each axis, {settings.targets} targets, {settings.rate_hz:g} Hz; learned from images with "
        f"{settings.training.pixel_px:g} px of noise.",
    )
    return figure


def _lyapunov(runs: Runs) -> NDArray[np.float64]:
    """Return V over its first value (T + 1, Q), NaN where it is rounding."""
    V = np.square(runs.error_px / runs.error_px[0])
    return np.where(V > _FLOOR, V, np.nan)


@styled
def draw_paths(settings: FeedbackStudy, done: Mapping[tuple[str, float], Runs]) -> Figure:
    """Draw the targets' paths in the left image from the first start, for every source of parameters."""
    sources, noise_px = settings.sources, settings.pixel_px[0]
    width, height = settings.rig.width_px, settings.rig.height_px
    figure = new_figure(DOUBLE_IN, 0.7 + DOUBLE_IN / len(sources) * height / width)
    for place, source in enumerate(sources, start=1):
        ax = figure.add_subplot(1, len(sources), place)
        dress(ax, grid="none")
        paths = done[source, noise_px].pixels[:, 0, :, :2]
        for k in range(paths.shape[1]):
            ax.plot(*paths[:, k].T, color=BLUE, linewidth=1.1)
            ax.plot(*paths[0, k], color=BLUE, marker="o", markersize=4, markerfacecolor="white")
            ax.plot(*done[source, noise_px].pixels[-1, 0, k, :2], color=VERMILLION, marker="x", markersize=5)
        ax.add_patch(Rectangle((-0.5, -0.5), width, height, fill=False, edgecolor=GREY, linewidth=0.8))
        ax.set_xlim(-0.03 * width, 1.03 * width)
        ax.set_ylim(1.03 * height, -0.03 * height)
        ax.set_aspect("equal")
        ax.tick_params(labelsize=SMALL_PT)
        ax.set_title(f"{source} parameters", fontsize=TEXT_PT)
        ax.set_xlabel("$x_L$ (px)")
        if place == 1:
            ax.set_ylabel("$y_L$ (px)")
    footnote(
        figure, f"From the first start (open) to where it ended (cross), λ = {settings.gains_per_s[0]:g} / s."
    )
    return figure
