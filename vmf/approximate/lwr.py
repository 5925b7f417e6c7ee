"""Locally weighted regression (§4.2.2): an affine fit through the neighbours of each code that is asked."""

from __future__ import annotations

import numpy as np

from vmf.approximate.base import Floats
from vmf.approximate.neighbours import Neighbours, normalised


class LocallyWeightedRegression(Neighbours):
    """Weighted least squares over the nearest visited codes, with a Gaussian kernel (Atkeson et al. 1997).

    Parameters
    ----------
    neighbours, radius_px, max_pairs : as of `Neighbours`.
    bandwidth_px : standard deviation of the kernel.
    ridge_px : slopes are fitted as if the neighbours were spread by this much more on every axis, which only
        decides about directions in which they are not, such as y_L − y_R without noise.
    """

    def __init__(
        self,
        neighbours: int = 64,
        bandwidth_px: float = 64.0,
        radius_px: float = 128.0,
        ridge_px: float = 0.3,
        max_pairs: int = 65536,
    ) -> None:
        super().__init__(neighbours, radius_px, max_pairs)
        self.bandwidth_px, self.ridge_px = bandwidth_px, ridge_px

    def _shares(self, distance: Floats, offsets: Floats, trust: Floats) -> Floats:
        # Kernels count from the nearest neighbour's, as all may vanish.
        square = np.square(distance / self.bandwidth_px)
        nearest = np.where(np.isfinite(square[:, :1]), square[:, :1], 0.0)
        W = normalised(trust * np.exp(-0.5 * (square - nearest)))[..., None]
        X = np.concatenate([np.ones_like(W), offsets / self.bandwidth_px], axis=-1)
        XtW = np.swapaxes(X * W, -1, -2)
        ridge = (self.ridge_px / self.bandwidth_px) ** 2
        A = XtW @ X + np.diag([0.0, ridge, ridge, ridge, ridge])
        A[~W.any(axis=(1, 2)), 0, 0] = 1.0
        # The value of the fit at offset 0 is the first entry of (XᵀWX + λ)⁻¹ XᵀW y.
        return np.asarray(np.linalg.solve(A, XtW)[:, 0])
