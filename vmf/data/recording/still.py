"""Leave out what stands still in front of fixed cameras while the tool moves: it is not on the tool.

A tracker finds tags on the table and corners of the wall as gladly as the tool's. Taken for parts of the tool
they agree with each other, and with cameras that are infinitely far away.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.data.tracks import Tracks

# A target that never leaves a square of this size, although the tool moved this far while it was seen, …
STILL_PX, TRAVEL_M = 2.0, 0.05
# … and although another target went at least this far.
MOVING_PX = 20.0
LEAST_FRAMES = 3


def drop_still(tracks: Tracks) -> tuple[Tracks, int]:
    """Return eye-to-hand tracks without targets that stand still, and how many targets those were."""
    if not len(tracks.frame):
        return tracks, 0
    starts = np.flatnonzero(np.append(True, np.diff(tracks.target) > 0))
    counts = np.diff(np.append(starts, len(tracks.target)))
    moved_px = _extent(tracks.pixels, starts).max(axis=1)
    travel_m = _extent(tracks.E_S_from_W[tracks.frame, :3, 3], starts).max(axis=1)
    still = (counts >= LEAST_FRAMES) & (moved_px < STILL_PX) & (travel_m > TRAVEL_M)
    if not still.any() or moved_px.max() < MOVING_PX:
        return tracks, 0
    keep = np.repeat(~still, counts)
    seen = np.unique(tracks.target[starts[~still]])
    new = np.full(tracks.n_targets, -1)
    new[seen] = np.arange(len(seen))
    return (
        Tracks(
            tracks.times_ns,
            tracks.E_S_from_W,
            tracks.frame[keep],
            new[tracks.target[keep]],
            tracks.pixels[keep],
            tuple(tracks.ids[k] for k in seen),
            tracks.image_size,
        ),
        int(still.sum()),
    )


def _extent(values: NDArray[np.float64], starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the ranges (K, n) of values (M, n) within runs; 0 where all are NaN."""
    low = np.fmin.reduceat(values, starts)
    high = np.fmax.reduceat(values, starts)
    return np.asarray(np.nan_to_num(high - low, nan=0.0))
