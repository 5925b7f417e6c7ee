"""Where stereo codes can lie: three numbers of a code decide the fourth (§6.3)."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.estimate.robust import huber

Floats = NDArray[np.float64]

_EXPONENTS = [c for d in range(3) for c in combinations_with_replacement(range(3), d)]
_ROUNDS = 5
# Only decides what no code has ever said.
_RIDGE = 1e-6


class VisibleManifold:
    """`y_R` as a polynomial of degree 2 in `(x_L, y_L, x_R)`, fitted robustly to visited codes.

    For a parallel rig it is linear; verged or rotated cameras and lenses bend it slightly.

    Parameters
    ----------
    codes : (N, 4) visited stereo codes (px), none of them NaN.
    """

    def __init__(self, codes: ArrayLike) -> None:
        codes = np.asarray(codes, float)
        q = codes[:, :3]
        self._centre = q.mean(axis=0) if len(q) else np.zeros(3)
        self._scale = float(q.std()) + 1.0 if len(q) else 1.0
        X, y = self._features(q), codes[:, 3]
        ridge = _RIDGE * max(len(q), 1) * np.eye(X.shape[1])
        weight = np.ones(len(y))
        for _ in range(_ROUNDS):
            WX = X * weight[:, None]
            self._coefficients = np.linalg.solve(WX.T @ X + ridge, WX.T @ y)
            r = y - X @ self._coefficients
            size = np.abs(r)
            scale = float(np.median(size)) / 0.6745 if len(r) else 0.0
            weight = huber(size / max(scale, 1e-9))

    def _features(self, q: Floats) -> Floats:
        z = (q - self._centre) / self._scale
        columns = [np.prod(z[:, list(c)], axis=1) if c else np.ones(len(z)) for c in _EXPONENTS]
        return np.stack(columns, axis=1)

    def y_right(self, q: Floats) -> Floats:
        """Return `y_R` (M,) at `(x_L, y_L, x_R)` (M, 3), px."""
        return np.asarray(self._features(q) @ self._coefficients)
