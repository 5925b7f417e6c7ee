"""Queries whose parameters hold for the initial codes as they were observed: only the motion is unknown.

Where a target ends then depends on nothing but the motion, so that most likely is the geometric cost with
the loss of the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vmf.data.query import Query
from vmf.estimate import sign_at_rest
from vmf.estimate.noise import Noise
from vmf.optimise import Equations
from vmf.solve.costs import geometric
from vmf.solve.lifted_views import LiftedViews
from vmf.solve.unknowns import Unknowns
from vmf.solve.views import NOWHERE_PX, Fits, Views, losses

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class KnownViews(Views):
    """Q queries of n targets with known parameters, as functions of the motion alone: m = 0.

    Attributes
    ----------
    rows : (Q, n, 2, 3, k+1) parameters, positive at rest; anything where not seen.
    errors : (Q, n, 2, 2) image-based errors, left and right (px); NaN where not seen.
    """

    rows: Floats
    errors: Floats

    @classmethod
    def of(cls, unknowns: Unknowns, rows: Floats, query: Query) -> tuple[KnownViews, Bools]:
        """Return queries with parameters (Q, n, 2, 3, k+1), and which of them (Q,) have any."""
        at_hand = np.asarray(np.isfinite(rows).all(axis=(2, 3, 4)) & np.isfinite(query.initial).all(axis=-1))
        errors = (query.desired - query.initial).reshape(*at_hand.shape, 2, 2)
        seen = np.isfinite(query.desired).reshape(errors.shape)
        wanted = np.asarray((seen[..., 0] & seen[..., 1]).any(axis=-1))
        rows = rows * sign_at_rest(rows, unknowns.task.identity_lift)
        used = at_hand & wanted
        problem = cls(unknowns, used, np.zeros((*used.shape, 0)), rows, errors)
        return problem, np.asarray(used.any(axis=1) | ~wanted.any(axis=1))

    @property
    def coordinates_seen(self) -> Ints:
        return np.asarray(2 * self._seen.sum(axis=-1))

    def fits(self, x: Floats, q: Floats, index: Ints) -> Fits:
        r, J = self._residuals(x, index)
        a, j = np.nonzero(self.used[index])
        f = J.shape[1]
        r, J = r.transpose(0, 2, 1, 3)[a, j], J.transpose(0, 3, 2, 4, 1)[a, j]
        return Fits(a, j, r.reshape(len(a), 4), J.reshape(len(a), 4, f), np.zeros((len(a), 4, 0)))

    def equations(self, x: Floats, q: Floats, index: Ints, noise: Noise | None = None) -> Equations:
        r, J = self._residuals(x, index)
        if noise is not None:
            lost = np.asarray(~np.isfinite(r).all(axis=(1, 3)))
            if lost.any():
                r = np.where(lost[:, None, :, None], NOWHERE_PX, r)
                J = np.where(lost[:, None, None, :, None], 0.0, J)
        loss, weight = losses(np.square(r).sum(axis=(1, 3)), self.coordinates(index), noise)
        A, f, _, n, _ = J.shape
        # Gauss–Newton with the loss's slope as weight: its gradient is exact.
        weighted = (J * weight[:, None, None, :, None]).reshape(A, f, -1)
        H = weighted @ J.reshape(A, f, -1).swapaxes(1, 2)
        g = (weighted @ r.reshape(A, -1, 1))[..., 0]
        nothing = np.zeros((A, n, 0))
        return Equations(
            0.5 * loss.sum(axis=1), H, np.zeros((A, n, f, 0)), np.zeros((A, n, 0, 0)), g, nothing
        )

    def _residuals(self, x: Floats, index: Ints) -> tuple[Floats, Floats]:
        """Return residuals (A, 2, n, 2) by coordinate, target and camera, and derivatives (A, f, 2, n, 2)."""
        r, J = geometric(self._views.at(x, index), self._errors[index])
        n = self.used.shape[1]
        return r.reshape(len(index), 2, n, 2), J.reshape(len(index), J.shape[1], 2, n, 2)

    @cached_property
    def _seen(self) -> Bools:
        """Which pixels (Q, n, 2) of the desired view count."""
        return np.asarray(np.isfinite(self.errors).all(axis=-1) & self.used[..., None])

    @cached_property
    def _views(self) -> LiftedViews:
        Q, n, cameras = self._seen.shape
        rows = self.rows.reshape(Q, n * cameras, *self.rows.shape[-2:])
        return LiftedViews.of(self.unknowns, rows, self._seen.reshape(Q, n * cameras))

    @cached_property
    def _errors(self) -> Floats:
        """Errors (Q, 2, 2n), zero where not seen."""
        e = np.where(self._seen[..., None], self.errors, 0.0)
        return np.asarray(e.reshape(len(e), -1, 2).swapaxes(1, 2))
