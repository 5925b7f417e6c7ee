"""What cameras see of lifted motions, and how that changes with the unknowns (§2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.solve.unknowns import Unknowns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def by_row(rows: Floats) -> Floats:
    """Return parameters (Q, C, 3, k+1) as (Q, 3C, k+1): all `a`, all `b`, all `c`: one product a query."""
    Q, C, _, width = rows.shape
    return np.ascontiguousarray(rows.swapaxes(1, 2)).reshape(Q, 3 * C, width)


def views(rows: Floats, x_bar: Floats, J_lift: Floats) -> Floats:
    """Return `a·x̄`, `b·x̄`, `c·x̄` and, behind them, their derivatives: (A, 1+f, 3, C).

    Parameters
    ----------
    rows : (A, 3C, k+1) parameters of `by_row`.
    x_bar, J_lift : (A, k+1) lifted motions, and (A, k+1, f) their derivatives.
    """
    A, f = len(rows), J_lift.shape[-1]
    B = np.empty((A, 1 + f, x_bar.shape[-1]))
    B[:, 0] = x_bar
    B[:, 1:] = J_lift.swapaxes(-1, -2)
    W = B @ rows.swapaxes(1, 2)
    return np.asarray(W.reshape(A, 1 + f, 3, rows.shape[1] // 3))


@dataclass(frozen=True)
class LiftedViews:
    """The parameters of C views, one per target and camera, of Q queries.

    Attributes
    ----------
    unknowns : of the queries' motions.
    rows : (Q, 3C, k+1) of `by_row`.
    """

    unknowns: Unknowns
    rows: Floats

    @classmethod
    def of(cls, unknowns: Unknowns, rows: Floats, seen: Bools) -> LiftedViews:
        """Return the views with parameters (Q, C, 3, k+1); what is not seen (Q, C) has depth 1 everywhere."""
        blank = np.zeros(rows.shape[-2:])
        blank[2, -1] = 1.0
        return cls(unknowns, by_row(np.where(seen[..., None, None], rows, blank)))

    def at(self, x: Floats, index: Ints) -> Floats:
        """Return `a·x̄`, `b·x̄`, `c·x̄` and, behind them, their derivatives: (A, 1+f, 3, C).

        Parameters
        ----------
        x : (A, f) free unknowns of the queries `index`.
        index : (A,).
        """
        return views(self._rows(index), *self.unknowns.lift(x, index))

    def depth_ratios(self, x: Floats, index: Ints) -> Floats:
        """Return `c·x̄` (A, C), positive in front of the camera."""
        x_bar, _ = self.unknowns.lift(x, index)
        c = self._rows(index)[:, 2 * self.rows.shape[1] // 3 :]
        return np.asarray((c @ x_bar[..., None])[..., 0])

    def _rows(self, index: Ints) -> Floats:
        whole = len(index) == len(self.rows) and np.array_equal(index, np.arange(len(index)))
        return self.rows if whole else self.rows[index]
