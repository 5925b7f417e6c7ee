"""The trained region: where in stereo space codes have been seen, and how far outside of it a code lies.

Codes of points lie on a three-dimensional visible manifold (§6.3), for most rigs nearly a hyperplane. The
region is the convex hull of the trained codes along their three main directions, and the interval they
cover along what is left, both widened by what noise and the gaps between codes account for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog, nnls
from scipy.spatial import ConvexHull, cKDTree

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Directions in which codes of points vary freely.
_MANIFOLD = 3
# The margin in σ, and what counts as varying where there is no noise at all (px).
_SIGMAS = 3.0
_LEAST_PX = 0.5
# Fewer codes than this say nothing about which of them are wrong.
_FEWEST_TO_TRIM = 20
# Off the visible manifold: this many robust σ, but at least so many px; a few rounds settle it.
_OFF_MANIFOLD = 4.0
_OFF_MANIFOLD_PX = 3.0
_ROUNDS = 10
# Alone: the fifth-nearest code is this many times farther away than it typically is.
_NEIGHBOURS = 5
_ALONE = 6.0
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class Region:
    """A convex region of stereo space, `normals @ code <= offsets`.

    Attributes
    ----------
    normals : (F, 4) outward unit vectors.
    offsets : (F,) in px.
    """

    normals: Floats
    offsets: Floats

    @classmethod
    def of(cls, codes: ArrayLike, noise_px: float | None = None) -> Region:
        """Return the region of trained codes.

        Parameters
        ----------
        codes : (N, 4) `x_L, y_L, x_R, y_R` (px); those not seen by both cameras do not count.
        noise_px : standard deviation of a coordinate.

        Raises
        ------
        ValueError : no code was seen by both cameras.
        """
        given = np.asarray(codes, float).reshape(-1, 4)
        given = given[np.isfinite(given).all(axis=1)]
        if not len(given):
            raise ValueError("no code was seen by both cameras")
        kept = _trimmed(given)
        centre = kept.mean(axis=0)
        variance, axes = np.linalg.eigh(np.cov(kept - centre, rowvar=False, ddof=0))
        axes = axes.T[::-1]
        noise = noise_px or 0.0
        varying = np.sqrt(np.maximum(variance[::-1], 0.0)) > max(noise, _LEAST_PX)
        normals, offsets = _hull((kept - centre) @ axes.T, min(int(varying.sum()), _MANIFOLD))
        # A hull of draws falls short of where they come from by about the gaps between them.
        gaps = _spacing(kept) * np.linalg.norm(normals[:, varying], axis=1)
        normals = normals @ axes
        return cls(normals, offsets + normals @ centre + max(_SIGMAS * noise, _LEAST_PX) + gaps)

    def outside_px(self, codes: ArrayLike) -> Floats:
        """Return how far (M,) codes (M, 4) lie outside, in px: 0 inside.

        A code that one camera sees lies at least so far outside, wherever the other would see it (the largest
        of its two coordinates' distances); NaN for codes that no camera sees.
        """
        codes = np.asarray(codes, float)
        excess = codes @ self.normals.T - self.offsets
        distance = np.where(np.isnan(excess).any(axis=1), np.nan, 0.0)
        for i in np.nonzero((excess > 0.0).any(axis=1))[0]:
            distance[i] = _least_distance(self.normals, excess[i])
        for i in np.nonzero(np.isfinite(codes).any(axis=1) & np.isnan(distance))[0]:
            distance[i] = self._at_least(codes[i])
        return distance

    def _at_least(self, code: Floats) -> float:
        """Return the least t for which a code with the seen coordinates within t is in the region."""
        seen = np.isfinite(code)
        k = int(seen.sum())
        # Unknowns: how far to move what is seen, where what is not seen is, and t.
        move = np.concatenate([np.eye(k), np.zeros((k, 4 - k))], axis=1)
        bounds = np.concatenate([move, -move])
        A = np.concatenate([self.normals[:, seen], self.normals[:, ~seen]], axis=1)
        limits = np.concatenate([self.offsets - self.normals[:, seen] @ code[seen], np.zeros(2 * k)])
        matrix = np.block([[A, np.zeros((len(A), 1))], [bounds, -np.ones((2 * k, 1))]])
        cost = np.append(np.zeros(4), 1.0)
        found = linprog(cost, A_ub=matrix, b_ub=limits, bounds=(None, None))
        return max(float(found.fun), 0.0) if found.fun is not None else float("nan")


def _least_distance(normals: Floats, excess: Floats) -> float:
    """Return the length of the shortest x with `normals @ x <= -excess`.

    Least distance programming by way of non-negative least squares (Lawson and Hanson 1974, ch. 23).
    """
    # In units of the largest excess, so that tolerances mean the same for all codes.
    size = float(excess.max())
    E = np.vstack([-normals.T, excess / size])
    f = np.array([0.0, 0.0, 0.0, 0.0, 1.0])
    u, _ = nnls(E, f, maxiter=10 * len(excess) + 100)
    r = E @ u - f
    return float(size * np.linalg.norm(r[:4]) / -r[4])


def _trimmed(codes: Floats) -> Floats:
    """Leave out codes off the visible manifold, then codes that are far from all others."""
    if len(codes) < _FEWEST_TO_TRIM:
        return codes
    codes = codes[_on_manifold(codes)]
    distance = _distance_to_neighbour(codes, min(_NEIGHBOURS, len(codes) - 1))
    return codes[distance <= _ALONE * max(float(np.median(distance)), _LEAST_PX)]


def _on_manifold(codes: Floats) -> Bools:
    """Tell which codes (N,) are near the hyperplane of least spread, fitted to those that are."""
    keep = np.ones(len(codes), bool)
    for _ in range(_ROUNDS):
        _, axes = np.linalg.eigh(np.cov(codes[keep], rowvar=False))
        off = codes @ axes[:, 0]
        off = np.abs(off - np.median(off[keep]))
        scatter = _MAD_TO_SIGMA * float(np.median(off[keep]))
        now = off <= max(_OFF_MANIFOLD * scatter, _OFF_MANIFOLD_PX)
        if (now == keep).all():
            break
        keep = now
    return keep


def _spacing(codes: Floats) -> float:
    """Return how far apart neighbouring codes typically are."""
    different = np.unique(codes, axis=0)
    return float(np.median(_distance_to_neighbour(different, 1))) if len(different) > 1 else 0.0


def _distance_to_neighbour(codes: Floats, number: int) -> Floats:
    """Return the distance (N,) of each code to its nearest, second nearest, … neighbour."""
    distance, _ = cKDTree(codes).query(codes, k=[number + 1])
    return np.asarray(distance, float).reshape(-1)


def _hull(z: Floats, rank: int) -> tuple[Floats, Floats]:
    """Return half-spaces around points z (N, 4): a hull over the first `rank` axes, intervals over others."""
    normals, offsets = [np.zeros((0, 4))], [np.zeros(0)]
    eye = np.eye(4)
    # In their principal axes, codes are never flat along those that vary, as the hull needs them.
    hulled = rank if rank >= 2 else 0
    if hulled:
        equations = ConvexHull(z[:, :hulled]).equations
        normals.append(equations[:, :hulled] @ eye[:hulled])
        offsets.append(-equations[:, hulled])
    normals += [eye[hulled:], -eye[hulled:]]
    offsets += [z[:, hulled:].max(axis=0), -z[:, hulled:].min(axis=0)]
    return np.concatenate(normals), np.concatenate(offsets)
