"""What cameras see of lifted motions, and how that changes with the unknowns (§2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.solve.unknowns import Unknowns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class LiftedViews:
    """The parameters of C views, one per target and camera, of Q queries.

    Attributes
    ----------
    unknowns : of the queries' motions.
    by_row : (Q, 3C, k+1) all `a`, then all `b`, then all `c`: one product of matrices a query.
    """

    unknowns: Unknowns
    by_row: Floats

    @classmethod
    def of(cls, unknowns: Unknowns, rows: Floats) -> LiftedViews:
        """Return the views with parameters (Q, C, 3, k+1)."""
        Q, C, _, width = rows.shape
        return cls(unknowns, np.ascontiguousarray(rows.swapaxes(1, 2)).reshape(Q, 3 * C, width))

    def at(self, x: Floats, index: Ints) -> Floats:
        """Return `a·x̄`, `b·x̄`, `c·x̄` and, behind them, their derivatives: (A, 1+f, 3, C).

        Parameters
        ----------
        x : (A, f) free unknowns of the queries `index`.
        index : (A,).
        """
        x_bar, J_lift = self.unknowns.lift(x, index)
        B = np.empty((len(index), 1 + J_lift.shape[-1], x_bar.shape[-1]))
        B[:, 0] = x_bar
        B[:, 1:] = J_lift.swapaxes(1, 2)
        W = B @ self._rows(index).swapaxes(1, 2)
        return np.asarray(W.reshape(*W.shape[:2], 3, self.by_row.shape[1] // 3))

    def depth_ratios(self, x: Floats, index: Ints) -> Floats:
        """Return `c·x̄` (A, C), positive in front of the camera."""
        x_bar, _ = self.unknowns.lift(x, index)
        c = self._rows(index)[:, 2 * self.by_row.shape[1] // 3 :]
        return np.asarray((c @ x_bar[..., None])[..., 0])

    def _rows(self, index: Ints) -> Floats:
        whole = len(index) == len(self.by_row) and np.array_equal(index, np.arange(len(index)))
        return self.by_row if whole else self.by_row[index]
