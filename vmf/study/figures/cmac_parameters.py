"""Analytic parameters over a surface, what a CMAC makes of them, and how far it is off (Figs. A.1–A.18)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D

from vmf.report.style import (
    BLUE,
    DOUBLE_IN,
    GREY,
    ORANGE,
    SMALL_PT,
    TEXT_PT,
    VERMILLION,
    dress,
    footnote,
    log_axis,
    new_figure,
    styled,
)
from vmf.spec.studies import CmacParametersStudy
from vmf.study.cmac_parameters import Approximation, Floats, Scene

# Relative errors that the histograms show; those outside are counted in the outermost bins.
_LOW, _HIGH, _BINS = 1e-5, 1e1, 30
_COLORS = {"thesis": VERMILLION, "unit_depth": BLUE}
_GAUGES = {"thesis": "thesis gauge", "unit_depth": "unit-depth gauge"}


@styled
def draw_parameters(
    settings: CmacParametersStudy, scene: Scene, found: Sequence[Approximation], group: Sequence[int]
) -> Figure:
    """Draw up to three parameters, one a row: analytic surface and answers, the CMAC's surface, errors."""
    figure = new_figure(DOUBLE_IN, 0.7 + 2.15 * len(group))
    first = found[0]
    X, Z = _axes(settings)
    for row, k in enumerate(group):
        limits = _limits(first, k - 1)
        for column, (values, title) in enumerate(
            ((first.true_grid, "analytic, dots: CMAC"), (first.found_grid, "CMAC"))
        ):
            ax = figure.add_subplot(
                len(group), 3, 3 * row + column + 1, projection="3d", computed_zorder=False
            )
            assert isinstance(ax, Axes3D)
            _surface(ax, X, Z, values[..., k - 1], limits)
            ax.view_init(elev=30, azim=_azimuth_deg(first.true_grid[..., k - 1]))
            if column == 0:
                ax.scatter(
                    scene.x_m, scene.z_m, first.found[:, k - 1], color=ORANGE, s=4, depthshade=False, zorder=3
                )
            ax.set_title(rf"$\theta_{{{k}}}$ {title}", fontsize=TEXT_PT, y=0.98)
        _histogram(figure.add_subplot(len(group), 3, 3 * row + 3), found, k)
    surface = settings.surface
    footnote(
        figure,
        f"{settings.points:,} training points and {settings.tests} test points of a {surface.width_m:g} m × "
        f"{surface.depth_m:g} m surface at Y = {surface.y_m:g} m, left camera; surfaces and dots in the "
        f"{_GAUGES[first.gauge]}.{_outside(found, group)}",
    )
    return figure


def _outside(found: Sequence[Approximation], group: Sequence[int]) -> str:
    """Say how many errors lie beyond the histograms' ends, nothing if none does."""
    shown = [one.relative_error[:, k - 1] for one in found for k in group if not one.constant[k - 1]]
    errors = np.concatenate([np.empty(0), *shown])
    low, high = int((errors < _LOW).sum()), int((errors > _HIGH).sum())
    if not low and not high:
        return ""
    return (
        f" The histograms' first bins also hold {low:,} errors below {_LOW:g}, "
        f"their last {high:,} above {_HIGH:g}."
    )


def _axes(settings: CmacParametersStudy) -> tuple[Floats, Floats]:
    surface = settings.surface
    share = np.linspace(0.0, 1.0, settings.grid)
    X, Z = np.meshgrid(surface.width_m * (share - 0.5), surface.near_m + surface.depth_m * share)
    return np.asarray(X), np.asarray(Z)


def _limits(one: Approximation, k: int) -> tuple[float, float]:
    values = np.concatenate([one.true_grid[..., k].ravel(), one.found[:, k]])
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    if one.constant[k]:
        pad = max(0.5 * abs(high), 1.0)
        return low - pad, high + pad
    return low, high


def _azimuth_deg(values: Floats) -> float:
    """Return from where a surface (Z, X) is seen to rise, so that none is seen edge-on."""
    up_x, up_z = (float(np.nanmean(values[:, -1] - values[:, 0])), float(np.nanmean(values[-1] - values[0])))
    views = np.array([-55.0, 35.0, 125.0, -145.0])
    away = np.radians(views)
    return float(views[np.argmin(up_x * np.cos(away) + up_z * np.sin(away))])


def _surface(ax: Axes3D, X: Floats, Z: Floats, values: Floats, limits: tuple[float, float]) -> None:
    ax.plot_surface(
        X,
        Z,
        np.ma.masked_invalid(values),
        cmap="viridis",
        vmin=limits[0],
        vmax=limits[1],
        rstride=1,
        cstride=1,
        alpha=0.6,
        linewidth=0,
        antialiased=False,
    )
    ax.set_zlim(*limits)
    ax.set_box_aspect((1.0, 1.0, 0.7), zoom=0.92)
    ax.tick_params(labelsize=SMALL_PT - 1.5, pad=-3, length=2)
    ax.set_xlabel("$X$ (m)", fontsize=SMALL_PT, labelpad=-8)
    ax.set_ylabel("$Z$ (m)", fontsize=SMALL_PT, labelpad=-8)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MaxNLocator(4))


def _histogram(ax: Axes, found: Sequence[Approximation], k: int) -> None:
    dress(ax)
    edges = np.geomspace(_LOW, _HIGH, _BINS + 1)
    exact = []
    for one in found:
        if one.constant[k - 1]:
            exact.append(f"{_GAUGES[one.gauge]}: constant,\nlargest error {one.constant_error[k - 1]:.1g}")
            continue
        errors = np.clip(one.relative_error[:, k - 1], _LOW, _HIGH * (1 - 1e-9))
        ax.hist(
            errors,
            list(edges),
            histtype="stepfilled",
            facecolor=(*to_rgb(_COLORS[one.gauge]), 0.25),
            edgecolor=_COLORS[one.gauge],
            linewidth=1.1,
            label=_GAUGES[one.gauge],
        )
    log_axis(ax.xaxis, (_LOW, _HIGH), max_labels=6)
    ax.set_xlabel("relative |error| (1)")
    ax.set_ylabel("test points")
    if ax.patches:
        ax.set_ylim(top=1.35 * ax.get_ylim()[1])
        ax.legend(loc="upper right", handlelength=1.2, borderaxespad=0.1)
    if len(exact) == len(found):
        ax.set_axis_off()
    if exact:
        ax.text(0.5, 0.5, "\n".join(exact), transform=ax.transAxes, ha="center", va="center", color=GREY)
