"""Tables of the page, as text that is ready to be shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import pandas as pd

from vmf.report.page.numbers import short
from vmf.report.page.runs import Run
from vmf.report.style import method_styles, natural_key


@dataclass(frozen=True)
class Table:
    """A table: what it says, its head, and its rows; the first column names the row."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def summary_tables(run: Run) -> tuple[Table, ...]:
    """Return mean (median) |error| by method for every protocol and case, the last of each protocol first."""
    if run.summary is None:
        return ()
    listed = run.summary[~run.summary["method"].isin(run.record.get("swept", ()))]
    first: list[Table] = []
    others: list[Table] = []
    for protocol in listed["protocol"].unique():
        part = listed[listed["protocol"] == protocol]
        cases = sorted(map(str, part["case"].unique()), key=natural_key, reverse=True)
        of_case = [_of_case(part[part["case"] == case], str(protocol), case) for case in cases]
        first += of_case[:1]
        others += of_case[1:]
    return (*first, *others)


def _of_case(part: pd.DataFrame, protocol: str, case: str) -> Table:
    names = part[["component", "unit"]].drop_duplicates().itertuples(index=False)
    parts = [(str(name), str(unit)) for name, unit in names]
    rows = []
    for method in method_styles(part["method"].unique()):
        mine = part[part["method"] == method].set_index("component")
        errors = [_mean_median(mine, name) for name, _ in parts]
        counts = [short(float(mine[column].iloc[0])) for column in ("n", "n_refused", "n_diverged")]
        rows.append((method, *errors, *counts))
    head = ("method", *(f"{name} ({unit})" for name, unit in parts), "n", "refused", "diverged")
    question = protocol.replace("_", " ")
    return Table(f"Mean (median) absolute error, {question}, {case}", head, tuple(rows))


def _mean_median(mine: pd.DataFrame, component: str) -> str:
    if component not in mine.index:
        return "–"
    mean, median = (float(mine[column][component]) for column in ("mean", "median"))
    return f"{short(mean)} ({short(median)})"


def quantities_table(run: Run) -> Table | None:
    """Return a study's numbers as a table."""
    if run.quantities is None:
        return None
    rows = []
    for row in run.quantities.to_dict("records"):
        text = [str(row[key]) for key in ("quantity", "case", "component", "unit")]
        low, high = row["ci_low"], row["ci_high"]
        interval = "" if pd.isna(low) else f"{short(float(low))} … {short(float(high))}"
        count = "" if pd.isna(row["n"]) else short(float(row["n"]))
        unit = "" if text[3] == "1" else text[3]
        rows.append((*text[:3], unit, short(float(row["value"])), count, interval))
    head = ("quantity", "case", "component", "unit", "value", "n", "95 % interval")
    return Table("All numbers of this study", head, tuple(rows))


def frame_table(caption: str, table: pd.DataFrame) -> Table:
    """Return any table as it is shown."""
    rows = [tuple(_cell(value) for value in row) for row in table.itertuples(index=False)]
    return Table(caption, tuple(map(str, table.columns)), tuple(rows))


def _cell(value: object) -> str:
    if value is None or value != value:
        return "–"
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return short(float(cast(float, value))) if is_number else str(value)


def count_words(counts: Sequence[tuple[int, str]]) -> str:
    """Return `3 reproduced, 2 better`, without what there is none of."""
    return ", ".join(f"{n} {word}" for n, word in counts if n)
