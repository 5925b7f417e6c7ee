"""What a performance figure is: ratios against alternatives that were measured in the same run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from vmf.bench.clock import Times


class Reading(Enum):
    """How a row's ratio reads."""

    FASTER = "times faster"
    SHARE = "of"
    GROWTH = "times"


@dataclass(frozen=True)
class Row:
    """One ratio.

    Attributes
    ----------
    case : size or setting.
    ours, alternative : what is compared.
    reading : `FASTER` is the alternative's time by ours, or our rate by the alternative's; `SHARE` and `GROWTH`
        are our value by the alternative's.
    ratio, low, high : median over the repeats, and its quartiles.
    repeats : how often both were measured; 1 for what is too long or needs no repetition.
    ours_value, alternative_value : medians of what was measured, in `unit`.
    extrapolated : the ratio goes beyond what was run; the row's note says from where.
    note : how it was checked that both did the same, or from what it was extrapolated.
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
    seconds : how long it took to measure.
    """

    name: str
    title: str
    rows: tuple[Row, ...]
    seconds: float = 0.0


@dataclass(frozen=True)
class Effort:
    """How much to measure.

    Attributes
    ----------
    quick : miniature sizes, to see that everything works.
    repeats : of interleaved measurements.
    """

    quick: bool = False

    @property
    def repeats(self) -> int:
        """How often interleaved candidates take their turns."""
        return 3 if self.quick else 7


def faster(
    case: str, ours: tuple[str, Times], alternative: tuple[str, Times], note: str = "", per: float = 1.0
) -> Row:
    """Return a row of two times of the same work, measured in turns.

    Parameters
    ----------
    case : size or setting.
    ours, alternative : names and times.
    note : how the work was checked to be the same.
    per : pieces of work in each; values are stated for one.
    """
    times = ours[1].seconds / per, alternative[1].seconds / per
    ratios = times[1] / times[0]
    return _row(case, ours[0], alternative[0], Reading.FASTER, ratios, times[0], times[1], "s", note)


def share(case: str, ours: tuple[str, Sequence[float]], of: tuple[str, float], unit: str, note: str) -> Row:
    """Return a row of rates reached, as a share of one that the machine reaches."""
    rates = np.array(ours[1])
    return _row(case, ours[0], of[0], Reading.SHARE, rates / of[1], rates, np.array([of[1]]), unit, note)


def growth(
    case: str, ours: tuple[str, float], alternative: tuple[str, float], unit: str, note: str = ""
) -> Row:
    """Return a row of two quantities that are no times: ours by the alternative's."""
    values = np.array([ours[1]]), np.array([alternative[1]])
    return _row(case, ours[0], alternative[0], Reading.GROWTH, values[0] / values[1], *values, unit, note)


def _row(
    case: str,
    ours: str,
    alternative: str,
    reading: Reading,
    ratios: np.ndarray[tuple[int], np.dtype[np.float64]],
    ours_values: np.ndarray[tuple[int], np.dtype[np.float64]],
    alternative_values: np.ndarray[tuple[int], np.dtype[np.float64]],
    unit: str,
    note: str,
) -> Row:
    low, middle, high = (float(q) for q in np.quantile(ratios, [0.25, 0.5, 0.75]))
    values = float(np.median(ours_values)), float(np.median(alternative_values))
    return Row(case, ours, alternative, reading, middle, low, high, len(ratios), *values, unit, note=note)
