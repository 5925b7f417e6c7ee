"""Algorithm 1 pair by pair at its best: the same rows, many to a LAPACK call.

An alternative to be measured. A tile's rows are gathered over many frames and folded in at once; only what
the code in question needs is brought up to date after every frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf

from vmf.approximate import Tiling
from vmf.bench.one_target import OneTarget
from vmf.estimate import update_rank_k
from vmf.learn.pairs import pair_rows
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Frames gathered before they are folded in: of what is factorised then, the old factor is a small part.
_FRAMES = 128
# Centres whose rows are formed at once.
_CENTRES = 16


class Blocked(OneTarget):
    """Factors of tiles, or of centres, brought up to date by rank-k updates with k in the hundreds.

    Parameters
    ----------
    task : the task space.
    tiling : the overlays.
    shared : keep one factor a centre, and form a tile's from those of its centres when it is asked for,
        instead of one a tile as Algorithm 1 has it.

    Notes
    -----
    The first code observed is the one in question.
    """

    def __init__(self, task: Task, tiling: Tiling, *, shared: bool) -> None:
        super().__init__(task, tiling)
        self.shared = shared
        self._upper = np.triu(np.ones((self.n, self.n)))
        self._R: dict[int, Floats] = {}
        # Slots of the code in question, and the centres in them.
        self._asked: dict[int, None] = {}
        self._near: list[int] = []
        self._folded = 0

    def observe(self, E: Floats, code: Floats) -> None:
        """Take in one observation of the target: pose (4, 4) and stereo code (4,)."""
        self._keep_observation(E, code)
        if len(self._E) == 1:
            self._asked = dict.fromkeys(self._slots[0])
        self._refresh()
        if len(self._E) - self._folded >= _FRAMES:
            self._fold()

    def finish(self) -> None:
        """Do what was postponed."""
        self._fold()

    def factors(self) -> Floats:
        """Return the factors (T, 2, 3k+3, 3k+3) of the tiles of the code in question."""
        if not self.shared:
            return np.array([self._R[slot] for slot in self._asked])
        inside = [[c for c in self._near if slot in self._slots[c]] for slot in self._asked]
        distinct = {tuple(centres): i for i, centres in enumerate(inside)}
        factors = np.zeros((len(inside), 2, self.n, self.n))
        for centres, i in distinct.items():
            stack = np.concatenate([self._R[c] for c in centres], axis=1)
            factors[i] = update_rank_k(factors[i], stack) if len(centres) > 1 else stack
        return factors[[distinct[tuple(centres)] for centres in inside]]

    def _refresh(self) -> None:
        """Bring what the code in question needs up to date with the newest observation."""
        new = len(self._E) - 1
        rows = self._rows(np.array([new]), np.array(self._near, np.int64))
        for centre, mine in zip(self._near, rows, strict=True):
            self._add(self._needed(centre), mine)
        needed = self._needed(new)
        if needed:
            self._near.append(new)
            self._add(needed, self._rows(np.arange(new + 1), np.array([new]))[0])

    def _needed(self, centre: int) -> list[int]:
        mine = [slot for slot in self._slots[centre] if slot in self._asked]
        return [centre] * bool(mine) if self.shared else mine

    def _postponed(self, centre: int) -> list[int]:
        if self.shared:
            return [] if self._needed(centre) else [centre]
        return [slot for slot in self._slots[centre] if slot not in self._asked]

    def _fold(self) -> None:
        """Bring all the rest up to date."""
        begin, end = self._folded, len(self._E)
        for first in range(0, end, _CENTRES):
            last = min(first + _CENTRES, end)
            # A centre of this block has its pairs with all frames before it to come, too.
            for some, frames in (
                (np.arange(first, min(last, begin)), np.arange(begin, end)),
                (np.arange(max(first, begin), last), np.arange(end)),
            ):
                if len(some):
                    for centre, mine in zip(some.tolist(), self._rows(frames, some), strict=True):
                        self._add(self._postponed(centre), mine)
        self._folded = end

    def _rows(self, frames: Ints, centres: Ints) -> Floats:
        """Return the rows (C, 2, 2m, 3k+3) of the pairs of m frames with C centres, by camera."""
        E, u = self._E.rows, self._u.rows
        rows = pair_rows(self.task, E[frames], u[frames], E[centres][:, None], u[centres][:, None])
        return rows.swapaxes(1, 2).reshape(len(centres), 2, 2 * len(frames), self.n)

    def _add(self, keys: list[int], rows: Floats) -> None:
        """Add rows (2, m, 3k+3) to some factors: one LAPACK call for each and camera, in place."""
        n = self.n
        room = np.empty((n + rows.shape[1], n), order="F")
        for camera in range(2):
            by_columns = np.asfortranarray(rows[camera])
            for key in keys:
                R = self._R.get(key)
                if R is None:
                    R = self._R[key] = np.zeros((2, n, n))
                room[:n], room[n:] = R[camera], by_columns
                dgeqrf(room, lwork=32 * n, overwrite_a=1)
                np.multiply(room[:n], self._upper, out=R[camera])
