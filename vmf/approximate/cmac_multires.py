"""CMACs of several tile widths, of which the finest that has been trained enough answers (Ch. 6)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate.base import Approximator, Arrays, Floats, Prediction
from vmf.approximate.cmac import Cmac, NewTiles
from vmf.approximate.tiling import Displacement


class CmacMultires(Approximator):
    """All widths learn everything; `support` is the share of trained tiles of the width that answers.

    Parameters
    ----------
    tiles_px : tile widths.
    min_visits : fully trusted pairs after which a tile counts as trained enough.
    min_trained : share of a code's tiles that must be, for a width to answer; the widest always may.
    overlays, displacement, table_size, step, epochs, min_support, new_tiles : of every width, as of `Cmac`.
    """

    def __init__(
        self,
        overlays: int = 32,
        tiles_px: Sequence[float] = (32.0, 64.0, 128.0),
        displacement: Displacement = "diagonal",
        table_size: int = 65536,
        step: float = 0.5,
        epochs: int = 2,
        min_support: float = 0.25,
        new_tiles: NewTiles = "first_visit",
        min_visits: float = 8.0,
        min_trained: float = 0.75,
    ) -> None:
        self.levels = tuple(
            Cmac(overlays, width, displacement, table_size, step, epochs, min_support, new_tiles=new_tiles)
            for width in sorted(tiles_px)
        )
        self.min_visits, self.min_trained = min_visits, min_trained
        # Sum of trust of the pairs that each tile was trained with.
        self._visits = np.zeros((len(self.levels), table_size))

    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        codes = np.asarray(codes, float)
        trust = np.ones(len(codes)) if weights is None else np.asarray(weights, float)
        for level, visits in zip(self.levels, self._visits, strict=True):
            level.partial_fit(codes, parameters, weights)
            slots, own = level.table.find(codes)
            np.add.at(visits, slots[own], np.broadcast_to(trust[:, None], slots.shape)[own])

    def predict(self, codes: ArrayLike) -> Prediction:
        codes = np.asarray(codes, float)
        prediction = self.levels[-1].predict(codes)
        values, support = prediction.parameters, prediction.support
        # From the second widest to the finest, so that the finest that may answer has the last word.
        for level, visits in zip(self.levels[-2::-1], self._visits[-2::-1], strict=True):
            finer = level.predict(codes)
            may = (self._trained(level, visits, codes) >= self.min_trained) & ~finer.refused
            values[may], support[may] = finer.parameters[may], finer.support[may]
        return Prediction(values, support)

    def _trained(self, level: Cmac, visits: Floats, codes: Floats) -> Floats:
        """Return the share (M,) of codes' tiles that have been trained enough."""
        slots, own = level.table.find(codes)
        return np.asarray((own & (visits[slots] >= self.min_visits)).mean(axis=1))

    def state(self) -> dict[str, NDArray[Any]]:
        state: dict[str, NDArray[Any]] = {}
        for i, (level, visits) in enumerate(zip(self.levels, self._visits, strict=True)):
            own = level.state()
            own["visits"] = visits[own["slots"]]
            state |= {f"{i}.{name}": array for name, array in own.items()}
        return state

    def restore(self, state: Arrays) -> None:
        self._visits = np.zeros_like(self._visits)
        for i, (level, visits) in enumerate(zip(self.levels, self._visits, strict=True)):
            prefix = f"{i}."
            own = {name.removeprefix(prefix): a for name, a in state.items() if name.startswith(prefix)}
            level.restore(own)
            visits[level.table.used] = own["visits"]
