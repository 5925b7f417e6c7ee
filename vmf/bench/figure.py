"""What a performance figure is: ratios against alternatives that were measured in the same run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from vmf.bench.clock import Floats, Times


class Reading(Enum):
    """What a row's ratio is: ours and the alternative are times, rates or other quantities."""

    FASTER = "times faster"
    SHARE = "of the other"
    GROWTH = "times as much"


@dataclass(frozen=True)
class Row:
    """One ratio.

    Attributes
    ----------
    case : size or setting.
    ours, alternative : what is compared.
    reading : how the ratio reads: the alternative's time by ours, or our quantity by the alternative's.
    ratio, low, high : median over the repeats, and its quartiles.
    repeats : how often both were measured.
    ours_value, alternative_value : medians of what was measured.
    unit : of these.
    extrapolated : whether the alternative was not run at this size; the note says from where it is known.
    note : how it was checked that both did the same, or what was counted.
    """

    case: str
    ours: str
    alternative: str
    reading: Reading
    ratio: float
    low: float
    high: float
    repeats: int
    ours_value: float
    alternative_value: float
    unit: str
    extrapolated: bool = False
    note: str = ""


@dataclass(frozen=True)
class Figure:
    """The rows of one figure.

    Attributes
    ----------
    name : by which it is asked for.
    title : what is compared, in a sentence.
    rows : the ratios.
    notes : what could not be measured here, and why.
    seconds : how long it took to measure them.
    """

    name: str
    title: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True)
class Effort:
    """How much to measure: in full, or quickly in miniature, to see that everything works."""

    quick: bool = False

    @property
    def repeats(self) -> int:
        """How often candidates take their turns."""
        return 3 if self.quick else 7


def faster(
    case: str,
    ours: tuple[str, Times],
    alternative: tuple[str, Times],
    note: str = "",
    *,
    extrapolated: bool = False,
) -> Row:
    """Return a row of two times of the same work, measured in turns."""
    mine, others = ours[1].seconds, alternative[1].seconds
    ratios = others / mine if len(others) == len(mine) else np.median(others) / mine
    row = _row(case, ours[0], alternative[0], Reading.FASTER, ratios, mine, others, "s", note)
    return replace(row, extrapolated=extrapolated)


def quicker(case: str, ours: tuple[str, ArrayLike], alternative: tuple[str, ArrayLike], unit: str) -> Row:
    """Return a row of two rates, measured in turns."""
    mine, others = np.asarray(ours[1], float), np.asarray(alternative[1], float)
    return _row(case, ours[0], alternative[0], Reading.FASTER, mine / others, mine, others, unit, "")


def share(case: str, ours: tuple[str, ArrayLike], of: tuple[str, ArrayLike], unit: str, note: str) -> Row:
    """Return a row of rates that were reached, as a share of rates that the machine reaches."""
    mine, others = np.atleast_1d(np.asarray(ours[1], float)), np.atleast_1d(np.asarray(of[1], float))
    return _row(case, ours[0], of[0], Reading.SHARE, mine / np.median(others), mine, others, unit, note)


def growth(
    case: str, ours: tuple[str, float], alternative: tuple[str, float], unit: str, note: str = ""
) -> Row:
    """Return a row of two quantities that are no times."""
    mine, other = np.array([ours[1]]), np.array([alternative[1]])
    return _row(case, ours[0], alternative[0], Reading.GROWTH, mine / other, mine, other, unit, note)


def _row(
    case: str,
    ours: str,
    alternative: str,
    reading: Reading,
    ratios: Floats,
    ours_values: Floats,
    alternative_values: Floats,
    unit: str,
    note: str,
) -> Row:
    low, middle, high = (float(q) for q in np.quantile(ratios, [0.25, 0.5, 0.75]))
    values = float(np.median(ours_values)), float(np.median(alternative_values))
    return Row(case, ours, alternative, reading, middle, low, high, np.size(ratios), *values, unit, note=note)
