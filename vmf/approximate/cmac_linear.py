"""A CMAC whose cells are affine functions of the stereo code: no bias to first order (§5)."""

from __future__ import annotations

import numpy as np

from vmf.approximate.base import Floats
from vmf.approximate.cmac import Cmac, NewTiles
from vmf.approximate.tiling import Displacement

# Offsets spread evenly over a tile, −½ to ½, have this standard deviation's inverse: slopes and constants
# then weigh alike in the normalised step.
_SLOPE = float(np.sqrt(12.0))


class CmacLinear(Cmac):
    """Sum of T affine functions of where the code lies in its tiles, counted from their middles.

    The basis vector of Eq. 4.8 holds `1` and the four offsets of every tile, so the step is Kaczmarz's (and
    normalised least mean squares'): `w ← w + ε e b/‖b‖²`. Parameters are as of `Cmac`.
    """

    # Weights of a tile: its constant and four slopes.
    n_features = 5

    def __init__(
        self,
        overlays: int = 32,
        tile_px: float = 192.0,
        displacement: Displacement = "uniform",
        table_size: int = 65536,
        step: float = 0.5,
        epochs: int = 4,
        min_support: float = 0.25,
        new_tiles: NewTiles = "first_visit",
    ) -> None:
        super().__init__(
            overlays, tile_px, displacement, table_size, step, epochs, min_support, new_tiles=new_tiles
        )

    def _features(self, codes: Floats) -> Floats:
        offsets = _SLOPE * self.tiling.offsets(codes)
        return np.concatenate([np.ones((*offsets.shape[:2], 1)), offsets], axis=-1)
