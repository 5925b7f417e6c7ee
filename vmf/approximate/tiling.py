"""T overlays of 4-D tiles over the stereo space, hashed into a bounded table (§4.3.1, Eq. 4.6)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Displacement = Literal["diagonal", "uniform"]

# Odd steps per axis spread the overlays over the tile instead of along its diagonal.
_UNIFORM = np.array([1, 3, 5, 7])
# Odd 64-bit multipliers of a multiplicative hash, one per key entry: overlay, then the four axes.
_MULTIPLIERS = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93, 0xFF51AFD7ED558CCD],
    dtype=np.uint64,
)


@dataclass(frozen=True)
class Tiling:
    """Where a stereo code falls on every overlay.

    Attributes
    ----------
    overlays : T.
    tile_px : width w of a tile on each of the four axes.
    displacement : `diagonal` shifts overlay j by `j w/T` on every axis, as the thesis does; `uniform` by
        `((1, 3, 5, 7) j mod T) w/T`.
    table_size : number of slots that the tiles of all overlays share.
    """

    overlays: int = 32
    tile_px: float = 32.0
    displacement: Displacement = "diagonal"
    table_size: int = 65536

    def cells(self, codes: ArrayLike) -> Ints:
        """Return the integer tile coordinates (N, T, 4) of codes (N, 4) in px."""
        return np.asarray(np.floor(self._in_tiles(codes))).astype(np.int64)

    def offsets(self, codes: ArrayLike) -> Floats:
        """Return where codes (N, 4) in px lie in their tiles (N, T, 4), −½ to ½ width from the middle."""
        position = self._in_tiles(codes)
        return np.asarray(position - np.floor(position) - 0.5)

    def _in_tiles(self, codes: ArrayLike) -> Floats:
        """Return codes (N, 4) in px as tile coordinates (N, T, 4) of every overlay, in widths."""
        codes = np.asarray(codes, float)
        return np.asarray((codes[:, None, :] + self._shift) / self.tile_px)

    @cached_property
    def _shift(self) -> NDArray[np.float64]:
        j = np.arange(self.overlays)[:, None]
        step = np.ones(4, int) if self.displacement == "diagonal" else _UNIFORM
        return np.asarray((j * step % self.overlays) * (self.tile_px / self.overlays))

    def keys(self, codes: ArrayLike) -> NDArray[np.uint64]:
        """Return a 64-bit key (N, T) of each tile of codes (N, 4); the overlay is part of it."""
        return self._keys(self.cells(codes))

    def _keys(self, cells: Ints) -> NDArray[np.uint64]:
        # A sum of large odd multiples tells small whole numbers apart; the avalanche spreads them.
        of_overlay = np.arange(1, self.overlays + 1, dtype=np.uint64) * _MULTIPLIERS[0]
        return _mix((cells.view(np.uint64) * _MULTIPLIERS[1:]).sum(axis=-1, dtype=np.uint64) + of_overlay)

    def slots(self, keys: NDArray[np.uint64]) -> Ints:
        """Return the table slots of keys."""
        return np.asarray(keys % np.uint64(self.table_size)).astype(np.int64)


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Avalanche of the 64-bit splitmix generator (Steele et al. 2014)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))


@dataclass(frozen=True)
class Collisions:
    """How well a table kept tiles apart.

    Attributes
    ----------
    slots : size of the table.
    used : slots that hold a tile.
    updates : tile updates so far.
    collided : updates that fell on a slot owned by another tile.
    """

    slots: int
    used: int
    updates: int
    collided: int


class SlotTable:
    """Which tile owns each slot of the bounded table, first come first served."""

    def __init__(self, tiling: Tiling) -> None:
        self.tiling = tiling
        self.owner = np.zeros(tiling.table_size, np.uint64)
        self.used = np.zeros(tiling.table_size, bool)
        self.updates = 0
        self.collided = 0

    def visit(self, codes: ArrayLike) -> Ints:
        """Return the slots (N, T) of codes (N, 4), claiming free ones and counting collisions."""
        keys = self.tiling.keys(codes)
        slots = self.tiling.slots(keys)
        flat, key = slots.ravel(), keys.ravel()
        free = np.nonzero(~self.used[flat])[0]
        taken, first = np.unique(flat[free], return_index=True)
        self.owner[taken] = key[free[first]]
        self.used[taken] = True
        self.updates += flat.size
        self.collided += int((self.owner[flat] != key).sum())
        return slots

    def find(self, codes: ArrayLike) -> tuple[Ints, NDArray[np.bool_]]:
        """Return the slots (N, T) of codes (N, 4) and whether each holds this very tile."""
        keys = self.tiling.keys(codes)
        slots = self.tiling.slots(keys)
        return slots, self.used[slots] & (self.owner[slots] == keys)

    @property
    def collisions(self) -> Collisions:
        """Statistics so far."""
        return Collisions(self.tiling.table_size, int(self.used.sum()), self.updates, self.collided)
