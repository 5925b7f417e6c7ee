"""No approximation: visited codes answer with their own parameters, all others are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate.base import Approximator, Arrays, Floats, Prediction


class Lookup(Approximator):
    """A table from each visited code to the parameters learned there last; `support` counts the visits."""

    def __init__(self) -> None:
        self._row: dict[bytes, int] = {}
        self._codes: list[Floats] = []
        self._parameters: list[Floats] = []
        self._visits: list[float] = []

    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        for code, theta in zip(np.array(codes, float), np.array(parameters, float), strict=True):
            row = self._row.setdefault(code.tobytes(), len(self._codes))
            if row == len(self._codes):
                self._codes.append(code)
                self._parameters.append(theta)
                self._visits.append(1.0)
            else:
                self._parameters[row] = theta
                self._visits[row] += 1.0

    def predict(self, codes: ArrayLike) -> Prediction:
        codes = np.asarray(codes, float)
        if not self._codes:
            return Prediction(np.full((len(codes), 1), np.nan), np.zeros(len(codes)))
        row = np.array([self._row.get(code.tobytes(), -1) for code in codes], dtype=int)
        known = row >= 0
        values = np.where(known[:, None], np.stack(self._parameters)[row], np.nan)
        return Prediction(values, np.where(known, np.array(self._visits)[row], 0.0))

    def state(self) -> dict[str, NDArray[Any]]:
        width = len(self._parameters[0]) if self._parameters else 0
        return {
            "codes": np.array(self._codes).reshape(-1, 4),
            "parameters": np.array(self._parameters).reshape(len(self._parameters), width),
            "visits": np.array(self._visits),
        }

    def restore(self, state: Arrays) -> None:
        self._codes = list(np.array(state["codes"], float))
        self._parameters = list(np.array(state["parameters"], float))
        self._visits = [float(v) for v in state["visits"]]
        self._row = {code.tobytes(): i for i, code in enumerate(self._codes)}
