"""The two gauges of parameters, which are defined up to one scale (§2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def depth_ratio_at_rest(rows: ArrayLike, identity_lift: ArrayLike) -> Floats:
    """Return `c·x̄(I)` (…,) of rows (…, 3, k+1): the scale that the unit-depth gauge divides by."""
    return np.asarray(np.asarray(rows, float)[..., 2, :] @ np.asarray(identity_lift, float))


def sign_at_rest(rows: ArrayLike, identity_lift: ArrayLike) -> Floats:
    """Return the signs (…, 1, 1) that make depth ratios of rows (…, 3, k+1) positive at rest.

    What was seen is in front of the camera there, and the thesis's gauge may say otherwise.
    """
    return np.asarray(np.sign(depth_ratio_at_rest(rows, identity_lift))[..., None, None])


def unit_depth_gauge(rows: ArrayLike, identity_lift: ArrayLike) -> Floats:
    """Return rows (…, 3, k+1) scaled to `c·x̄(I) = 1`; NaN where c·x̄(I) is zero."""
    return _divide(rows, depth_ratio_at_rest(rows, identity_lift))


def thesis_gauge(rows: ArrayLike) -> Floats:
    """Return rows (…, 3, k+1) scaled so that the constant of c is 1 (Eq. 3.15); NaN where it is zero."""
    return _divide(rows, np.asarray(rows, float)[..., 2, -1])


def in_gauge(rows: ArrayLike, gauge: str, identity_lift: ArrayLike) -> Floats:
    """Return rows (…, 3, k+1) in the gauge of that name: `unit_depth` or `thesis`."""
    return thesis_gauge(rows) if gauge == "thesis" else unit_depth_gauge(rows, identity_lift)


def _divide(rows: ArrayLike, scale: Floats) -> Floats:
    scale = np.where(scale == 0.0, np.nan, scale)
    return np.asarray(rows, float) / scale[..., None, None]
