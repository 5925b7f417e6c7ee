"""Incremental estimators of visuomotor parameters: feed lifts and errors, ask for an estimate any time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.estimate.linear import Estimate, least_squares, total_least_squares
from vmf.estimate.maximum_likelihood import maximum_likelihood
from vmf.estimate.robust import Loss
from vmf.estimate.rows import augmented_rows, update_rank_1, update_rank_k

Floats = NDArray[np.float64]
Kernel = Literal["lapack", "givens"]


class Estimator:
    """Estimates the parameters of B centres at once from their triangular factors.

    Parameters
    ----------
    n_lift : length `k+1` of the lift with its constant.
    batch : number B of centres.
    n_free : entries per row that the task's motions can determine; all by default.
    kernel : `lapack` adds rows by blocked QR, `givens` one by one by rotations.
    """

    bounded_memory = True
    _solve: Callable[[Floats, int], Estimate]

    def __init__(
        self, n_lift: int, batch: int = 1, *, n_free: int | None = None, kernel: Kernel = "lapack"
    ) -> None:
        self.n_lift = n_lift
        self.n_free = n_lift if n_free is None else n_free
        self.kernel = kernel
        self.R = np.zeros((batch, 3 * n_lift, 3 * n_lift))

    def partial_fit(self, x_bar: ArrayLike, e: ArrayLike) -> None:
        """Add equations: lifts (B, m, k+1) and errors (B, m, 2) in px; NaN errors add nothing."""
        x_bar, e = np.asarray(x_bar, float), np.asarray(e, float)
        rows = augmented_rows(x_bar, e)
        rows[~np.isfinite(e).all(axis=-1)] = 0.0
        rows = rows.reshape(len(self.R), -1, 3 * self.n_lift)
        if self.kernel == "lapack":
            self.R = update_rank_k(self.R, rows)
        else:
            for centre, block in enumerate(rows):
                for row in block:
                    self.R[centre] = update_rank_1(self.R[centre], row)

    def estimate(self) -> Estimate:
        """Return the estimate of every centre from all equations so far."""
        return type(self)._solve(self.R, self.n_free)

    def state(self) -> dict[str, Floats]:
        """Return the arrays that make an equal estimator with `restore`."""
        return {"R": self.R.copy()}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """Take over the arrays of `state`."""
        self.R = np.array(state["R"], float)


class QrEstimator(Estimator):
    """Incremental least squares with the constant of c fixed to 1: the thesis (Eq. 3.46–3.48)."""

    _solve = staticmethod(least_squares)


class TlsEstimator(Estimator):
    """Homogeneous least squares: no entry fixed, gauge applied afterwards (§3.2)."""

    _solve = staticmethod(total_least_squares)


class MlEstimator(Estimator):
    """Least reprojection error from the total-least-squares start; keeps every equation (§3.3)."""

    bounded_memory = False

    def __init__(
        self,
        n_lift: int,
        batch: int = 1,
        *,
        n_free: int | None = None,
        kernel: Kernel = "lapack",
        loss: Loss = "squared",
    ) -> None:
        super().__init__(n_lift, batch, n_free=n_free, kernel=kernel)
        self.loss: Loss = loss
        self.x_bar = np.zeros((batch, 0, n_lift))
        self.e = np.zeros((batch, 0, 2))

    def partial_fit(self, x_bar: ArrayLike, e: ArrayLike) -> None:
        x_bar, e = np.asarray(x_bar, float), np.asarray(e, float)
        super().partial_fit(x_bar, e)
        self.x_bar = np.concatenate([self.x_bar, x_bar], axis=1)
        self.e = np.concatenate([self.e, e], axis=1)

    def estimate(self) -> Estimate:
        return maximum_likelihood(self.R, self.n_free, self.x_bar, self.e, self.loss)[0]

    def state(self) -> dict[str, Floats]:
        return {**super().state(), "x_bar": self.x_bar.copy(), "e": self.e.copy()}

    def restore(self, state: Mapping[str, Floats]) -> None:
        super().restore(state)
        self.x_bar, self.e = np.array(state["x_bar"], float), np.array(state["e"], float)


ESTIMATORS: Mapping[str, type[Estimator]] = MappingProxyType(
    {"qr": QrEstimator, "tls": TlsEstimator, "ml": MlEstimator}
)
