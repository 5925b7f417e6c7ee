"""The observations that Algorithm 1 pairs: what is kept of each, and which lie in a tile."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from vmf.approximate import Tiling
from vmf.data.growing import Growing
from vmf.data.track_log import TrackLog

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Centres:
    """All observations in both cameras, in order; each is the centre of its own pairs.

    Nothing is kept of one but where the log has its pose and code, and its place among its target's.

    Parameters
    ----------
    log : holds poses and codes.
    length : observations of a target before and after a centre that are paired with it, None for all.
    """

    def __init__(self, log: TrackLog, length: int | None) -> None:
        self._log, self.length = log, length
        self._row: Growing[np.int64] = Growing((), np.int64)
        self._of_target: list[Growing[np.int64]] = []
        self._read = 0

    def __len__(self) -> int:
        return len(self._row)

    def take_in(self) -> Ints:
        """Add what the log has got since; return the numbers (m,) of the new centres."""
        begin, self._read = self._read, len(self._log.frame)
        both = np.isfinite(self._log.pixels.rows[begin:]).all(axis=1)
        first = len(self)
        self._row.append(begin + np.nonzero(both)[0])
        new = np.arange(first, len(self))
        target = self.target(new)
        if len(new):
            self._of_target += [
                Growing((), np.int64) for _ in range(int(target.max()) + 1 - len(self._of_target))
            ]
        for t in dict.fromkeys(target.tolist()):
            self._of_target[t].append(new[target == t])
        return new

    def target(self, which: Ints) -> Ints:
        """Return the targets of centres."""
        return self._log.target.rows[self._row.rows[which]]

    def E(self, which: Ints) -> Floats:
        """Return the poses `E_S_from_W` (…, 4, 4) of centres."""
        return self._log.E.rows[self._log.frame.rows[self._row.rows[which]]]

    def code(self, which: Ints) -> Floats:
        """Return the stereo codes (…, 4) of centres in px."""
        return self._log.pixels.rows[self._row.rows[which]]

    def u(self, which: Ints) -> Floats:
        """Return the pixels (…, 2, 2) of centres in both cameras."""
        code = self.code(which)
        return code.reshape(*code.shape[:-1], 2, 2)

    def exact(self, which: Ints) -> Floats:
        """Return the pixels (…, 2, 2) of centres in both cameras without noise.

        Raises
        ------
        ValueError : the observations came without them.
        """
        if len(self._log.exact) != len(self._log.frame):
            raise ValueError("only a simulation knows pixels without noise")
        code = self._log.exact.rows[self._row.rows[which]]
        return code.reshape(*code.shape[:-1], 2, 2)

    def of_target(self, target: int) -> Ints:
        """Return all centres of a target, in order."""
        return self._of_target[target].rows

    def window(self, target: int, which: Ints) -> tuple[Ints, Ints]:
        """Return the first (m,) and the end (m,) of what centres of a target are paired with.

        Both count among the target's centres; the pair of a centre with itself is part of it (§4).
        """
        mates = self.of_target(target)
        if self.length is None:
            return np.zeros(len(which), np.int64), np.full(len(which), len(mates))
        rank = np.searchsorted(mates, which)
        return np.maximum(rank - self.length, 0), np.minimum(rank + self.length + 1, len(mates))

    def complete(self, which: Ints) -> bool:
        """Tell whether no further observation will be paired with these centres."""
        if self.length is None:
            return False
        target = self.target(which)
        return all(
            int(np.searchsorted(self.of_target(t), which[target == t].max())) + self.length
            < len(self.of_target(t))
            for t in dict.fromkeys(target.tolist())
        )


@dataclass(frozen=True)
class Tiles:
    """Tiles of a tiling, each named by a code inside it.

    Attributes
    ----------
    slot : (S,) where the table has them; without a table, the centres whose own factors stand for tiles.
    overlay : (S,) their overlays.
    code : (S, 4) a code in each, in px.
    """

    slot: Ints
    overlay: Ints
    code: Floats

    def __len__(self) -> int:
        return len(self.slot)

    def __getitem__(self, which: Ints | slice) -> Tiles:
        return Tiles(self.slot[which], self.overlay[which], self.code[which])


class CodeIndex:
    """Finds centres by their codes, one number kept of each: codes lie in buckets of a fixed width.

    Parameters
    ----------
    centres : what is to be found.
    width_px : of a bucket on each of the four axes; that of the tiles to be looked up.
    """

    def __init__(self, centres: Centres, width_px: float) -> None:
        self._centres, self._width_px = centres, width_px
        self._buckets: dict[tuple[int, ...], array[int]] = {}

    def append(self, new: Ints) -> None:
        """Add centres by their numbers."""
        for number, bucket in zip(new.tolist(), self._bucket(self._centres.code(new)), strict=True):
            self._buckets.setdefault(bucket, array("q")).append(number)

    def _bucket(self, codes: Floats) -> list[tuple[int, ...]]:
        return [tuple(row) for row in np.floor(codes / self._width_px).astype(np.int64).tolist()]

    def at(self, code: Floats) -> Ints:
        """Return the centres at exactly this code (4,), in order."""
        found = np.array(self._buckets.get(self._bucket(code[None])[0], ()), np.int64)
        return np.asarray(found[(self._centres.code(found) == code).all(axis=1)])

    def near(self, code: Floats) -> Ints:
        """Return the centres less than a width from a code (4,) on every axis, and some more; in order."""
        (middle,) = self._bucket(code[None])
        found = array("q")
        for bucket in product(*[(x - 1, x, x + 1) for x in middle]):
            inside = self._buckets.get(bucket)
            if inside is not None:
                found.extend(inside)
        return np.sort(np.array(found, np.int64))

    def inside(self, tiling: Tiling, tiles: Tiles) -> tuple[list[Ints], Ints]:
        """Return the different sets of centres that tiles cover, and which of them each tile (S,) covers."""
        number: dict[bytes, int] = {}
        sets: list[Ints] = []
        which = np.empty(len(tiles), np.int64)
        changes = np.nonzero((tiles.code[1:] != tiles.code[:-1]).any(axis=1))[0] + 1
        for begin, end in pairwise([0, *changes.tolist(), len(tiles)]):
            overlay, code = tiles.overlay[begin:end], tiles.code[begin : begin + 1]
            near = self.near(code[0])
            cells = tiling.cells(self._centres.code(near))
            covered = (cells == tiling.cells(code)).all(axis=-1)[:, overlay]
            # Tiles with the same centres are told apart by no bit of their columns.
            columns = np.packbits(covered, axis=0).T
            seen: dict[bytes, int] = {}
            for i, column in enumerate(columns):
                key = column.tobytes()
                if key not in seen:
                    centres = near[covered[:, i]]
                    seen[key] = number.setdefault(centres.tobytes(), len(sets))
                    if seen[key] == len(sets):
                        sets.append(centres)
                which[begin + i] = seen[key]
        return sets, which
