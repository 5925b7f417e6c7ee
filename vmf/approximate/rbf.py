"""A network of radial basis functions (§4.2.3) with a Gaussian kernel at the mean of every visited cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve, solve_triangular
from scipy.spatial.distance import cdist

from vmf.approximate.base import Approximator, Arrays, Floats, Prediction, chunk_by_chunk
from vmf.approximate.visited import Visited

# Kernels at centres close to each other are equal but for rounding, of a matrix of some thousand rows.
_ROUNDING = 1e-10


@dataclass(frozen=True)
class Network:
    """What is fitted.

    Attributes
    ----------
    centres : (L, 4) in px.
    mean : (d,) `w0`.
    weights : (L, d).
    cholesky : (L, L) lower factor of the covariance of one pair, or several, at every centre.
    """

    centres: Floats
    mean: Floats
    weights: Floats
    cholesky: Floats


class RadialBasis(Approximator):
    """`w0 + Σ w_i K(|s − s_i|)` with `K = exp(−½ (d/width)²)`, by regularised least squares.

    The centres are the means of the visited cells, at most `max_centres`: cells widen with what was visited
    (see `Visited`). `w0` is the mean of all pairs. Regularised with the variance of a pair's noise, over that
    of the function, this is the mean of a Gaussian process, whose variance says how far an answer can be
    known (Rasmussen and Williams 2006, Eq. 2.25–2.26). `support` is the noise's variance over that one: the
    number of pairs at the very code that would say as much. Codes where it is below one are refused.

    Parameters
    ----------
    width_px : standard deviation of the kernel.
    smoothing : variance of the noise of a pair of mean trust, over that of the function.
    max_centres : most kernels.
    """

    def __init__(self, width_px: float = 256.0, smoothing: float = 1e-3, max_centres: int = 1024) -> None:
        self.width_px, self.smoothing = width_px, smoothing
        self.visited = Visited(max_centres)
        self._network: Network | None = None

    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        self.visited.add(codes, parameters, weights)
        self._network = None

    def predict(self, codes: ArrayLike) -> Prediction:
        codes = np.asarray(codes, float)
        if not len(self.visited):
            return Prediction(np.full((len(codes), 1), np.nan), np.zeros(len(codes)))
        network = self._network = self._network or self._fit()
        return chunk_by_chunk(lambda part: self._predict(part, network), codes)

    def _predict(self, codes: Floats, network: Network) -> Prediction:
        K = self._kernel(codes, network.centres)
        explained = np.square(solve_triangular(network.cholesky, K.T, lower=True)).sum(axis=0)
        support = self.smoothing / np.maximum(1.0 - explained, np.finfo(float).eps)
        values = network.mean + K @ network.weights
        values[support < 1.0] = np.nan
        return Prediction(values, support)

    def _fit(self) -> Network:
        means = self.visited.means()
        K = self._kernel(means.codes, means.codes)
        mean = means.trust @ means.parameters / means.trust.sum()
        # Trust is relative, and so is the noise: what the mean pair has is `smoothing`.
        noise = self.smoothing * (means.trust.sum() / means.pairs.sum()) / means.trust
        noise = np.maximum(noise, _ROUNDING)
        weights = solve(K + np.diag(noise), means.parameters - mean, assume_a="pos")
        # How far a code can be known is a matter of where pairs are, not of how they compare.
        cholesky = np.linalg.cholesky(K + np.diag(self.smoothing / means.pairs))
        return Network(means.codes, mean, np.asarray(weights, float), np.asarray(cholesky, float))

    def _kernel(self, codes: Floats, centres: Floats) -> Floats:
        return np.asarray(np.exp(-0.5 * cdist(codes, centres, "sqeuclidean") / self.width_px**2))

    def state(self) -> dict[str, NDArray[Any]]:
        return self.visited.state()

    def restore(self, state: Arrays) -> None:
        self.visited.restore(state)
        self._network = None
