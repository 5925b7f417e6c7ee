"""Forest plot of the paired differences rival − vmf with their 95 % intervals."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from vmf.report.rows import Row, build_rows, row_panels, write_column
from vmf.report.style import (
    INK,
    MethodStyle,
    footnote,
    heading,
    message_figure,
    method_styles,
    styled,
)
from vmf.report.tables import (
    PROTOCOLS,
    Component,
    case_label,
    components,
    methods,
    numbers,
    shown_cases,
    strings,
)

Floats = NDArray[np.float64]
COLUMNS = ("protocol", "case", "method", "component", "unit", "n", "mean_difference", "ci_low", "ci_high")
WIDE = 40.0


@styled
def paired_differences(paired: pd.DataFrame) -> Figure:
    """Draw each rival's paired difference to vmf with its 95 % interval; right of zero vmf is better."""
    missing = [c for c in COLUMNS if c not in paired.columns]
    if missing:
        raise ValueError(f"the table of paired differences lacks {', '.join(missing)}")
    rivals = paired["method"].astype(str) != "no_motion"
    known = paired.loc[np.isfinite(numbers(paired, "mean_difference")) & rivals.to_numpy()]
    shown = known.assign(group=known["protocol"].astype(str) + "|" + known["case"].astype(str))
    groups = _groups(known)
    shown = shown.loc[shown["group"].isin([g for g, _ in groups]).to_numpy()]
    if shown.empty:
        return message_figure("No question was answered by vmf and a rival both: no paired difference.")
    looks = method_styles(str(m) for m in shown["method"].unique())
    by_group = {g: methods(shown.loc[(shown["group"] == g).to_numpy()]) for g, _ in groups}
    rows = build_rows(groups, by_group, looks)
    # A component the task never moves differs by nothing, as it errs by nothing.
    parts = components(shown.assign(truth=0.0, abs_error=shown["mean_difference"].abs()))
    figure, axes, ends = row_panels(parts, rows)
    bent = False
    for part in parts:
        one = shown.loc[(shown["component"] == part.name).to_numpy()]
        bent |= _panel(axes[part.name], part, one, rows, looks)
    for ax in ends:
        write_column(ax, 30.0, "pairs", [(r.y, _pairs(shown, r)) for r in rows if r.method])
    only = f" ({groups[0][1]})" if len(groups) == 1 else ""
    heading(figure, f"Paired difference of |error|, rival − vmf, mean with 95 % interval{only}")
    note = "Filled: the interval excludes zero. Open: it does not. Arrows: who is better on that side."
    if bent:
        note += " Axes without a tick inside are linear near zero and logarithmic beyond."
    footnote(figure, note)
    return figure


def _groups(paired: pd.DataFrame) -> list[tuple[str, str]]:
    groups = []
    for protocol in strings(paired["protocol"])[::-1]:
        rows = paired.loc[(paired["protocol"] == protocol).to_numpy()]
        for case in shown_cases(strings(rows["case"])):
            heading = PROTOCOLS.get(protocol, protocol) + (f", {case_label(case)}" if case else "")
            groups.append((f"{protocol}|{case}", heading))
    return groups


def _pairs(shown: pd.DataFrame, row: Row) -> str:
    n = numbers(_of(shown, row), "n")
    return f"{n.min():,.0f}" if n.min() == n.max() else f"{n.min():,.0f}–{n.max():,.0f}"


def _of(rows: pd.DataFrame, row: Row) -> pd.DataFrame:
    return rows.loc[((rows["group"] == row.case) & (rows["method"] == row.method)).to_numpy()]


def _panel(
    ax: Axes, part: Component, paired: pd.DataFrame, rows: list[Row], looks: dict[str, MethodStyle]
) -> bool:
    for row in rows:
        one = _of(paired, row)
        if row.method and len(one):
            mean, low, high = (float(numbers(one, c)[0]) for c in ("mean_difference", "ci_low", "ci_high"))
            _interval(ax, row, (mean, low, high), looks[row.method])
    ax.axvline(0.0, color=INK, linewidth=0.8, zorder=1)
    bent = _scale(ax, *(numbers(paired, c) for c in ("mean_difference", "ci_low", "ci_high")))
    for x, side, text in ((0.0, "left", "← rival"), (1.0, "right", "vmf →")):
        ax.text(x, 1.01, text, transform=ax.transAxes, ha=side, va="bottom", fontsize=6.0, color=INK)
    ax.set_title(part.label, pad=13)
    ax.set_xlabel(f"rival − vmf ({part.unit})")
    return bent


def _interval(ax: Axes, row: Row, values: tuple[float, float, float], look: MethodStyle) -> None:
    mean, low, high = values
    certain = low > 0 or high < 0
    face = look.color if certain else "white"
    ax.plot([low, high], [row.y, row.y], color=look.color, linewidth=1.3, solid_capstyle="butt")
    point = look.point | {"marker": look.marker or "d", "markersize": 4.6, "markerfacecolor": face}
    ax.plot([mean], [row.y], linestyle="none", label=f"{row.case}:{row.method}", zorder=4, **point)


def _scale(ax: Axes, means: Floats, lows: Floats, highs: Floats) -> bool:
    """Choose a linear axis or, when one rival is far worse than another, a symmetric log one: True."""
    values = np.stack([means, lows, highs])
    values = np.where(np.isfinite(values), values, 0.0)
    reach = np.abs(values).max(axis=0, initial=0.0)
    largest = float(reach.max(initial=0.0)) or 1.0
    smallest = max(float(reach[reach > 0].min(initial=largest)), 1e-4 * largest)
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    if largest / smallest < WIDE:
        pad = 0.08 * (high - low) or 1.0
        ax.set_xlim(low - pad, high + pad)
        ax.xaxis.set_major_locator(MaxNLocator(3))
        ax.xaxis.set_major_formatter(lambda value, _: f"{value:.6g}".replace("-", "−"))
        return False
    first = math.floor(math.log10(smallest))
    least = 10.0**first
    ax.set_xscale("symlog", linthresh=least, linscale=1.0)
    ax.set_xlim(min(1.6 * low, -0.5 * least), max(1.6 * high, 0.5 * least))
    powers = range(first, math.ceil(math.log10(largest)) + 1)
    left = [-(10.0**p) for p in reversed(powers) if -(10.0**p) >= 1.6 * low]
    right = [10.0**p for p in powers if 10.0**p <= 1.6 * high]
    # A narrow panel has room for the outermost power on each side.
    ticks = [*left[:1], 0.0, *right[-1:]]
    ax.xaxis.set_major_locator(FixedLocator(ticks))
    ax.xaxis.set_major_formatter(FixedFormatter([_signed_power(t) for t in ticks]))
    ax.xaxis.set_minor_locator(NullLocator())
    return True


def _signed_power(value: float) -> str:
    """Label a power of ten; zero has its line and would collide with the ticks beside it."""
    if value == 0.0:
        return ""
    sign = "-" if value < 0 else ""
    return rf"${sign}10^{{{round(math.log10(abs(value)))}}}$"
