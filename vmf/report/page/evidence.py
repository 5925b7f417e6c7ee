"""What a number would be under other assumptions: the sweep over what the thesis leaves open."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vmf.report.page.claims import UNKNOWNS, Axis, Claim, Ratio
from vmf.report.page.measure import Value, measure
from vmf.report.page.numbers import printed
from vmf.report.page.runs import Run, Runs
from vmf.report.page.verdict import Verdict, verdict


@dataclass(frozen=True)
class Evidence:
    """Our number over all points of a sweep.

    Attributes
    ----------
    points : how many there are at which at least half of the questions were answered.
    low, high : its least and its greatest value.
    nearest : that nearest to the thesis, by ratio, of those that reproduce it if any do.
    at : under which assumptions that is.
    within : the points that reproduce it.
    """

    points: int
    low: float
    high: float
    nearest: float
    at: str
    within: frozenset[Path]


def evidence(claim: Claim, axes: Sequence[Axis], swept: Sequence[Run], runs: Runs) -> Evidence | None:
    """Return what the sweep over the unknown says of a claim with a number, None where it says nothing.

    Parameters
    ----------
    claim : which.
    axes : what is varied.
    swept : the points of the sweep.
    runs : all there are; where a claim is about another experiment, too, a point is held against that of the
        other's sweep with the same assumptions.
    """
    if claim.thesis is None:
        return None
    found: list[tuple[float, Run]] = []
    for run in swept:
        value = measure(claim.ours, run, _alike(claim, run, axes, runs), "thesis")
        if value is None or value.mostly_lost:
            continue
        if value.number is not None and value.number > 0:
            found.append((value.number, run))
    if not found:
        return None
    thesis = claim.thesis
    numbers = [number for number, _ in found]
    agree = [verdict(claim, Value(number)) is Verdict.REPRODUCED for number in numbers]
    within = frozenset(one.path for (_, one), agrees in zip(found, agree, strict=True) if agrees)
    # Where a bound is asked for, what keeps it may be far away from it.
    at_best = [pair for pair, agrees in zip(found, agree, strict=True) if agrees] or found
    nearest, run = min(at_best, key=lambda pair: abs(math.log(pair[0] / thesis)))
    at = settings(run, axes)
    return Evidence(len(found), min(numbers), max(numbers), nearest, at, within)


def _alike(claim: Claim, run: Run, axes: Sequence[Axis], runs: Runs) -> Runs:
    """Return, for every other experiment of a claim, the points of its own sweep with a run's assumptions.

    What that experiment is under its usual assumptions says nothing about a point of this one's sweep.
    """
    parts = (claim.ours.over, claim.ours.under) if isinstance(claim.ours, Ratio) else (claim.ours,)
    return Runs(
        tuple(
            replace(other, name=config)
            for config in dict.fromkeys(part.config for part in parts if part.config is not None)
            for other in runs.named(f"{config}{UNKNOWNS}")
            if all(other.settings.get(axis.key) == run.settings.get(axis.key) for axis in axes)
        )
    )


def settings(run: Run, axes: Sequence[Axis]) -> str:
    """Return the assumptions of a run in words: `targets from 1 m, angles up to 0.6 rad`."""
    said = []
    for axis in axes:
        value = run.settings.get(axis.key)
        if isinstance(value, int | float):
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
            said.append(f"{axis.name} {reach} {axis.unit}".rstrip())
    return "; ".join(said)
