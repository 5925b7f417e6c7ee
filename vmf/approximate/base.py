"""From visited stereo codes to all codes: the interface of every approximator of Θ_S (Chapter 4)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]

# Codes answered at once, where every one of them takes much memory.
_CHUNK = 256


@dataclass(frozen=True)
class Prediction:
    """Parameters at M codes.

    Attributes
    ----------
    parameters : (M, d), NaN where the approximator refuses.
    support : (M,) how much data stands behind each answer, 0 for none; the unit is the approximator's.
    """

    parameters: Floats
    support: Floats

    @property
    def refused(self) -> NDArray[np.bool_]:
        """Which codes (M,) have no answer."""
        return np.asarray(np.isnan(self.parameters).any(axis=-1))


def chunk_by_chunk(predict: Callable[[Floats], Prediction], codes: Floats) -> Prediction:
    """Answer codes (M, 4) a few at a time, in bounded memory."""
    parts = [predict(codes[begin : begin + _CHUNK]) for begin in range(0, max(len(codes), 1), _CHUNK)]
    return Prediction(
        np.concatenate([part.parameters for part in parts]), np.concatenate([part.support for part in parts])
    )


class Approximator(ABC):
    """Learns parameters (N, d) at stereo codes (N, 4) and answers any code, or refuses it."""

    @abstractmethod
    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        """Learn parameters (N, d) at codes (N, 4) in px, in this order.

        `weights` (N,) from 0 to 1 say how far each pair is to be trusted; all fully by default.
        """

    @abstractmethod
    def predict(self, codes: ArrayLike) -> Prediction:
        """Answer codes (M, 4) in px."""

    @abstractmethod
    def state(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that make an equal approximator with `restore`."""

    @abstractmethod
    def restore(self, state: Arrays) -> None:
        """Take over the arrays of `state`."""
