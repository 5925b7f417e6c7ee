"""Residuals of a motion given what it makes the cameras see and image-based errors, one function a cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# cost(W (A, 1+f, 3, C) of `LiftedViews.at`, errors (A, 2, C))
#     -> residuals (A, 2, C) and their derivatives (A, f, 2, C).
Cost = Callable[[Floats, Floats], tuple[Floats, Floats]]


def algebraic(W: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """Return `a·x̄ − e_x c·x̄` and `b·x̄ − e_y c·x̄` (Eq. 3.41–3.45), linear in the lift."""
    V = W[:, :, :2] - errors[:, None] * W[:, :, 2:]
    return V[:, 0], V[:, 1:]


def geometric(W: Floats, errors: Floats) -> tuple[Floats, Floats]:
    """Return `a·x̄/c·x̄ − e_x` and `b·x̄/c·x̄ − e_y` in px; NaN where a depth ratio is not positive."""
    c = W[:, 0, 2]
    inverse_depth = 1.0 / np.where(c > 0.0, c, np.nan)
    predicted = W[:, 0, :2] * inverse_depth[:, None]
    J = predicted[:, None] * W[:, 1:, 2:]
    np.subtract(W[:, 1:, :2], J, out=J)
    J *= inverse_depth[:, None, None]
    return predicted - errors, J


COSTS: Mapping[str, Cost] = MappingProxyType({"algebraic": algebraic, "geometric": geometric})
