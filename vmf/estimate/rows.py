"""The linear equations of one centre and their triangular factor (Eq. 3.46–3.48).

For a motion with lift x̄ and an image-based error e, the two augmented rows

    [ x̄ | 0 | −e_x ℓ | e_x ]    [ 0 | x̄ | −e_y ℓ | e_y ]

hold both problems: least squares with the constant of c fixed to 1 (last column on the right), and, with
the sign of the last column turned, the homogeneous equations `a·x̄ − e_x c·x̄ = 0`. One upper-triangular
factor of 3k+3 columns therefore serves every linear estimator.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def augmented_rows(x_bar: ArrayLike, e: ArrayLike) -> Floats:
    """Return the augmented row pairs (…, 2, 3k+3) of lifts (…, k+1) and errors (…, 2) in px."""
    x_bar, e = np.asarray(x_bar, float), np.asarray(e, float)
    n = x_bar.shape[-1]
    rows = np.zeros((*np.broadcast_shapes(x_bar.shape[:-1], e.shape[:-1]), 2, 3 * n))
    rows[..., 0, :n] = x_bar
    rows[..., 1, n : 2 * n] = x_bar
    rows[..., 2 * n : -1] = -e[..., :, None] * x_bar[..., None, :-1]
    rows[..., -1] = e
    return rows


def triangle(A: Floats) -> Floats:
    """Return the factors (…, min(m, n), n) of the QR decompositions of A (…, m, n), by LAPACK."""
    m, n = A.shape[-2:]
    # The raw form, so that the reflections below the diagonal are cleared by a mask made once.
    h, _ = np.linalg.qr(A, mode="raw")
    rows = min(m, n)
    return np.asarray(np.swapaxes(h, -1, -2)[..., :rows, :] * _upper(rows, n))


@lru_cache(maxsize=256)
def _upper(m: int, n: int) -> Floats:
    return np.triu(np.ones((m, n)))


def update_rank_k(R: ArrayLike, rows: ArrayLike) -> Floats:
    """Return the factors (…, n, n) after adding rows (…, m, n), by LAPACK QR (Eq. 3.48)."""
    R, rows = np.asarray(R, float), np.asarray(rows, float)
    R = np.broadcast_to(R, (*rows.shape[:-2], *R.shape[-2:]))
    return triangle(np.concatenate([R, rows], axis=-2))


def update_rank_1(R: ArrayLike, row: ArrayLike) -> Floats:
    """Return the factor (n, n) after adding one row (n,), by n Givens rotations (§3.3)."""
    R, row = np.array(R, float), np.array(row, float)
    for j in range(len(row)):
        if row[j] == 0.0:
            continue
        radius = np.hypot(R[j, j], row[j])
        c, s = R[j, j] / radius, row[j] / radius
        R[j, j:], row[j:] = c * R[j, j:] + s * row[j:], c * row[j:] - s * R[j, j:]
    return R


def homogeneous(R: Floats) -> Floats:
    """Return the factor of the homogeneous equations over (a, b, c), all 3k+3 of them."""
    H = np.array(R)
    H[..., -1] *= -1.0
    return H
