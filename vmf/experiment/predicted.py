"""Where a learned function expects its targets after a motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.data import Query
from vmf.learn import Learner
from vmf.solve import Solutions

Floats = NDArray[np.float64]

# A lens bends by far less than it leaves alone, so that each step gains digits; to a thousandth of a pixel.
_STEPS = 50
_EXACT_PX = 1e-3


def predicted_pixels(learner: Learner, query: Query, solutions: Solutions) -> Floats:
    """Return where targets (Q, n, 4) are expected after the motions solved for, in px (Eq. 3.41–3.45).

    NaN where there is no motion, no code to start from, or no parameters.
    """
    Q, n = query.initial.shape[:2]
    codes = learner.rectified(query.initial)
    known = np.isfinite(codes).all(axis=-1) & (solutions.status == "ok")[:, None]
    out = np.full((Q, n, 4), np.nan)
    if not known.any():
        return out
    rows = learner.parameters(codes[known]).rows
    x_bar = learner.task.lift(solutions.E_to_from)[np.nonzero(known)[0]]
    abc = (rows @ x_bar[:, None, :, None])[..., 0]
    at_rest = rows @ learner.task.identity_lift
    # The depth ratio is positive at rest, up to a sign that the gauge leaves open (§2).
    in_front = abc[..., 2] * at_rest[..., 2] > 0.0
    depth = np.where(in_front, abc[..., 2], np.nan)
    moved = abc[..., :2] / depth[..., None]
    out[known] = codes[known] + moved.reshape(-1, 4)
    return _through_lens(learner, out)


def _through_lens(learner: Learner, rectified: Floats) -> Floats:
    """Return the pixels (…, 4) that the cameras show where pinhole cameras would show `rectified`."""
    pixels = rectified.copy()
    for _ in range(_STEPS):
        off = rectified - learner.rectified(pixels)
        if not (np.abs(off) > 0.0).any():
            return pixels
        pixels = pixels + off
    return np.where(np.abs(rectified - learner.rectified(pixels)) < _EXACT_PX, pixels, np.nan)
