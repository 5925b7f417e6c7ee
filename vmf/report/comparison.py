"""The visuomotor function beside its rivals: distributions of the absolute error."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vmf.report.rows import Row, build_rows, row_panels, write_column
from vmf.report.style import (
    METHODS,
    MethodStyle,
    footnote,
    heading,
    log_axis,
    log_limits,
    message_figure,
    method_styles,
    styled,
)
from vmf.report.tables import (
    BELOW_BOUND,
    PROTOCOLS,
    Component,
    case_label,
    check,
    components,
    count_sentence,
    methods,
    numbers,
    select,
    shown_cases,
    solved,
    status_counts,
    strings,
)

Floats = NDArray[np.float64]
POINTS_BELOW = 10
REFERENCES = {
    "cramer_rao": "Dashed line: median that the Cramér–Rao bound allows.",
    "no_motion": "Dotted line: median of no motion.",
}
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@styled
def comparison(errors: pd.DataFrame, protocol: str) -> Figure:
    """Draw the distribution of |error| of every method per component, with what was answered and what not."""
    check(errors)
    asked = select(errors, protocol=protocol)
    name = PROTOCOLS.get(protocol, protocol)
    all_cases = strings(asked["case"])
    cases = shown_cases(all_cases)
    asked = asked.loc[asked["case"].isin(cases).to_numpy()]
    parts = components(asked)
    if not parts:
        return message_figure(f"Nothing was asked under the {name} protocol.")
    answers = solved(asked)
    if answers.empty:
        return message_figure(
            f"{name.capitalize()}: nothing was answered: {count_sentence(asked, methods(asked))}."
        )
    looks = method_styles(str(m) for m in asked["method"].unique())
    rows = build_rows(
        [(c, case_label(c)) for c in cases], {c: methods(select(asked, case=c)) for c in cases}, looks
    )
    figure, axes, ends = row_panels(parts, rows)
    for part in parts:
        _panel(axes[part.name], part, select(answers, component=part.name), rows, looks)
    for ax in ends:
        _write_counts(ax, asked, rows)
    heading(figure, _title(name, cases, all_cases))
    footnote(figure, _note(answers))
    return figure


def _note(answers: pd.DataFrame) -> str:
    note = ["Marker: median. Thick bar: middle half. Thin bar: 5 % to 95 %, the tick at 95 %."]
    sizes = answers.groupby(["case", "method", "component"], observed=True).size()
    if int(sizes.min()) < POINTS_BELOW:
        note.append(f"Fewer than {POINTS_BELOW} answers: one tick each.")
    for method, line in REFERENCES.items():
        if bool((answers["method"] == method).any()):
            note.append(line)
    trained = bool((answers["protocol"] == "trained_code").any())
    if trained and bool((answers["method"] == "cramer_rao").any()):
        note.append(BELOW_BOUND)
    return " ".join(note)


def _title(name: str, cases: list[str], all_cases: list[str]) -> str:
    only = f", {case_label(cases[0])}" if len(cases) == 1 and cases[0] else ""
    hidden = [c for c in all_cases if c not in cases]
    if only and hidden:
        only += f", the last of {len(all_cases)}"
    elif hidden:
        only += f" ({len(hidden)} other cases not shown)"
    return name.capitalize() + only


def _panel(
    ax: Axes, part: Component, answers: pd.DataFrame, rows: list[Row], looks: dict[str, MethodStyle]
) -> None:
    limits = log_limits(_extent(answers), pad=0.06)
    ax.set_title(part.label)
    ax.set_xlabel(f"|error| ({part.unit})")
    if limits is None:
        ax.set_xticks([])
        ax.text(0.5, 0.5, "no answer", transform=ax.transAxes, ha="center", va="center")
        return
    for row in rows:
        if row.method:
            values = numbers(select(answers, case=row.case, method=row.method), "abs_error")
            _strip(ax, row, np.maximum(values, limits[0]), looks[row.method])
    _reference(ax, answers, rows)
    log_axis(ax.xaxis, limits, max_labels=4)


def _extent(answers: pd.DataFrame) -> Floats:
    """Return the 5 % and 95 % quantiles of each strip (all values of a short one): what must be in view."""
    ends = [np.empty(0)]
    for _, group in answers.groupby(["case", "method"], observed=True):
        values = numbers(group, "abs_error")
        ends.append(
            values if len(values) < POINTS_BELOW else np.quantile(values, [QUANTILES[0], QUANTILES[-1]])
        )
    return np.concatenate(ends)


def _strip(ax: Axes, row: Row, values: Floats, look: MethodStyle) -> None:
    if len(values) == 0:
        return
    y, color = row.y, look.color
    point = look.point | {"marker": look.marker or "d", "markersize": 4.6, "zorder": 4}
    if len(values) < POINTS_BELOW:
        ax.plot(values, np.full(len(values), y), linestyle="none", color=color, marker="|", markersize=6)
        ax.plot([float(np.median(values))], [y], linestyle="none", label=_label(row), **point)
        return
    low, quarter, median, three_quarters, high = np.quantile(values, QUANTILES)
    ax.plot([low, high], [y, y], color=color, linewidth=1.0, solid_capstyle="butt")
    ax.plot([quarter, three_quarters], [y, y], color=color, linewidth=4.6, alpha=0.45, solid_capstyle="butt")
    ax.plot([high], [y], linestyle="none", marker="|", color=color, markersize=6.5, markeredgewidth=1.1)
    ax.plot([median], [y], linestyle="none", label=_label(row), **point)


def _label(row: Row) -> str:
    return f"{row.case}:{row.method}"


def _reference(ax: Axes, answers: pd.DataFrame, rows: list[Row]) -> None:
    """Draw the medians between which answers are of use: the bound's and that of no motion."""
    for case in dict.fromkeys(row.case for row in rows):
        ys = [row.y for row in rows if row.case == case and row.method]
        for method in REFERENCES:
            values = numbers(select(answers, case=case, method=method), "abs_error")
            if len(values):
                look = METHODS[method]
                ax.vlines(
                    float(np.median(values)),
                    min(ys) - 0.5,
                    max(ys),
                    color=look.color,
                    linestyle=look.linestyle,
                    linewidth=0.8,
                    zorder=1.5,
                )


def _write_counts(ax: Axes, asked: pd.DataFrame, rows: list[Row]) -> None:
    counts = {row: _counts(select(asked, case=row.case, method=row.method)) for row in rows if row.method}
    statuses = list(dict.fromkeys(["ok", "refused", *(s for c in counts.values() for s in c)]))
    offset = 0.0
    for status in statuses:
        heading = "answers" if status == "ok" else status
        offset += max(36.0, 4.6 * len(heading) + 5)
        write_column(ax, offset, heading, [(row.y, c.get(status, "0")) for row, c in counts.items()])


def _counts(rows: pd.DataFrame) -> dict[str, str]:
    """Return how often each status came, as a range where the components differ."""
    each = [status_counts(group) for _, group in rows.groupby("component", observed=True)]
    statuses = dict.fromkeys(s for counts in each for s in counts)
    texts = {}
    for status in statuses:
        seen = [counts.get(status, 0) for counts in each]
        texts[status] = f"{min(seen):,}" if min(seen) == max(seen) else f"{min(seen):,}–{max(seen):,}"
    return texts
