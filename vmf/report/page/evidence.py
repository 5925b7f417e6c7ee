"""What a number would be under other assumptions: the sweep over what the thesis leaves open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vmf.report.page.claims import UNKNOWNS, Answers, Axis, Claim, Found, Stable, StableCondition
from vmf.report.page.measure import Value, measure, worse_than_nothing
from vmf.report.page.numbers import printed
from vmf.report.page.runs import Cut, Run, Runs
from vmf.report.page.verdict import Verdict, verdict

# Parts of the usual run that are held beside a sweep of fewer trials.
_MOST_PARTS = 20
# That all points of a sweep are on one side of a number says something from so many on.
_FEWEST_POINTS = 3


@dataclass(frozen=True)
class Point:
    """Our number at a point of a sweep.

    Attributes
    ----------
    run : the point.
    value : the number by the thesis's method, None where no run says it.
    given : whether it differs in nothing but what the thesis leaves open.
    at : its assumptions in words.
    worse : whether errors behind the number are larger than those of no motion: it says nothing then.
    """

    run: Run
    value: Value | None
    given: bool
    at: str
    worse: bool = False


@dataclass(frozen=True)
class Baseline:
    """Our number under the usual assumptions, with as few frames and trials as the sweep has.

    Attributes
    ----------
    numbers : over parts of the run with so many trials, of those in which there is one.
    never : whether there are parts in which there is none.
    reaches : whether a part reproduces it, or the thesis's number lies between two of them.
    """

    numbers: tuple[float, ...]
    never: bool
    reaches: bool


@dataclass(frozen=True)
class Evidence:
    """Our number over all points of a sweep.

    Attributes
    ----------
    points : how many there are at which at least half of the questions were answered, and errors are not
        larger than those of no motion.
    low, high : its least and its greatest value.
    nearest : that nearest to the thesis, by ratio, of those that reproduce it if any do.
    at : under which assumptions that is.
    within : the points that reproduce it, of these.
    between : assumptions of the nearest points on both sides of the thesis's number; empty if it has but one.
    baseline : what the sweep is held against, None where less effort cannot change the number.
    """

    points: int
    low: float
    high: float
    nearest: float
    at: str
    within: frozenset[Path]
    between: str = ""
    baseline: Baseline | None = None

    @property
    def found(self) -> Found:
        """What it says of the number; points that are next to none say nothing."""
        if not self.within and not self.between:
            return "misses" if self.points >= _FEWEST_POINTS else "none"
        if self.baseline is not None and self.baseline.reaches:
            return "effort"
        return "reaches" if self.within else "brackets"


@dataclass(frozen=True)
class Answering:
    """Where in a sweep most of the questions behind a number are answered.

    Attributes
    ----------
    share : of the questions, in percent.
    at : under which assumptions.
    least : the share where fewest are.
    """

    share: float
    at: str
    least: float


def measured(claim: Claim, axes: Sequence[Axis], swept: Sequence[Run], runs: Runs) -> tuple[Point, ...]:
    """Return our number for a claim at every point of the sweep; none if it is in words alone.

    Parameters
    ----------
    claim : which.
    axes : what is varied.
    swept : the points of the sweep.
    runs : all there are; where a claim is about another experiment, too, a point is held against that of the
        other's sweep with the same assumptions.
    """
    if claim.thesis is None:
        return ()
    found = []
    for run in swept:
        others = _alike(claim, run, axes, runs)
        found.append(
            Point(
                run,
                measure(claim.ours, run, others, "thesis"),
                as_given(run, axes),
                settings(run, axes),
                worse_than_nothing(claim.ours, run, others, "thesis"),
            )
        )
    return tuple(found)


def evidence(claim: Claim, points: Sequence[Point], runs: Runs, usual: Run | None = None) -> Evidence | None:
    """Return what the sweep over the unknown says of a claim with a number, None where it says nothing.

    Parameters
    ----------
    claim : which.
    points : of the sweep.
    runs : all there are.
    usual : the run with the usual assumptions, against which the sweep is held.
    """
    if claim.thesis is None:
        return None
    found: list[tuple[float, Point]] = []
    for point in points:
        value = point.value
        if not point.given or point.worse or value is None or value.mostly_lost:
            continue
        if value.number is not None and value.number > 0:
            found.append((value.number, point))
    if not found:
        return None
    thesis = claim.thesis
    numbers = [number for number, _ in found]
    within = [pair for pair in found if _reproduces(claim, pair[0])]
    # Where a bound is asked for, what keeps it may be far away from it.
    nearest, best = min(within or found, key=lambda pair: abs(math.log(pair[0] / thesis)))
    below = max((pair for pair in found if pair[0] < thesis), key=_number, default=None)
    above = min((pair for pair in found if pair[0] > thesis), key=_number, default=None)
    between = " and ".join(pair[1].at for pair in (below, above) if pair)
    return Evidence(
        len(found),
        min(numbers),
        max(numbers),
        nearest,
        best.at,
        frozenset(point.run.path for _, point in within),
        between if below and above else "",
        None if usual is None else _baseline(claim, usual, best.run, runs),
    )


def _reproduces(claim: Claim, number: float) -> bool:
    return verdict(claim, Value(number)) is Verdict.REPRODUCED


def _number(pair: tuple[float, Point]) -> float:
    return pair[0]


def as_given(run: Run, axes: Sequence[Axis]) -> bool:
    """Return whether a point of a sweep differs in nothing but what the thesis leaves open."""
    return all(axis.given in (None, run.settings.get(axis.key)) for axis in axes)


def answering(points: Sequence[Point], elsewhere: bool) -> Answering | None:
    """Return where most questions are answered, as the thesis gives it or `elsewhere`; None if nowhere."""
    shares: dict[str, float] = {}
    for point in points:
        value = point.value
        if value is not None and value.n is not None and point.given != elsewhere:
            shares[point.at] = 100.0 * value.share
    most = max(shares, key=lambda at: shares[at], default=None)
    return None if most is None else Answering(shares[most], most, min(shares.values()))


def _baseline(claim: Claim, usual: Run, point: Run, runs: Runs) -> Baseline | None:
    """Return a number under the usual assumptions over parts of the run as short as a point of the sweep."""
    if not all(isinstance(part, Answers | Stable | StableCondition) for part in claim.parts):
        return None
    whole = measure(claim.ours, usual, runs, "thesis")
    if usual.trials is None or not point.trials or whole is None or whole.mostly_lost:
        return None
    others = {
        config: (other, next(iter(runs.named(f"{config}{UNKNOWNS}")), point))
        for config in claim.elsewhere
        if (other := runs.newest(config)) is not None
    }
    # Condition numbers are over all trials.
    number = 1 if isinstance(claim.ours, StableCondition) else max(usual.trials // point.trials, 1)
    found: list[Value] = []
    for part in range(min(number, _MOST_PARTS)):
        cut = Runs(tuple(_cut(other, its, part) for other, its in others.values()))
        value = measure(claim.ours, _cut(usual, point, part), cut, "thesis")
        # Early questions that are refused are many in a run that is cut, where more were asked early on.
        if value is not None and not value.too_short:
            found.append(value)
    if not found or claim.thesis is None:
        return None
    numbers = tuple(value.number for value in found if value.number is not None)
    reproduced = any(_reproduces(claim, number) for number in numbers)
    both = any(number < claim.thesis for number in numbers) and any(n > claim.thesis for n in numbers)
    return Baseline(numbers, len(numbers) < len(found), reproduced or both)


def _cut(run: Run, point: Run, part: int) -> Run:
    trials = point.trials or 1
    frames = point.frames or run.frames or 1
    return replace(run, cut=Cut(frames, range(part * trials, (part + 1) * trials)))


def _alike(claim: Claim, run: Run, axes: Sequence[Axis], runs: Runs) -> Runs:
    """Return, for every other experiment of a claim, the points of its own sweep with a run's assumptions.

    What that experiment is under its usual assumptions says nothing about a point of this one's sweep.
    """
    return Runs(
        tuple(
            replace(other, name=config)
            for config in claim.elsewhere
            for other in runs.named(f"{config}{UNKNOWNS}")
            if all(other.settings.get(axis.key) == run.settings.get(axis.key) for axis in axes)
        )
    )


def settings(run: Run, axes: Sequence[Axis]) -> str:
    """Return the assumptions of a run in words, without what is as the thesis says: `targets from 1 m`."""
    said = []
    for axis in axes:
        value = run.settings.get(axis.key)
        if isinstance(value, int | float) and value != axis.given:
            said.append(f"{axis.name} {printed(value)}\u00a0{axis.unit}".rstrip())
    return ", ".join(said)


def span(runs: Sequence[Run], axes: Sequence[Axis]) -> str:
    """Return what a sweep varies, in words: `targets from 0.5 to 4 m; angles up to 0.3 to 1 rad`."""
    said = []
    for axis in axes:
        values = [v for run in runs if isinstance(v := run.settings.get(axis.key), int | float)]
        if values:
            low, high = printed(min(values)), printed(max(values))
            reach = low if low == high else f"{low} … {high}"
            given = "" if axis.given is None else f" (the thesis has {printed(axis.given)})"
            said.append(f"{axis.name} {reach} {axis.unit}".rstrip() + given)
    return "; ".join(said)
