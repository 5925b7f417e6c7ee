"""The visited codes and what was learned there, in bounded memory: data of the instance-based approximators.

§4.2 notes that a database of pairs grows without end. Here, pairs that fall in the same cell of the stereo
space count as one, their mean. Cells are a pixel wide, as the stereo codes of §4.1 are; when more than the
capacity are in use, cells twice as wide take their place, and so on. Which cells there are does not depend
on the order of visits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from vmf.approximate.base import Arrays, Floats

Ints = NDArray[np.int64]

# However wide the cells, the four signs of a code keep this many apart.
_LEAST_CAPACITY = 16
# What a cell sums up before its parameters: trust, pairs, and the code times trust.
_FIRST_PARAMETER = 6


@dataclass(frozen=True)
class Means:
    """What is known of C visited cells.

    Attributes
    ----------
    codes : (C, 4) mean codes in px.
    parameters : (C, d) mean parameters, weighted by trust as the codes are.
    trust : (C,) sum of the pairs' trust.
    pairs : (C,) how many there are.
    """

    codes: Floats
    parameters: Floats
    trust: Floats
    pairs: Floats


class Visited:
    """Mean codes and parameters of the visited cells.

    Parameters
    ----------
    capacity : most cells kept, at least 16.

    Raises
    ------
    ValueError : a smaller capacity.
    """

    def __init__(self, capacity: int) -> None:
        if capacity < _LEAST_CAPACITY:
            raise ValueError(f"capacity {capacity}, at least {_LEAST_CAPACITY} is accepted")
        self.capacity = capacity
        # Cells are 2^level px wide.
        self.level = 0
        self._row: dict[bytes, int] = {}
        self._cells = np.zeros((0, 4), np.int64)
        self._sums = np.zeros((0, _FIRST_PARAMETER))
        self._tree: KDTree | None = None

    def __len__(self) -> int:
        return len(self._row)

    def add(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None) -> None:
        """Take in parameters (N, d) at codes (N, 4), with trust (N,) from 0 to 1; no trust is no visit."""
        codes, theta = np.asarray(codes, float), np.asarray(parameters, float)
        trust = np.ones(len(codes)) if weights is None else np.asarray(weights, float)
        visited = trust > 0.0
        if not visited.any():
            return
        codes, theta, trust = codes[visited], theta[visited], trust[visited, None]
        sums = np.column_stack([trust, np.ones(len(codes)), trust * codes, trust * theta])
        self._add(np.floor(codes / 2.0**self.level).astype(np.int64), sums)
        while len(self) > self.capacity:
            n = len(self)
            cells, sums = self._cells[:n] >> 1, self._sums[:n]
            self.level += 1
            self._row, self._cells, self._sums = {}, self._cells[:0], self._sums[:0]
            self._add(cells, sums)

    def _add(self, cells: Ints, sums: Floats) -> None:
        """Add sums (N, 6 + d) to those of their cells (N, 4), in this order."""
        rows = np.array([self._row.setdefault(cell.tobytes(), len(self._row)) for cell in cells], np.int64)
        held = len(self._cells)
        if len(self) > held:
            # Twice as much as was held, so that pairs may come one by one.
            size = max(2 * held, len(self))
            grown = np.zeros((size, 4), np.int64), np.zeros((size, sums.shape[1]))
            if held:
                grown[0][:held], grown[1][:held] = self._cells, self._sums
            self._cells, self._sums = grown
        self._cells[rows] = cells
        np.add.at(self._sums, rows, sums)
        self._tree = None

    def means(self) -> Means:
        """Return what is known of each cell."""
        sums = self._sums[: len(self)]
        trust = sums[:, 0]
        both = sums[:, 2:] / trust[:, None]
        return Means(both[:, :4], both[:, 4:], trust.copy(), sums[:, 1].copy())

    def nearest(self, codes: Floats, k: int, radius_px: float) -> tuple[Floats, Ints]:
        """Return distances (M, k) in px to the cells nearest to codes (M, 4), near ones first, and which.

        There are at most as many as cells. Beyond the radius the distance is infinite and the cell 0.
        """
        if self._tree is None:
            self._tree = KDTree(self.means().codes)
        order = np.arange(1, min(k, len(self)) + 1)
        distance, cell = self._tree.query(codes, order, distance_upper_bound=radius_px)
        return np.asarray(distance), np.where(np.isfinite(distance), cell, 0)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that make an equal memory with `restore`."""
        n = len(self)
        return {"level": np.array(self.level), "cells": self._cells[:n].copy(), "sums": self._sums[:n].copy()}

    def restore(self, state: Arrays) -> None:
        """Take over the arrays of `state`."""
        cells, sums = np.array(state["cells"]).astype(np.int64), np.array(state["sums"], float)
        n = len(cells)
        if cells.shape != (n, 4) or sums.ndim != 2 or len(sums) != n or sums.shape[1] < _FIRST_PARAMETER:
            raise ValueError(f"cells {cells.shape} and sums {sums.shape} do not fit")
        if not (np.isfinite(sums).all() and (sums[:, :2] > 0.0).all()):
            raise ValueError("cells without pairs, or with sums that are not finite")
        self.level = int(state["level"])
        self._cells, self._sums, self._tree = cells, sums, None
        self._row = {cell.tobytes(): i for i, cell in enumerate(cells)}
        if len(self._row) != n:
            raise ValueError("cells are given twice")
