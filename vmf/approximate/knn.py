"""K nearest neighbours (§4.2.1)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vmf.approximate.base import Floats
from vmf.approximate.neighbours import Neighbours, normalised

Averaging = Literal["inverse_distance", "uniform"]


class NearestNeighbours(Neighbours):
    """Mean of the nearest visited codes' parameters.

    Parameters
    ----------
    neighbours, radius_px, max_pairs : as of `Neighbours`.
    averaging : by inverse distance, where a visited code answers for itself, or uniform.
    """

    def __init__(
        self,
        neighbours: int = 4,
        averaging: Averaging = "inverse_distance",
        radius_px: float = 64.0,
        max_pairs: int = 65536,
    ) -> None:
        super().__init__(neighbours, radius_px, max_pairs)
        self.averaging = averaging

    def _shares(self, distance: Floats, offsets: Floats, trust: Floats) -> Floats:
        if self.averaging == "uniform":
            return normalised(trust)
        here = distance == 0.0
        inverse = 1.0 / np.where(here, 1.0, distance)
        return normalised(trust * np.where(here.any(axis=1, keepdims=True), here, inverse))
