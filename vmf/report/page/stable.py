"""When a curve has settled: the measure behind "stable after 100 frames"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# A curve is settled where it stays within this share of its final value ...
NEAR = 0.25
# ... in the mean over windows from a frame to so many times that frame: single frames are too noisy to
# compare, and early on a window of fixed width would swallow what is asked for.
WINDOW = 1.25

DEFINITION = (
    "A curve counts as stable after frame f if from f on its mean over every window of frames g to "
    f"{WINDOW:g} g stays within {NEAR:.0%} of its final value, the mean over the last half of the frames."
).replace("%", " %")


def first_stable(frames: Floats, values: Floats, weights: Floats | None = None) -> float | None:
    """Return the first frame after which a curve stays near its final value; None if it never does.

    Parameters
    ----------
    frames : (F,) numbers of frames, ascending.
    values : (F,) the curve there; NaN where there is none.
    weights : (F,) how many answers stand behind each value.
    """
    known = np.isfinite(values)
    frames, values = frames[known], values[known]
    weights = np.ones(len(frames)) if weights is None else weights[known]
    if len(frames) < 4:
        return None
    last = frames[-1]
    late = frames > last / 2
    final = float(np.average(values[late], weights=weights[late]))
    starts = np.nonzero(frames * WINDOW <= last)[0]
    ends = np.searchsorted(frames, frames[starts] * WINDOW, side="right")
    total = np.concatenate([[0.0], np.cumsum(values * weights)])
    count = np.concatenate([[0.0], np.cumsum(weights)])
    means = (total[ends] - total[starts]) / (count[ends] - count[starts])
    far = np.nonzero(np.abs(means - final) > NEAR * abs(final))[0]
    if not len(far):
        return float(frames[0])
    after = int(far[-1]) + 1
    return float(frames[starts[after]]) if after < len(starts) else None
