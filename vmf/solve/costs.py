"""Residuals of a motion given visuomotor parameters and image-based errors, one function a cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# cost(rows (A, C, 3, k+1), errors (A, C, 2), x̄ (A, k+1)) -> residuals (A, C, 2), ∂/∂x̄ (A, C, 2, k+1)
Cost = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]


def algebraic(rows: Floats, errors: Floats, x_bar: Floats) -> tuple[Floats, Floats]:
    """Return `a·x̄ − e_x c·x̄` and `b·x̄ − e_y c·x̄` (Eq. 3.41–3.45), linear in the lift."""
    V = rows[..., :2, :] - errors[..., None] * rows[..., 2:, :]
    return (V @ x_bar[:, None, :, None])[..., 0], V


def geometric(rows: Floats, errors: Floats, x_bar: Floats) -> tuple[Floats, Floats]:
    """Return `a·x̄/c·x̄ − e_x` and `b·x̄/c·x̄ − e_y` in px; NaN where a depth ratio is not positive."""
    abc = (rows @ x_bar[:, None, :, None])[..., 0]
    depth = np.where(abc[..., 2:] > 0.0, abc[..., 2:], np.nan)
    predicted = abc[..., :2] / depth
    V = (rows[..., :2, :] - predicted[..., None] * rows[..., 2:, :]) / depth[..., None]
    return predicted - errors, V


COSTS: Mapping[str, Cost] = MappingProxyType({"algebraic": algebraic, "geometric": geometric})
