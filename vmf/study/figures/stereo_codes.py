"""What pairs of pixels see of the plane (Figs. 4.1–4.3), and which codes are visible."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from vmf.report.style import (
    BLUE,
    DOUBLE_IN,
    GREY,
    INK,
    SMALL_PT,
    TEXT_PT,
    VERMILLION,
    dress,
    footnote,
    new_figure,
    styled,
)
from vmf.spec.studies import StereoCodesStudy
from vmf.study.stereo_codes import Floats, LinePixels, line_pixels, visible_region

Seen = Mapping[str, NDArray[np.bool_]]

# Of the drawing, so that a label does not hide its region.
_LEAST_AREA = 0.004
# Smaller regions have smaller labels, that neighbours' do not overlap.
_ROOMY_AREA = 0.0072


@styled
def draw_rigs(settings: StereoCodesStudy, seen: Seen) -> Figure:
    """Draw for every rig which regions of the plane share a stereo code."""
    n = len(settings.rigs)
    figure = new_figure(DOUBLE_IN, 0.75 + 0.95 * DOUBLE_IN / n)
    depth = settings.view_m
    view = np.array(
        [[-depth / 2, -0.12 * depth], [depth / 2, -0.12 * depth], [depth / 2, depth], [-depth / 2, depth]]
    )
    for place, rig in enumerate(settings.rigs, start=1):
        ax = figure.add_subplot(1, n, place)
        dress(ax, grid="none")
        left, right = line_pixels(rig, settings)
        _regions(ax, left, right, seen[rig.name], view)
        for pixels, color, dash in ((left, BLUE, "-"), (right, VERMILLION, (0, (4, 2)))):
            for edge in pixels.edges:
                far = pixels.centre + 3 * depth * edge
                ax.plot(*zip(pixels.centre, far, strict=True), color=color, linewidth=0.8, linestyle=dash)
            ax.plot(*pixels.centre, marker="o", color=color, markersize=5, zorder=5)
        ax.set_xlim(view[0, 0], view[1, 0])
        ax.set_ylim(view[0, 1], view[2, 1])
        ax.set_aspect("equal")
        ax.set_xlabel("$x$ (m)")
        if place == 1:
            ax.set_ylabel("$z$ (m)")
        count, total = int(seen[rig.name].sum()), seen[rig.name].size
        ax.set_title(f"{rig.name}: {count} of {total} codes", fontsize=TEXT_PT)
    footnote(
        figure,
        f"1×{settings.pixels} cameras, left (solid) and right (dashed). All points of a region share one "
        "stereo code; regions too small for a number, or out of the picture, have none.",
    )
    return figure


def _regions(ax: Axes, left: LinePixels, right: LinePixels, seen: NDArray[np.bool_], view: Floats) -> None:
    whole = _area(view)
    for number, (i, j) in enumerate(np.argwhere(seen), start=1):
        corners = visible_region(left, right, int(i), int(j), view)
        if len(corners) < 3:
            continue
        ax.add_patch(Polygon(corners, facecolor=_color(i, j, len(seen)), linewidth=0))
        if _area(corners) > _LEAST_AREA * whole:
            x, z = corners.mean(axis=0)
            size = (SMALL_PT - 1) * min(1.0, float(np.sqrt(_area(corners) / (_ROOMY_AREA * whole))))
            ax.text(x, z, str(number), ha="center", va="center", fontsize=size, color=INK)


def _color(i: int, j: int, n: int) -> tuple[float, ...]:
    """Return a light colour for code (i, j): hue by the left pixel, lightness by the right one."""
    hue = np.array(colormaps["viridis"]((i + 0.5) / n)[:3])
    light = 0.35 + 0.4 * (j + 0.5) / n
    return tuple(hue * (1 - light) + light * np.array(to_rgb("white")))


def _area(corners: Floats) -> float:
    x, y = corners.T
    return float(abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2)


@styled
def draw_codes(settings: StereoCodesStudy, seen: Seen) -> Figure:
    """Draw for every rig the table of codes, with those that are visible filled."""
    n = len(settings.rigs)
    figure = new_figure(DOUBLE_IN, 0.95 + 0.85 * DOUBLE_IN / n)
    for place, rig in enumerate(settings.rigs, start=1):
        ax = figure.add_subplot(1, n, place)
        dress(ax, grid="none")
        codes = seen[rig.name]
        colors = np.ones((*codes.shape, 3))
        for i, j in np.argwhere(codes):
            colors[j, i] = _color(i, j, len(codes))
        ax.imshow(colors, origin="lower", extent=(-0.5, len(codes) - 0.5, -0.5, len(codes) - 0.5))
        for edge in range(len(codes) + 1):
            ax.axhline(edge - 0.5, color=GREY, linewidth=0.4)
            ax.axvline(edge - 0.5, color=GREY, linewidth=0.4)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_locator(MaxNLocator(integer=True))
        ax.set_xlabel("left pixel (px)")
        if place == 1:
            ax.set_ylabel("right pixel (px)")
        ax.set_title(f"{rig.name}: {100 * codes.mean():.3g} % of the codes", fontsize=TEXT_PT)
    footnote(figure, "Filled: some points of the plane have this code. White: no point ever has it.")
    return figure
