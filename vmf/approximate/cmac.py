"""Albus's CMAC, trained by the Albus–Kaczmarz rule (§4.2.4, §4.3.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate.base import Approximator, Arrays, Floats, Prediction
from vmf.approximate.tiling import Collisions, Displacement, SlotTable, Tiling


class Cmac(Approximator):
    """Sum of T tile weights (Eq. 4.7); `support` is the share of a code's T tiles that were trained.

    Parameters
    ----------
    overlays, tile_px, displacement, table_size : the tiling.
    step : ε of Eq. 4.8, between 0 and 2.
    epochs : passes over the pairs of each `partial_fit`.
    min_support : codes with a smaller share of trained tiles are refused.
    """

    def __init__(
        self,
        overlays: int = 32,
        tile_px: float = 32.0,
        displacement: Displacement = "diagonal",
        table_size: int = 65536,
        step: float = 1.0,
        epochs: int = 1,
        min_support: float = 0.25,
    ) -> None:
        self.tiling = Tiling(overlays, tile_px, displacement, table_size)
        self.step, self.epochs, self.min_support = step, epochs, min_support
        self._table = SlotTable(self.tiling)
        # Weights are allocated for the slots in use only: row of each slot, −1 for none.
        self._row = np.full(table_size, -1, np.int64)
        self._weights = np.zeros((0, 0))
        self._n_rows = 0

    @property
    def collisions(self) -> Collisions:
        """How well the table kept tiles apart."""
        return self._table.collisions

    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        codes, theta = np.asarray(codes, float), np.asarray(parameters, float)
        # A pair that is trusted less takes a shorter step.
        steps = self.step * (np.ones(len(codes)) if weights is None else np.asarray(weights, float))
        trusted = steps > 0.0
        codes, theta, steps = codes[trusted], theta[trusted], steps[trusted]
        for _ in range(self.epochs):
            rows = self._rows_of(self._table.visit(codes), theta.shape[1])
            _, own = self._table.find(codes)
            self._kaczmarz(rows, own, theta, steps)

    def _kaczmarz(
        self, rows: NDArray[np.int64], own: NDArray[np.bool_], theta: Floats, steps: Floats
    ) -> None:
        """Eq. 4.8, one code after the other: the order is part of the algorithm."""
        W, T = self._weights, self.tiling.overlays
        for slots, mine, target, step in zip(rows, own, theta, steps, strict=True):
            # Tiles whose slot another tile owns are left out; the others stand for all T, as in `predict`.
            tiles = slots[mine]
            if len(tiles):
                W[tiles] += step * (target - W[tiles].sum(axis=0) * (T / len(tiles))) / T

    def _rows_of(self, slots: NDArray[np.int64], width: int) -> NDArray[np.int64]:
        new = np.unique(slots[self._row[slots] < 0])
        self._row[new] = self._n_rows + np.arange(len(new))
        self._n_rows += len(new)
        if self._n_rows > len(self._weights) or self._weights.shape[1] != width:
            grown = np.zeros((max(2 * len(self._weights), self._n_rows), width))
            grown[: len(self._weights), : self._weights.shape[1]] = self._weights
            self._weights = grown
        return np.asarray(self._row[slots])

    def predict(self, codes: ArrayLike) -> Prediction:
        codes = np.asarray(codes, float)
        slots, used = self._table.find(codes)
        support = used.mean(axis=1)
        width = max(self._weights.shape[1], 1)
        answered = (support > 0.0) & (support >= self.min_support)
        values = np.full((len(codes), width), np.nan)
        if not answered.any():
            return Prediction(values, support)
        # Untrained tiles would pull the sum to zero: the trained ones stand for all T, which is Eq. 4.7
        # wherever all are trained.
        rows, mask = self._row[slots[answered]], used[answered]
        total = np.where(mask[..., None], self._weights[rows], 0.0).sum(axis=1)
        values[answered] = total / support[answered, None]
        return Prediction(values, support)

    def state(self) -> dict[str, NDArray[Any]]:
        used = np.nonzero(self._table.used)[0]
        return {
            "slots": used,
            "owner": self._table.owner[used],
            "weights": self._weights[self._row[used]],
            "counts": np.array([self._table.updates, self._table.collided]),
        }

    def restore(self, state: Arrays) -> None:
        used = np.asarray(state["slots"]).astype(np.int64)
        self._table = SlotTable(self.tiling)
        self._table.used[used] = True
        self._table.owner[used] = state["owner"]
        self._table.updates, self._table.collided = (int(v) for v in state["counts"])
        self._row = np.full(self.tiling.table_size, -1, np.int64)
        self._row[used] = np.arange(len(used))
        self._n_rows = len(used)
        self._weights = np.array(state["weights"], float)
