"""What a run says beside its motions: condition numbers of tiles, errors of reconstructed points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.data import Truth
from vmf.geometry import triangulate
from vmf.reconstruct import RigModel
from vmf.solve import Query

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CONDITION = ("frame", "n", "n_singular", "median", "p05", "p95")
POINTS = ("component", "unit", "n", "mean", "std")


def condition_table(frames: Ints, condition: Floats) -> pd.DataFrame:
    """Return the content of `condition.csv`, the condition number of a tile of the first view's code.

    Parameters
    ----------
    frames : (F,) frames learned.
    condition : (T, F) of each trial, not finite where the tile's equations are singular.
    """
    rows = []
    for frame, values in zip(frames.tolist(), condition.T, strict=True):
        known = values[np.isfinite(values)]
        quantiles = np.percentile(known, [50, 5, 95]).tolist() if len(known) else [np.nan] * 3
        rows.append((frame, len(known), len(values) - len(known), *quantiles))
    return pd.DataFrame(rows, columns=list(CONDITION))


def reconstructed_off(model: RigModel, query: Query, truth: Truth) -> Floats:
    """Return how far (m, 3) points triangulated with exact cameras are from the true ones, in S (m).

    They are those of the initial views, by least reprojection error (§7).
    """
    codes, points = query.initial.reshape(-1, 4), truth.points.reshape(-1, 3)
    seen = np.isfinite(codes).all(axis=1)
    found = triangulate(model.cameras(), codes[seen])
    return np.asarray((found.points - points[seen])[found.ok])


def point_errors(off: Sequence[Floats]) -> pd.DataFrame | None:
    """Return the content of `points.csv`: statistics of |error| on each axis; None without any point."""
    every = np.abs(np.concatenate([np.zeros((0, 3)), *off]))
    if not len(every):
        return None
    std = every.std(axis=0, ddof=1) if len(every) > 1 else np.full(3, np.nan)
    rows = [
        (name, "m", len(every), mean, deviation)
        for name, mean, deviation in zip("xyz", every.mean(axis=0).tolist(), std.tolist(), strict=True)
    ]
    return pd.DataFrame(rows, columns=list(POINTS))
