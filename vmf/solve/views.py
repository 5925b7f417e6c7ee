"""What a most likely motion is found from: residuals of targets, and their equations for many queries."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.optimise import ArrowFit, Equations, minimise_arrow
from vmf.solve.unknowns import Unknowns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# To a robust loss, a target behind a camera is this far off (px).
NOWHERE_PX = 1e4
# Relative gains in cost at which a minimisation ends. A cost of some hundred σ² that is off by the second one
# leaves the motion within 1e-3 standard errors.
_EXACT = 1e-13
_LIKELY = 1e-9


@dataclass(frozen=True)
class Fits:
    """Residuals of T targets of A queries.

    Attributes
    ----------
    query, target : (T,) to which query, counted from 0 to A − 1, and which of its targets each belongs.
    r : (T, d) px; zero where not seen, NaN behind a camera.
    J_x, J_q : (T, d, f) and (T, d, m) derivatives with respect to the motion and to the target's place.
    """

    query: Ints
    target: Ints
    r: Floats
    J_x: Floats
    J_q: Floats

    @property
    def square(self) -> Floats:
        """Squared residual norms (T,) in px²."""
        return np.asarray(np.square(self.r).sum(axis=-1))

    def with_lost_targets(self) -> Fits:
        """Return the same with targets behind a camera off by a constant, whatever the motion."""
        lost = ~(np.isfinite(self.r).all(axis=-1) & np.isfinite(self.J_x).all(axis=(-1, -2)))
        if not lost.any():
            return self
        r, J_x, J_q = self.r.copy(), self.J_x.copy(), self.J_q.copy()
        r[lost], J_x[lost], J_q[lost] = NOWHERE_PX, 0.0, 0.0
        return Fits(self.query, self.target, r, J_x, J_q)

    @property
    def J(self) -> Floats:
        """`J_x` (T, d, f) less what a change of the target's place makes up for."""
        if not self.J_q.shape[-1]:
            return self.J_x
        span: Floats = np.linalg.qr(self.J_q).Q
        return np.asarray(self.J_x - span @ (np.swapaxes(span, -1, -2) @ self.J_x), float)


@dataclass(frozen=True)
class Views(ABC):
    """Q queries of n targets, as functions of the motion and of m unknowns of each target's own.

    Attributes
    ----------
    unknowns : of the motions.
    used : (Q, n) targets that count.
    q : (Q, n, m) where the targets' own unknowns start; NaN for a start from what is seen.
    """

    unknowns: Unknowns
    used: Bools
    q: Floats

    @property
    @abstractmethod
    def coordinates_seen(self) -> Ints:
        """How many coordinates of each target (Q, n) are predicted."""

    @abstractmethod
    def fits(self, x: Floats, q: Floats, index: Ints) -> Fits:
        """Return residuals at motions x (A, f) and places q (A, n, m) of the queries `index`."""

    @abstractmethod
    def equations(self, x: Floats, q: Floats, index: Ints, noise: Noise | None = None) -> Equations:
        """Return costs and normal equations at motions x (A, f) and places q (A, n, m)."""

    def starts(self, x: Floats, index: Ints) -> Floats:
        """Return places q (A, n, m) to start from at motions x (A, f) of the queries `index`."""
        return self.q[index]

    @property
    def n_equations(self) -> Ints:
        """Coordinates (Q,) that count."""
        return np.asarray(self.coordinates_seen.sum(axis=1))

    @property
    def n_spare(self) -> Ints:
        """Equations (Q,) beyond the unknowns of targets and motion."""
        own = self.q.shape[-1] * self.used.sum(axis=1)
        return np.asarray(self.n_equations - own - self.unknowns.n_free)

    def coordinates(self, index: Ints) -> Floats:
        """Return what is left of each target's coordinates (A, n) when its place is taken off, at least 1."""
        left = self.coordinates_seen[index] - float(self.q.shape[-1])
        return np.asarray(np.maximum(left, 1.0))

    def minimise(
        self, start: Floats, index: Ints, noise: Noise | None = None, tolerance: float | None = None
    ) -> ArrowFit:
        """Minimise over the motions of the queries `index` and their targets' places from motions (A, f).

        Without `noise` the cost is half the squared residual; with it, half its losses in px². `tolerance` is
        the relative gain at which to end: by default rounding, or a thousandth of a standard error.
        """
        if tolerance is None:
            tolerance = _EXACT if noise is None else _LIKELY

        def problem(x: Floats, q: Floats, running: Ints) -> Equations:
            return self.equations(x, q, index[running], noise)

        return minimise_arrow(problem, start, self.starts(start, index), cost_tolerance=tolerance)


def losses(square: Floats, coordinates: Floats, noise: Noise | None) -> tuple[Floats, Floats]:
    """Return losses (…,) in px² of squared residual norms in px², and their slopes."""
    if noise is None:
        return square, np.ones_like(square)
    loss, slope = noise.loss(square / noise.scale_px**2, coordinates)
    return loss * noise.scale_px**2, slope
