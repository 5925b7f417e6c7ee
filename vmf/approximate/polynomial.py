"""A polynomial in the stereo code, by recursive least squares.

In the unit-depth gauge the parameters of a parallel rig are exactly of degree 2 in (x_L, y_L, disparity)
(§2), so this approximator is exact there and a smooth one elsewhere.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate.base import Approximator, Arrays, Floats, Prediction

# Codes are centred and scaled by fixed numbers of the size of an image, so that monomials stay near 1.
_CENTRE_PX = 256.0
_SCALE_PX = 256.0
# A ridge this small only decides what no code has ever said, e.g. about y_L − y_R without noise.
_RIDGE = 1e-6


class Polynomial(Approximator):
    """All monomials up to a degree; `support` is the number of samples an answer is worth.

    The support of a code is the inverse of its leverage: a code in the middle of N samples has about N over
    the number of monomials, one far outside has less than one and is refused.
    """

    def __init__(self, degree: int = 2) -> None:
        self.exponents = [c for d in range(degree + 1) for c in combinations_with_replacement(range(4), d)]
        n = len(self.exponents)
        self._R = _RIDGE * np.eye(n)
        self._z: Floats | None = None

    def _features(self, codes: ArrayLike) -> Floats:
        q = (np.asarray(codes, float) - _CENTRE_PX) / _SCALE_PX
        columns = [np.prod(q[:, list(c)], axis=1) if c else np.ones(len(q)) for c in self.exponents]
        return np.stack(columns, axis=1)

    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        X, theta = self._features(codes), np.asarray(parameters, float)
        if weights is not None:
            trust = np.sqrt(np.asarray(weights, float))[:, None]
            X, theta = trust * X, trust * theta
        n = len(self.exponents)
        if self._z is None:
            self._z = np.zeros((n, theta.shape[1]))
        stack = np.concatenate([np.column_stack([self._R, self._z]), np.column_stack([X, theta])])
        R = np.asarray(np.linalg.qr(stack, mode="r"))[:n]
        self._R, self._z = R[:, :n], R[:, n:]

    def predict(self, codes: ArrayLike) -> Prediction:
        X = self._features(codes)
        if self._z is None:
            return Prediction(np.full((len(X), 1), np.nan), np.zeros(len(X)))
        coefficients = np.linalg.solve(self._R, self._z)
        leverage = np.square(np.linalg.solve(self._R.T, X.T)).sum(axis=0)
        support = 1.0 / leverage
        values = X @ coefficients
        values[support < 1.0] = np.nan
        return Prediction(values, support)

    def state(self) -> dict[str, NDArray[Any]]:
        z = np.zeros((len(self.exponents), 0)) if self._z is None else self._z
        return {"R": self._R.copy(), "z": z.copy()}

    def restore(self, state: Arrays) -> None:
        n = len(self.exponents)
        R, z = np.array(state["R"], float), np.array(state["z"], float)
        if R.shape != (n, n) or z.ndim != 2 or len(z) != n:
            raise ValueError(f"R {R.shape} and z {z.shape} are not of {n} terms")
        self._R = R
        self._z = z if z.shape[1] else None
