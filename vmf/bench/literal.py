"""Algorithm 1 the thesis's own way: one LAPACK factorisation for every tile of every update (Fig. 5.2).

An alternative to be measured, written to be fast within that: rows of a frame are formed all at once, and a
factorisation overwrites the tile's own array.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf

from vmf.approximate import Tiling
from vmf.bench.one_target import OneTarget
from vmf.learn.pairs import pair_rows
from vmf.tasks import Task

Floats = NDArray[np.float64]

_BLOCK = 32


class ThesisWay(OneTarget):
    """A factor for each tile and camera, updated by two rows at a time.

    Parameters
    ----------
    task : the task space.
    tiling : the overlays.
    """

    def __init__(self, task: Task, tiling: Tiling) -> None:
        super().__init__(task, tiling)
        # Factor above, room for two rows below, as LAPACK wants them: by columns.
        self._tiles: dict[int, list[Floats]] = {}
        self._keep = np.asfortranarray(np.triu(np.ones((self.n + 2, self.n))))
        self.updates = 0

    def observe(self, E: Floats, code: Floats) -> None:
        """Take in one observation of the target: pose (4, 4) and stereo code (4,)."""
        self._keep_observation(E, code)
        E_all, u_all = self._E.rows, self._u.rows
        to_old = pair_rows(self.task, E, u_all[-1], E_all, u_all)
        to_new = pair_rows(self.task, E_all, u_all, E, u_all[-1])
        new = len(self._E) - 1
        for old in range(new):
            self._update_parameters(old, to_old[old])
            self._update_parameters(new, to_new[old])
        self._update_parameters(new, to_new[new])

    def _update_parameters(self, centre: int, rows: Floats) -> None:
        """Add the rows (2, 2, 3k+3) of a pair to all tiles of its centre, camera by camera."""
        n, keep = self.n, self._keep
        for slot in self._slots[centre]:
            tile = self._tiles.get(slot)
            if tile is None:
                tile = self._tiles[slot] = [np.zeros((n + 2, n), order="F") for _ in range(2)]
            for A, two in zip(tile, rows, strict=True):
                A[n:] = two
                dgeqrf(A, lwork=_BLOCK * n, overwrite_a=1)
                np.multiply(A, keep, out=A)
                self.updates += 1

    def finish(self) -> None:
        """Nothing is ever postponed."""

    def factors(self) -> Floats:
        """Return the factors (T, 2, 3k+3, 3k+3) of the tiles of the first code observed."""
        return np.array([[A[: self.n] for A in self._tiles[slot]] for slot in self._slots[0]])
