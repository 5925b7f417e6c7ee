"""What is near in an image mostly moves alike."""

from __future__ import annotations

import numpy as np

from vmf.track.base import Bools, Floats

NEIGHBOURS = 5
# A step may differ from its neighbours' by this, and by as much as they move.
_FREE_PX = 15.0


def around(pixels: Floats, known: Floats, shifts: Floats) -> Floats:
    """Return the median shift (n, 2) of the nearest of the known pixels (m, 2), m ≥ `NEIGHBOURS`."""
    far = np.linalg.norm(pixels[:, None] - known[None], axis=-1)
    near = np.argpartition(far, NEIGHBOURS - 1, axis=1)[:, :NEIGHBOURS]
    return np.asarray(np.median(shifts[near], axis=1))


def along(before: Floats, now: Floats) -> Bools:
    """Return which of the steps from pixels (n, 2) to others are like their neighbours' steps."""
    if len(before) <= NEIGHBOURS:
        return np.ones(len(before), bool)
    usual = around(before, before, now - before)
    off = np.linalg.norm(now - before - usual, axis=1)
    return np.asarray(off <= _FREE_PX + np.linalg.norm(usual, axis=1))
