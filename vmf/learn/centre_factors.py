"""Least-squares factors of centres' own pairs, formed of the centres that are asked about alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vmf.estimate import update_rank_k
from vmf.learn.visited import Centres

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Pairs taken in at once, and for good; those that make no whole block are taken in anew for every question,
# so that a factor does not depend, not even in rounding, on what was asked before.
_BLOCK = 64


class CentreFactors:
    """One factor a centre, of its pairs with every observation of its target in its window.

    Parameters
    ----------
    centres : all observations.
    rows : the rows (2, 2m, n) of pairs i → c of m centres each, by camera.
    n : columns of these rows.
    """

    def __init__(self, centres: Centres, rows: Callable[[Ints, Ints], Floats], n: int) -> None:
        self._centres, self._rows, self._n = centres, rows, n
        # By centre: the factor of its whole blocks, and the first mate beyond these.
        self._blocks: dict[int, tuple[Floats, int]] = {}

    def factor(self, centre: int) -> Floats:
        """Return the factor (2, n, n) of a centre's pairs, for the left and the right camera."""
        me = np.array([centre])
        target = int(self._centres.target(me)[0])
        (begin,), (end,) = self._centres.window(target, me)
        mates = self._centres.of_target(target)
        R, done = self._blocks.get(centre, (np.zeros((2, self._n, self._n)), int(begin)))
        while done + _BLOCK <= end:
            R, done = self._with(R, mates[done : done + _BLOCK], centre), done + _BLOCK
        self._blocks[centre] = R, done
        return self._with(R, mates[done:end], centre) if done < end else R

    def _with(self, R: Floats, mates: Ints, centre: int) -> Floats:
        return update_rank_k(R, self._rows(mates, np.full(len(mates), centre)))
