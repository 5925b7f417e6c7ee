"""What the figures ask of the tidy error table: its components, cases, counts and errors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.report.style import method_styles, natural_key

Floats = NDArray[np.float64]

COLUMNS = (
    "trial",
    "frame",
    "protocol",
    "method",
    "component",
    "unit",
    "case",
    "truth",
    "estimate",
    "abs_error",
    "status",
)
PROTOCOLS = {"trained_code": "trained code", "held_out": "held-out"}
MAX_CASES = 3
# With little learned, the one view asked about weighs much in it.
BELOW_BOUND = "The view asked about, pose and all, is one of those learned from: vmf can lie below the bound."

_LABELS = {
    "pan": "pan",
    "tilt": "tilt",
    "heading": "heading",
    "rot_x": "rotation x",
    "rot_y": "rotation y",
    "rot_z": "rotation z",
    "angle": "angle",
    "t_x": "translation x",
    "t_y": "translation y",
    "t_z": "translation z",
    "distance": "distance",
}


@dataclass(frozen=True)
class Component:
    """One component of the motion: its name in the table, its name for readers and its unit."""

    name: str
    label: str
    unit: str


def check(errors: pd.DataFrame) -> None:
    """Raise ValueError when the table lacks a column."""
    missing = [c for c in COLUMNS if c not in errors.columns]
    if missing:
        raise ValueError(f"the error table lacks {', '.join(missing)}; it has {', '.join(errors.columns)}")


def select(errors: pd.DataFrame, **values: object) -> pd.DataFrame:
    """Return the rows in which every named column has the given value."""
    keep = np.ones(len(errors), dtype=bool)
    for column, value in values.items():
        keep &= (errors[column] == value).to_numpy(dtype=bool)
    return errors.loc[keep]


def components(errors: pd.DataFrame) -> tuple[Component, ...]:
    """Return the components in the order of the tables, without those the task never moves.

    A pan-tilt unit has no distance and a pure translation no angle: truth and error are zero in every row,
    which a logarithmic axis cannot show and a reader need not see.
    """
    found: list[Component] = []
    for name, rows in errors.groupby("component", observed=True, sort=False):
        key = str(name)
        if not _never_moves(rows):
            found.append(Component(key, _LABELS.get(key, key), str(rows["unit"].iloc[0])))
    order = list(_LABELS)
    return tuple(sorted(found, key=lambda c: order.index(c.name) if c.name in order else len(order)))


def _never_moves(rows: pd.DataFrame) -> bool:
    truth, error = numbers(rows, "truth"), numbers(rows, "abs_error")
    still = bool(np.all(np.abs(truth[np.isfinite(truth)]) < 1e-9)) and bool(np.isfinite(truth).any())
    return still and bool(np.all(error[np.isfinite(error)] < 1e-6))


def mean_bound(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the table with the bound's |error| of each question replaced by its mean over all noise.

    A line in a plot then shows the bound and not the chance of its draw; a table without the means stays.
    """
    if "expected_error" not in errors.columns:
        return errors
    bound = (errors["method"] == "cramer_rao").to_numpy(dtype=bool)
    return errors.assign(abs_error=errors["abs_error"].where(~bound, errors["expected_error"]))


def numbers(rows: pd.DataFrame, column: str) -> Floats:
    """Return a column as floats."""
    return rows[column].to_numpy(dtype=np.float64, na_value=np.nan)


def solved(errors: pd.DataFrame) -> pd.DataFrame:
    """Return the rows that hold an answer."""
    return errors.loc[((errors["status"] == "ok") & np.isfinite(numbers(errors, "abs_error"))).to_numpy()]


def methods(errors: pd.DataFrame) -> list[str]:
    """Return the methods of the table in drawing order."""
    return list(method_styles(str(m) for m in errors["method"].unique()))


def strings(column: pd.Series) -> list[str]:
    """Return the distinct values of a column as strings, numbers within them in numeric order."""
    return sorted({str(v) for v in column.unique()}, key=natural_key)


def shown_cases(cases: Iterable[str]) -> list[str]:
    """Return the cases a figure has room for: the last of the learning frames, and a few of the tests.

    Every `frame=…` is the same question asked earlier, so the most trained answer stands for all of them.
    """
    ordered = sorted(set(cases), key=natural_key)
    frames = [c for c in ordered if c.startswith("frame=")]
    tests = [c for c in ordered if not c.startswith("frame")]
    if len(tests) > MAX_CASES:
        picks = np.linspace(0, len(tests) - 1, MAX_CASES).round().astype(int)
        tests = [tests[i] for i in picks]
    return tests + frames[-1:]


def case_label(case: str) -> str:
    """Return `gap = 5` for `gap=5`."""
    return case.replace("=", " = ")


def status_counts(rows: pd.DataFrame) -> dict[str, int]:
    """Return how many rows ended each way, `ok` first, of any one component."""
    counts = {str(k): int(v) for k, v in rows["status"].value_counts().items() if v}
    return {"ok": counts.pop("ok", 0), **dict(sorted(counts.items(), key=lambda kv: _status_order(kv[0])))}


def _status_order(status: str) -> tuple[bool, bool, str]:
    return status != "refused", status != "diverged", status


def count_sentence(rows: pd.DataFrame, names: Sequence[str]) -> str:
    """Return `vmf 44 of 45 (1 refused), PnP 45 of 45`: the denominators of what is drawn."""
    styles = method_styles(str(m) for m in rows["method"].unique())
    parts = []
    for method in names:
        one = select(rows, method=method)
        first = one.loc[(one["component"] == one["component"].iloc[0]).to_numpy()]
        parts.append(f"{styles[method].label} {counted(status_counts(first))}")
    return "; ".join(parts)


def counted(counts: dict[str, int]) -> str:
    """Return `44 of 45 (1 refused)`."""
    lost = ", ".join(f"{n:,} {status}" for status, n in counts.items() if status != "ok")
    return f"{counts['ok']:,} of {sum(counts.values()):,}" + (f" ({lost})" if lost else "")


def trial_numbers(rows: pd.DataFrame) -> list[int]:
    """Return the trials of the table in order."""
    return sorted(int(cast(int, t)) for t in rows["trial"].unique())
