"""Where reconstruction with a calibration error falls behind the learned function, which has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator
from numpy.typing import NDArray

from vmf.report.panels import log_error_axis
from vmf.report.style import (
    DOUBLE_IN,
    INK,
    METHODS,
    SINGLE_IN,
    SMALL_PT,
    MethodStyle,
    dress,
    footnote,
    heading,
    log_limits,
    message_figure,
    method_handle,
    method_styles,
    new_figure,
    styled,
)
from vmf.report.tables import Component, case_label, components, numbers, select, shown_cases, strings

Floats = NDArray[np.float64]

KINDS = {
    "focal": "focal length",
    "principal": "principal point",
    "rotation": "rotation",
    "baseline": "baseline",
}
ROW_IN = 1.62


@styled
def calibration_crossover(curves: pd.DataFrame, crossovers: pd.DataFrame) -> Figure:
    """Draw each rival's median |error| against one kind of calibration error a panel, beside vmf's.

    Parameters
    ----------
    curves : medians with intervals: of each rival at its magnitudes, of `vmf` and the bound at NaN.
    crossovers : from which magnitude on each rival is behind, NaN where it is not within those asked.
    """
    answered = curves.loc[(curves["n"] > 0).to_numpy()]
    if answered.empty:
        return message_figure("Calibration errors: nothing was answered by vmf and a rival both.")
    kinds = [kind for kind in KINDS if (answered["kind"] == kind).any()]
    cases = shown_cases(strings(answered["case"]))
    rows = [(case, part) for case in cases for part in _parts(select(answered, case=case))]
    width = DOUBLE_IN if len(kinds) > 2 else SINGLE_IN
    figure = new_figure(width, len(rows) * ROW_IN + 1.0)
    grid = figure.add_gridspec(len(rows), len(kinds))
    looks = method_styles(str(m) for m in answered["rival"].unique())
    for line, (case, part) in enumerate(rows):
        of_row = select(answered, case=case, component=part.name)
        limits = log_limits(np.concatenate([numbers(of_row, c) for c in ("median", "ci_low", "ci_high")]))
        for column, kind in enumerate(kinds):
            ax = figure.add_subplot(grid[line, column])
            dress(ax)
            ends = select(crossovers, case=case, component=part.name, kind=kind)
            _panel(ax, select(of_row, kind=kind), ends, looks)
            log_error_axis(ax, np.empty(0), limits)
            ax.tick_params(labelleft=column == 0, labelbottom=line == len(rows) - 1)
            if column == 0:
                where = f"{case_label(case)}: " if len(cases) > 1 else ""
                ax.set_ylabel(f"{where}{part.label}\nmedian |error| ({part.unit})")
            if line == len(rows) - 1:
                unit = str(select(answered, kind=kind)["unit"].iloc[0])
                ax.set_xlabel(f"{KINDS[kind]} off by ({'°' if unit == 'deg' else unit})")
    figure.align_ylabels()
    drawn = [replace(METHODS["vmf"], marker=""), *looks.values()]
    if bool((answered["method"] == "cramer_rao").any()):
        drawn.append(METHODS["cramer_rao"])
    title = "Held-out: where reconstruction with one calibration error falls behind vmf"
    heading(figure, title, [method_handle(look) for look in drawn])
    footnote(figure, _note(answered))
    return figure


def _parts(curves: pd.DataFrame) -> tuple[Component, ...]:
    columns = {"component_unit": "unit", "median": "abs_error"}
    return components(curves.drop(columns="unit").rename(columns=columns).assign(truth=np.nan))


def _note(answered: pd.DataFrame) -> str:
    sizes = answered["n"]
    n = f"{sizes.min():,}" if sizes.min() == sizes.max() else f"{sizes.min():,} to {sizes.max():,}"
    return (
        f"Medians over the same {n} questions, bands: 95 % intervals. Vertical line and words: the error "
        "from which on reconstruction is behind, in brackets its 95 % interval."
    )


def _panel(ax: Axes, curves: pd.DataFrame, ends: pd.DataFrame, looks: dict[str, MethodStyle]) -> None:
    magnitudes = np.unique(numbers(curves, "magnitude"))
    magnitudes = magnitudes[np.isfinite(magnitudes)]
    for number, (rival, look) in enumerate(looks.items()):
        mine = select(curves, rival=rival)
        if mine.empty:
            continue
        if not ax.lines:
            _level(ax, select(mine, method="vmf"), METHODS["vmf"], band=True)
            _level(ax, select(mine, method="cramer_rao"), METHODS["cramer_rao"], band=False)
        own = select(mine, method=rival).sort_values("magnitude")
        x = numbers(own, "magnitude")
        ax.fill_between(
            x,
            numbers(own, "ci_low"),
            numbers(own, "ci_high"),
            color=look.color,
            alpha=0.16,
            linewidth=0,
            label=f"band:{rival}",
        )
        ax.plot(x, numbers(own, "median"), **look.line, label=rival, zorder=4)
        end = select(ends, method=rival)
        where = float(numbers(end, "crossover")[0])
        if np.isfinite(where):
            ax.axvline(where, color=look.color, linewidth=0.9, linestyle=(0, (1, 1)), label=f"end:{rival}")
        ax.annotate(
            _sentence(end),
            xy=(0.0, 1.0),
            xycoords="axes fraction",
            xytext=(0, 3 + 9 * (len(looks) - 1 - number)),
            textcoords="offset points",
            fontsize=SMALL_PT,
            color=look.color if len(looks) > 1 else INK,
        )
    _magnitude_axis(ax, magnitudes)


def _sentence(end: pd.DataFrame) -> str:
    """Return from where on a rival is behind and the interval of that, in the fewest words."""
    unit = "°" if end["unit"].iloc[0] == "deg" else f" {end['unit'].iloc[0]}"
    largest, *values = (float(numbers(end, c)[0]) for c in ("largest", "crossover", "ci_low", "ci_high"))
    where, low, high = (f"{v:.2g}" if np.isfinite(v) else f">{largest:g}" for v in values)
    if not np.isfinite(values[0]):
        return f"not up to {largest:g}{unit}"
    return f"from {where}{unit} [{low}, {high}]"


def _level(ax: Axes, row: pd.DataFrame, look: MethodStyle, band: bool) -> None:
    for middle, low, high in zip(*(numbers(row, c) for c in ("median", "ci_low", "ci_high")), strict=True):
        ax.axhline(middle, color=look.color, linestyle=look.linestyle, linewidth=1.3, zorder=3)
        if band:
            ax.axhspan(low, high, color=look.color, alpha=0.18, linewidth=0)


def _magnitude_axis(ax: Axes, magnitudes: Floats) -> None:
    """Make x logarithmic from the first error on, with exact cameras one step before it."""
    first, last = float(magnitudes[min(1, len(magnitudes) - 1)]), float(magnitudes[-1])
    ax.set_xscale("symlog", linthresh=first, linscale=0.5)
    ax.set_xlim(-0.12 * first, 1.12 * last)
    ax.xaxis.set_major_locator(FixedLocator(magnitudes.tolist()))
    ax.xaxis.set_major_formatter(FixedFormatter([f"{m:g}".replace("0.", ".") for m in magnitudes]))
    ax.xaxis.set_minor_locator(NullLocator())
