"""What a study hands back: numbers with a name and a unit, tables, and figures that are not drawn yet."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.errors import Loss

if TYPE_CHECKING:
    # Slow to load, and only drawing needs it.
    from matplotlib.figure import Figure

QUANTITIES = ("quantity", "case", "component", "unit", "value", "n", "ci_low", "ci_high")

Drawing = Callable[[], "Figure"]


@dataclass(frozen=True)
class Quantity:
    """One number.

    Attributes
    ----------
    quantity : what it is.
    value : how much, in `unit` (1 for a ratio or a count).
    case : of which rig, method, or setting, empty if there is but one.
    component : of which of several numbers of the same sort, such as `theta_1`.
    unit : px, m, rad, 1.
    n : how many samples it stands for.
    ci_low, ci_high : its 95 % interval.
    """

    quantity: str
    value: float
    case: str = ""
    component: str = ""
    unit: str = "1"
    n: int | None = None
    ci_low: float | None = None
    ci_high: float | None = None


@dataclass(frozen=True)
class StudyResult:
    """Everything that a study found.

    Attributes
    ----------
    quantities : content of `quantities.csv`.
    tables : further tables by name.
    drawings : figures by name, each drawn when called.
    notes : what a reader has to know beside them.
    losses : what was to be found and could not be: nothing was learned, or no question answered.
    """

    quantities: tuple[Quantity, ...]
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    drawings: Mapping[str, Drawing] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    losses: tuple[Loss, ...] = ()

    def table(self) -> pd.DataFrame:
        """Return the quantities with the columns of `quantities.csv`; what is not known is empty."""
        rows = [[getattr(q, name) for name in QUANTITIES] for q in self.quantities]
        table = pd.DataFrame(rows, columns=list(QUANTITIES))
        return table.astype({"value": float, "n": "Int64", "ci_low": float, "ci_high": float})


def mean_quantity(
    quantity: str, samples: NDArray[np.float64], case: str = "", component: str = "", unit: str = "1"
) -> Quantity:
    """Return the mean of samples (n,) with the normal 95 % interval, which needs two samples."""
    mean, n = float(np.mean(samples)), len(samples)
    half = 1.96 * float(np.std(samples, ddof=1)) / np.sqrt(n) if n > 1 else None
    low, high = (None, None) if half is None else (mean - half, mean + half)
    return Quantity(quantity, mean, case, component, unit, n, low, high)
