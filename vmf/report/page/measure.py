"""Our number for a claim of the thesis, out of what runs left behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vmf.report.page import stable
from vmf.report.page.claims import (
    Answers,
    Condition,
    Direct,
    Ours,
    Points,
    Quantity,
    Ratio,
    Stable,
    StableCondition,
)
from vmf.report.page.runs import Run, Runs
from vmf.report.page.stable import WINDOW, Floats, Ints, first_stable

# What is larger by less may be chance.
_CLEARLY = 1.25

# Who answers: the thesis's own method as printed, our default, and the Cramér–Rao bound.
ROLES = {"thesis": "vmf[thesis]", "default": "vmf", "bound": "cramer_rao"}


@dataclass(frozen=True)
class Value:
    """A measured number.

    Attributes
    ----------
    number : the number; None where the curve never settles, nothing was answered, or the run is too short.
    n : answers behind it, None where they are not counted.
    refused, diverged : questions that were refused, or whose solution diverged, beside these.
    too_short : how many frames the run has, where it is asked about later ones.
    """

    number: float | None
    n: int | None = None
    refused: int = 0
    diverged: int = 0
    too_short: int | None = None

    @property
    def lost(self) -> int:
        """Questions without an answer."""
        return self.refused + self.diverged

    @property
    def share(self) -> float:
        """The share of the questions that were answered."""
        return (self.n or 0) / max((self.n or 0) + self.lost, 1)

    @property
    def mostly_lost(self) -> bool:
        """Whether fewer than half of the questions were answered."""
        return self.n is not None and self.lost > self.n


def measure(ours: Ours | Condition, run: Run | None, runs: Runs, role: str) -> Value | None:
    """Return our number in a role, None where no run says it.

    Parameters
    ----------
    ours : what is asked for.
    run : of the figure's own config, unless the question names another.
    runs : all there are.
    role : `thesis`, `default` or `bound`.
    """
    if isinstance(ours, Ratio):
        if role == "bound":
            return None
        if role != "thesis" and _one_way(ours.over) and _one_way(ours.under):
            return None
        # A rival answers in one role only, and is compared with whatever the other side says.
        over, under = (
            measure(part, run, runs, "thesis" if _one_way(part) else role) for part in (ours.over, ours.under)
        )
        if over is None or under is None:
            return None
        if over.too_short or under.too_short:
            return over if over.too_short else under
        if over.number is None or not under.number:
            return None
        counted = [value for value in (over, under) if value.n is not None]
        # The side that answered the smaller share of its questions says how much the ratio is worth.
        fewer = min(counted, key=lambda value: value.share, default=Value(None))
        return Value(over.number / under.number, fewer.n, fewer.refused, fewer.diverged)
    if ours.config is not None:
        run = runs.newest(ours.config)
    if run is None:
        return None
    if isinstance(ours, Quantity):
        return _quantity(ours, run, role)
    if isinstance(ours, StableCondition):
        return _stable_condition(ours, run) if role == "thesis" else None
    if isinstance(ours, Condition):
        return _condition(ours, run)
    if isinstance(ours, Points):
        return _points(ours, run) if role == "thesis" else None
    if ours.method != "function" and role != "thesis":
        return None
    method = ROLES[role] if ours.method == "function" else ours.method
    # Pixels that come from images have the tracker's noise: of what the spec says there is no bound.
    if role == "bound" and run.settings.get("data.simulate.tracker.kind") is not None:
        return None
    if isinstance(ours, Stable):
        if role == "bound":
            return None
        return _stable(ours, run.answers("trained_code", method, ours.component))
    return _statistic(ours, run.answers(ours.protocol, method, ours.component))


def worse_than_nothing(ours: Ours, run: Run, runs: Runs, role: str) -> bool:
    """Return whether a function's errors behind a number are clearly larger than those of no motion.

    Rivals' may be: how large theirs are is what is claimed of them.
    """
    for part in (ours.over, ours.under) if isinstance(ours, Ratio) else (ours,):
        if isinstance(part, Answers | Stable) and part.method == "function":
            after = part.after if isinstance(part, Answers) else "half"
            mean = Answers(config=part.config, component=part.component, after=after)
            theirs = measure(mean, run, runs, role)
            nothing = measure(mean.model_copy(update={"method": "no_motion"}), run, runs, "thesis")
            if theirs and nothing and (theirs.number or 0.0) > _CLEARLY * (nothing.number or np.inf):
                return True
    return False


def _one_way(ours: Direct) -> bool:
    """Whether there is but one way to do it: no default of ours beside what the thesis did."""
    if isinstance(ours, Answers | Stable):
        return ours.method != "function"
    return not isinstance(ours, Quantity) or ours.default is None


def _statistic(ours: Answers, rows: pd.DataFrame) -> Value | None:
    frames = rows["frame"].to_numpy()
    if not len(frames):
        return None
    last = int(frames.max())
    after = ours.after if isinstance(ours.after, int) else {"half": last // 2, "end": last - 1}[ours.after]
    if after >= last:
        return Value(None, too_short=last)
    rows = rows[frames > after]
    answered = rows[rows["status"] == "ok"]
    error, truth, estimate = (
        answered[name].to_numpy(np.float64) for name in ("abs_error", "truth", "estimate")
    )
    if not len(error):
        return Value(None, 0, *_unanswered(rows))
    if (ours.statistic == "std" and len(error) < 2) or (ours.statistic == "gain" and not truth.any()):
        return None
    number = {
        "mean": lambda: error.mean(),
        "std": lambda: error.std(ddof=1),
        "median": lambda: np.median(error),
        "p95": lambda: np.percentile(error, 95),
        "gain": lambda: np.sum(truth * estimate) / np.sum(truth**2),
    }[ours.statistic]()
    return Value(float(number), len(error), *_unanswered(rows))


def _stable(ours: Stable, rows: pd.DataFrame) -> Value | None:
    if rows.empty:
        return None
    frames, errors, trials = _curve(rows)
    if _ends_before(ours, frames):
        return Value(None, too_short=int(frames.max()))
    found = first_stable(frames, errors, trials)
    # What is refused early on has yet to settle; it is the last half that a curve is held against.
    last = frames > frames.max() / 2
    return Value(found, int(np.isfinite(errors[last]).sum()), *_unanswered(rows[last]))


def _ends_before(ours: Stable | StableCondition, frames: Floats) -> bool:
    """Whether a curve says nothing of a frame, which lies in the half that is taken for its final value."""
    return ours.by is not None and bool(frames.max() < 2 * ours.by)


def strays(ours: Stable, run: Run | None, runs: Runs, role: str, after: float) -> tuple[float, float] | None:
    """Return how far a curve is from its final value at a frame, and at most later; see `stable.strays`.

    Parameters
    ----------
    ours : which curve.
    run, runs, role : as for `measure`.
    after : the frame.
    """
    if ours.config is not None:
        run = runs.newest(ours.config)
    if run is None:
        return None
    method = ROLES[role] if ours.method == "function" else ours.method
    rows = run.answers("trained_code", method, ours.component)
    return None if rows.empty else stable.strays(*_curve(rows), after)


def _curve(rows: pd.DataFrame) -> tuple[Floats, Floats, Ints]:
    """Return frames, errors (NaN where there is no answer) and trials (n,) of all questions."""
    frames, errors = (rows[name].to_numpy(float) for name in ("frame", "abs_error"))
    answered = (rows["status"] == "ok").to_numpy(bool)
    return frames, np.where(answered, errors, np.nan), rows["trial"].to_numpy(np.int64)


def _unanswered(rows: pd.DataFrame) -> tuple[int, int]:
    """Return how many questions were refused, and how many diverged."""
    status = rows["status"]
    refused = int((status == "refused").sum())
    return refused, int((status != "ok").sum()) - refused


def _stable_condition(ours: StableCondition, run: Run) -> Value | None:
    table = run.condition()
    if table is None or table.empty:
        return None
    frames = table["frame"].to_numpy(float)
    if _ends_before(ours, frames):
        return Value(None, too_short=int(frames.max()))
    found = first_stable(frames, table["median"].to_numpy(float))
    return Value(found, int(table["n"].max()))


def _condition(ours: Condition, run: Run) -> Value | None:
    table = run.condition()
    if table is None or table.empty or (isinstance(ours.after, str) and ours.after != "half"):
        return None
    last = int(table["frame"].max())
    begin, end = (last // 2 + 1, last) if isinstance(ours.after, str) else (ours.after, ours.after * WINDOW)
    rows = table[(table["frame"] >= begin) & (table["frame"] <= end)]
    return None if rows.empty else Value(float(rows["median"].mean()), int(rows["n"].max()))


def _points(ours: Points, run: Run) -> Value | None:
    table = run.points()
    if table is None:
        return None
    rows = table[table["component"] == ours.component]
    return None if rows.empty else Value(float(rows[ours.statistic].iloc[0]), int(rows["n"].iloc[0]))


def _quantity(ours: Quantity, run: Run, role: str) -> Value | None:
    if run.quantities is None or role == "bound" or (role == "default" and ours.default is None):
        return None
    case = ours.default if role == "default" and ours.default is not None else ours.case
    table = run.quantities
    wanted = {"quantity": ours.quantity, "case": case, "component": ours.component}
    for column, value in wanted.items():
        table = table[table[column].astype(str) == value]
    if len(table) != 1:
        return None
    row = table.iloc[0]
    if pd.isna(row["value"]):
        return Value(None, 0)
    return Value(float(row["value"]), None if pd.isna(row["n"]) else int(row["n"]))
