"""What K nearest neighbours and locally weighted regression share (§4.2.1–4.2.2)."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate.base import Approximator, Arrays, Floats, Prediction, chunk_by_chunk
from vmf.approximate.visited import Means, Visited

# A code that was visited once, and has no neighbours, averages one pair but for rounding.
_ONE = 1.0 - 1e-9


class Neighbours(Approximator):
    """A weighted sum of the parameters of the nearest visited codes, found with a k-d tree.

    `support` is the number of pairs that the sum averages: the inverse of what it leaves of the variance of a
    pair, `1 / Σ share²` (Kish). Codes where it is below one are refused: none was visited within the radius,
    or the sum makes more of the pairs' noise instead of less.

    Parameters
    ----------
    neighbours : K.
    radius_px : visited codes farther away do not count.
    max_pairs : bound of the memory, see `Visited`.
    """

    def __init__(self, neighbours: int, radius_px: float, max_pairs: int) -> None:
        self.neighbours, self.radius_px = neighbours, radius_px
        self.visited = Visited(max_pairs)

    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        self.visited.add(codes, parameters, weights)

    def predict(self, codes: ArrayLike) -> Prediction:
        codes = np.asarray(codes, float)
        if not len(self.visited):
            return Prediction(np.full((len(codes), 1), np.nan), np.zeros(len(codes)))
        means = self.visited.means()
        return chunk_by_chunk(lambda part: self._predict(part, means), codes)

    def _predict(self, codes: Floats, means: Means) -> Prediction:
        distance, cell = self.visited.nearest(codes, self.neighbours, self.radius_px)
        trust = np.where(np.isfinite(distance), means.trust[cell], 0.0)
        share = self._shares(distance, means.codes[cell] - codes[:, None], trust)
        left = (np.square(share) / means.pairs[cell]).sum(axis=1)
        support = np.where(left > 0.0, 1.0 / np.where(left > 0.0, left, 1.0), 0.0)
        values = np.einsum("mk,mkd->md", share, means.parameters[cell])
        values[support < _ONE] = np.nan
        return Prediction(values, support)

    @abstractmethod
    def _shares(self, distance: Floats, offsets: Floats, trust: Floats) -> Floats:
        """Return the shares (M, k) of neighbours at distances (M, k) and offsets (M, k, 4), in px.

        Their trust (M, k) is 0 beyond the radius; without any, all shares are zero.
        """

    def state(self) -> dict[str, NDArray[Any]]:
        return self.visited.state()

    def restore(self, state: Arrays) -> None:
        self.visited.restore(state)


def normalised(weights: Floats) -> Floats:
    """Return weights (M, k) with sum one, or zeros where all are zero."""
    total = weights.sum(axis=1, keepdims=True)
    return weights / np.where(total > 0.0, total, 1.0)
