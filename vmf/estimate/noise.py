"""How pixels scatter: a multivariate Student t, from Gaussian to heavy-tailed.

Real trackers make small errors most of the time and large ones now and then. With ν degrees of freedom the
negative log-likelihood of a residual of d coordinates and squared norm s (in units of its scale) is
`½(ν+d) log(1 + s/ν)`: least squares for large ν, a redescending robust loss for small ones. K. L. Lange,
R. J. A. Little, J. M. G. Taylor, "Robust statistical modeling using the t distribution", JASA 1989.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

Floats = NDArray[np.float64]

# Scatter that looks Gaussian counts as this: 99 % as efficient there, and still proof against gross errors.
NEARLY_GAUSSIAN = 30.0
_FREEDOMS = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0, NEARLY_GAUSSIAN])
# A correspondence with less than this share of its weight, and too large for Gaussian noise, is called wrong.
_LEAST_WEIGHT = 0.25
# The scatter of a very good tracker (px).
BEST_TRACKER_PX = 0.1
_GAUSSIAN_LIMIT = 0.9999


@dataclass(frozen=True)
class Noise:
    """A multivariate Student t of pixel residuals.

    Attributes
    ----------
    scale_px : standard deviation of a coordinate in the Gaussian core (px).
    freedom : degrees of freedom ν; infinite for Gaussian noise.
    """

    scale_px: float
    freedom: float = NEARLY_GAUSSIAN

    @classmethod
    def of(cls, square: ArrayLike, coordinates: int) -> Noise:
        """Fit scale and freedom to squared residual norms (N,) in px² of so many coordinates each.

        The scale is set by the median, the freedom by likelihood; no finite norm gives a scale of NaN.
        """
        values: Floats = np.asarray(square, float).ravel()
        values = values[np.isfinite(values)]
        median = float(np.median(values)) if len(values) else float("nan")
        if not median > 0.0:
            return cls(median)
        # Squared norms over d σ² follow Fisher's F with (d, ν) degrees of freedom.
        scales = median / np.asarray(special.fdtri(coordinates, _FREEDOMS, 0.5))
        likelihood = _log_likelihood(values[:, None], scales, coordinates, _FREEDOMS)
        best = int(np.argmax(likelihood))
        return cls(float(np.sqrt(scales[best] / coordinates)), float(_FREEDOMS[best]))

    @property
    def of_a_tracker(self) -> Noise:
        """The same scatter, but no finer than any tracker's: what a model is off by must not look gross."""
        return Noise(max(self.scale_px, BEST_TRACKER_PX), self.freedom)

    def scaled(self, factor: float) -> Noise:
        """Return the same scatter, so many times as wide."""
        return Noise(factor * self.scale_px, self.freedom)

    def loss(self, square: Floats, coordinates: Floats) -> tuple[Floats, Floats]:
        """Return twice the negative log-likelihood, up to a constant, and its derivative.

        Parameters
        ----------
        square : squared residual norms in units of `scale_px`².
        coordinates : degrees of freedom d of each norm.
        """
        if np.isinf(self.freedom):
            return square, np.ones_like(square)
        total = self.freedom + coordinates
        return total * np.log1p(square / self.freedom), total / (self.freedom + square)

    def information(self, coordinates: Floats) -> Floats:
        """Return the Fisher information of a location, in units of that of a Gaussian (Lange et al.)."""
        if np.isinf(self.freedom):
            return np.ones_like(coordinates)
        return np.asarray((self.freedom + coordinates) / (self.freedom + coordinates + 2.0))

    def wrong(self, square: Floats, coordinates: Floats) -> NDArray[np.bool_]:
        """Tell which residuals are no noise but wrong correspondences; arguments as for `loss`."""
        far = square > special.chdtri(coordinates, 1.0 - _GAUSSIAN_LIMIT)
        return np.asarray(far & (self.weight(square) < _LEAST_WEIGHT))

    def weight(self, square: Floats) -> Floats:
        """Return how far (0 to 1) residuals of these squared norms, in units of `scale_px`², are trusted."""
        return np.asarray(1.0 / (1.0 + square / self.freedom))


def _log_likelihood(square: Floats, scale: Floats, d: int, freedom: Floats) -> Floats:
    """Return mean log-likelihoods (F,) of squared norms (N, 1): of F(d, ν) in units of scales (F,)."""
    x = d * square / (scale * freedom)
    constant = (
        0.5 * d * np.log(d / freedom) - special.betaln(0.5 * d, 0.5 * freedom) - 0.5 * d * np.log(scale)
    )
    return np.asarray(np.mean(constant - 0.5 * (d + freedom) * np.log1p(x), axis=0))
