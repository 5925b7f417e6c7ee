"""Weights of robust losses, as functions of residuals in units of their scale."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Loss = Literal["squared", "huber", "tukey"]

# Tuning constants for 95 % efficiency under Gaussian noise (Zhang 1997, Table 1); the median of a
# 2-D residual norm is 1.1774 σ.
HUBER = 1.345
_TUKEY = 4.685
MEDIAN_OF_NORM = 1.1774


def huber(size: Floats) -> Floats:
    """Return Huber weights of scaled residual norms."""
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(size, HUBER)))


def tukey(size: Floats) -> Floats:
    """Return Tukey's redescending weights of scaled residual norms; zero far out."""
    return np.asarray(np.square(np.maximum(0.0, 1.0 - np.square(size / _TUKEY))))


LOSSES: Mapping[str, Callable[[Floats], Floats]] = MappingProxyType({"huber": huber, "tukey": tukey})


def scale_of(size: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Return the noise σ (B,) that the median residual norm of (B, N) measurements implies, never zero."""
    with np.errstate(invalid="ignore"):
        values = np.where(seen, size, np.nan)
        median = np.array([np.nanmedian(v) if np.isfinite(v).any() else 0.0 for v in values])
    return np.maximum(median / MEDIAN_OF_NORM, np.finfo(float).eps)
