"""Everything observed so far, in the order in which it was observed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.data.growing import Growing
from vmf.data.tracks import Tracks

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class TrackLog:
    """Tracks that grow block by block: a block costs what it holds, however much came before.

    Attributes
    ----------
    times_ns, E : of each frame (N,), (N, 4, 4).
    frame, target, pixels : of each observation (M,), (M,), (M, 4), by frame, then by target.
    exact : (M, 4) the pixels without noise, where all blocks say so; (0, 4) elsewhere.
    """

    def __init__(self) -> None:
        self.times_ns: Growing[np.int64] = Growing((), np.int64)
        self.E: Growing[np.float64] = Growing((4, 4), np.float64)
        self.frame: Growing[np.int64] = Growing((), np.int64)
        self.target: Growing[np.int64] = Growing((), np.int64)
        self.pixels: Growing[np.float64] = Growing((4,), np.float64)
        self.exact: Growing[np.float64] = Growing((4,), np.float64)
        self._ids: tuple[str, ...] = ()
        self._image_size: tuple[int, int] | None = None
        self._blocks = 0
        self._tracks: Tracks | None = None

    def append(self, block: Tracks) -> Ints:
        """Add further frames of the same targets; return where its observations went, in the log's order."""
        order = np.lexsort((block.target, block.frame))
        begin = len(self.frame)
        self.frame.append(block.frame[order] + len(self.times_ns))
        self.target.append(block.target[order])
        self.pixels.append(block.pixels[order])
        if block.exact is not None:
            self.exact.append(block.exact[order])
        self.times_ns.append(block.times_ns)
        self.E.append(block.E_S_from_W)
        if not self._blocks:
            self._image_size = block.image_size
        self._ids = block.ids
        self._blocks += 1
        self._tracks = None
        return np.arange(begin, len(self.frame))

    @property
    def tracks(self) -> Tracks | None:
        """Everything so far as tracks of their own, None before the first block."""
        if self._tracks is None and self._blocks:
            frame, target = self.frame.rows, self.target.rows
            order = np.lexsort((frame, target))
            self._tracks = Tracks(
                self.times_ns.rows.copy(),
                self.E.rows.copy(),
                frame[order],
                target[order],
                self.pixels.rows[order],
                self._ids,
                self._image_size,
                self.exact.rows[order] if len(order) and len(self.exact) == len(order) else None,
            )
        return self._tracks
