"""A visuomotor function near the stereo codes of a query, as two views (§6.3).

The stereo code that indexes the parameters is itself a noisy measurement. The true code lies on the
three-dimensional visible manifold, `y_R` being a function of `q = (x_L, y_L, x_R)`. Within a few pixels of
the observed code both this function and the parameters are taken as affine in q, so that the view after the
motion is projective in `(q, 1)` and what is left is the same problem as with known cameras.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.data.query import Query
from vmf.estimate import sign_at_rest
from vmf.solve.two_view import TwoViews, views_of_codes
from vmf.solve.unknowns import Unknowns

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Differences over a few times the noise that a tracker has: wider than a CMAC's finest step.
_STEP_PX = 6.0


@dataclass(frozen=True)
class Function:
    """What a solver needs of a visuomotor function.

    Attributes
    ----------
    parameters : stereo codes (M, 4) to rows (M, 2, 3, k+1), NaN where refused, and which of the codes have
        parameters that hold for the code as it was observed (M,).
    y_right : q (M, 3) to y_R (M,) on the visible manifold.
    """

    parameters: Callable[[Floats], tuple[Floats, Bools]]
    y_right: Callable[[Floats], Floats]


def two_views_of(function: Function, unknowns: Unknowns, query: Query) -> tuple[TwoViews, NDArray[np.bool_]]:
    """Return queries as a visuomotor function sees them, and which of them (Q,) have any parameters."""
    Q, n = query.initial.shape[:2]
    width = unknowns.task.n_lift + 1
    known = np.asarray(np.isfinite(query.initial).all(axis=-1))
    code = query.initial[known]
    rows, own = function.parameters(code) if len(code) else (np.zeros((0, 2, 3, width)), np.zeros(0, bool))
    before, after, shift = views_of_codes(len(code), width)
    q = code[:, :3]
    y_right, y_slope, on_manifold, slope = _slopes(function, q, width)
    observed = rows
    rows = np.where(np.isfinite(on_manifold).all(axis=(1, 2, 3), keepdims=True), on_manifold, rows)
    sign = sign_at_rest(rows, unknowns.task.identity_lift)
    rows, slope, observed = rows * sign, slope * sign[None], observed * sign
    for column, i in zip((0, 1, 3), range(3), strict=True):
        after[:, :, :, column] = slope[i]
        shift[:, 1, 1, column] = y_slope[i]
    after[:, :, :, 2] = rows - np.einsum("imcrb,mi->mcrb", slope, q)
    shift[:, 1, 1, 2] = y_right - np.einsum("im,mi->m", y_slope, q)
    shift[:, 2:] = shift[:, :2]
    pixels = np.concatenate([query.initial, query.desired], axis=-1).reshape(Q, n, 4, 2)
    answered = np.zeros((Q, n), bool)
    answered[known] = np.isfinite(rows).all(axis=(1, 2, 3)) & np.isfinite(y_right)
    wanted = np.isfinite(pixels[:, :, 2:]).all(axis=-1).any(axis=-1)
    problem = TwoViews(
        unknowns=unknowns,
        pixels=pixels,
        used=answered & wanted,
        before=_spread(known, before),
        after=_spread(known, after),
        shift=_spread(known, shift),
        q=_spread(known, q),
    )
    has_parameters = np.asarray((answered & wanted).any(axis=1) | ~wanted.any(axis=1))
    own_targets = np.zeros((Q, n), bool)
    own_targets[known] = own
    return problem.with_known(own_targets & answered, _spread(known, observed)), has_parameters


def _slopes(function: Function, q: Floats, width: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return y_R (M,) and its slope (3, M), rows (M, 2, 3, k+1) there and theirs (3, M, 2, 3, k+1).

    Slopes are central differences. Where the function refuses a neighbour it says nothing: zero.
    """
    M = len(q)
    if not M:
        rows = np.zeros((0, 2, 3, width))
        return np.zeros(0), np.zeros((3, 0)), rows, np.zeros((3, *rows.shape))
    steps = _STEP_PX * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    around = (q + steps[:, None]).reshape(-1, 3)
    y = function.y_right(around)
    rows = function.parameters(np.column_stack([around, y]))[0].reshape(7, M, 2, 3, width)
    y = y.reshape(7, M)
    slope = (rows[1:4] - rows[4:]) / (2.0 * _STEP_PX)
    known = np.isfinite(slope).all(axis=(2, 3, 4), keepdims=True)
    return y[0], (y[1:4] - y[4:]) / (2.0 * _STEP_PX), rows[0], np.where(known, slope, 0.0)


def _spread(known: Bools, values: Floats) -> Floats:
    """Return values (M, …) in the places (Q, n) where `known`, zero elsewhere."""
    out = np.zeros((*known.shape, *values.shape[1:]))
    out[known] = values
    return out
