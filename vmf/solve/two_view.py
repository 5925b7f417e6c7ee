"""Two views of many targets whose places are unknown as well (§6.3).

A target has three numbers `q` of its own, with `q̃ = (q_1, q_2, 1, q_3)`. What both cameras see of it before
the motion is a projective view of q̃, and after the motion one whose matrix is linear in the lifted motion
x̄. Cameras that are known, and a visuomotor function known near a stereo code, both have this form.

Motion and places are found together. Their equations have the shape of an arrow, so that the work grows
with the number of targets, and the motion's information is the Schur complement over the places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.geometry.triangulate import homogeneous, linear_start, project_derivative, reproject
from vmf.optimise import Equations
from vmf.solve.views import Fits, Views, losses

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class TwoViews(Views):
    """Q queries of n targets, as functions of the motion.

    Attributes
    ----------
    pixels : (Q, n, 4, 2) left and right at the start, left and right at the goal (px); NaN where not seen.
    before : (Q, n, 2, 3, 4) views of q̃ before the motion.
    after : (Q, n, 2, 3, 4, k+1) views of q̃ after it, per entry of x̄.
    shift : (Q, n, 4, 2, 4) what is to be added to all four projections, linear in q̃.
    """

    pixels: Floats
    before: Floats
    after: Floats
    shift: Floats

    @property
    def seen(self) -> Bools:
        """Which pixels (Q, n, 4) count."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1) & self.used[..., None])

    @property
    def coordinates_seen(self) -> Ints:
        return np.asarray(2 * self.seen.sum(axis=-1))

    def with_known(self, known: Bools, rows: Floats) -> TwoViews:
        """Return the same queries with the parameters of some targets known at their own codes.

        Parameters
        ----------
        known : (Q, n) targets whose code is one of those that the function was learned from.
        rows : (Q, n, 2, 3, k+1) parameters at these codes, exact for the code as it was observed.
        """
        known = known & np.isfinite(self.pixels[:, :, :2]).all(axis=(-1, -2))
        if not known.any():
            return self
        code = self.pixels[known][:, :2].reshape(-1, 4)
        out = replace(
            self,
            used=self.used | (known & np.isfinite(self.pixels[:, :, 2:]).all(axis=-1).any(axis=-1)),
            before=np.array(self.before),
            after=np.array(self.after),
            shift=np.array(self.shift),
            q=self.q.copy(),
        )
        # q is the code itself, and where the target ends does not depend on it.
        out.before[known], out.after[known], out.shift[known] = views_of_codes(len(code), rows.shape[-1])
        out.shift[known, 1, 1, 2] = code[:, 3]
        out.after[known, :, :, 2, :] = rows[known]
        out.after[known, :, :2, 2, :] += code.reshape(-1, 2, 2)[..., None] * rows[known][:, :, 2, None, :]
        out.q[known] = code[:, :3]
        return out

    def starts(self, x: Floats, index: Ints) -> Floats:
        q = np.where(self.used[index][..., None], self.q[index], 0.0)
        a, j = np.nonzero(~np.isfinite(q).all(axis=-1))
        if len(a):
            views, pixels, _, _ = self._views(x, index, a, j)
            q[a, j] = linear_start(views, pixels)
        return q

    def fits(self, x: Floats, q: Floats, index: Ints) -> Fits:
        a, j = np.nonzero(self.used[index])
        views, pixels, shift, dx_bar = self._views(x, index, a, j)
        place = q[a, j]
        predicted, J_q, depth = reproject(views, place, shift)
        point = homogeneous(place)
        # ∂(view x̄ q̃)/∂x for the desired view; the initial view does not depend on the motion.
        h = np.einsum("tcrqb,tq->tcrb", self.after[index[a], j], point)
        dh = h.reshape(len(a), 6, h.shape[-1]) @ dx_bar[a]
        f = dh.shape[-1]
        projected = predicted[:, 2:] - (shift[:, 2:] @ point[:, None, :, None])[..., 0]
        J_x = np.zeros((len(a), 4, 2, f))
        J_x[:, 2:] = project_derivative(dh.reshape(len(a), 2, 3, f), projected, depth[:, 2:])
        seen = np.isfinite(pixels)
        r = np.where(seen, predicted - pixels, 0.0).reshape(len(a), 8)
        J_q = np.where(seen[..., None], J_q, 0.0).reshape(len(a), 8, 3)
        J_x = np.where(seen[..., None], J_x, 0.0).reshape(len(a), 8, f)
        return Fits(a, j, r, J_x, J_q)

    def _views(self, x: Floats, index: Ints, a: Ints, j: Ints) -> tuple[Floats, Floats, Floats, Floats]:
        """Return views (T, 4, 3, 4), pixels (T, 4, 2) and shifts of targets, and ∂x̄/∂x (A, k+1, f)."""
        x_bar, dx_bar = self.unknowns.lift(x, index)
        query = index[a]
        pixels = np.where(self.seen[query, j][..., None], self.pixels[query, j], np.nan)
        views = np.empty((len(a), 4, 3, 4))
        views[:, :2] = self.before[query, j]
        views[:, 2:] = (self.after[query, j] @ x_bar[a][:, None, None, :, None])[..., 0]
        return views, pixels, self.shift[query, j], dx_bar

    def equations(self, x: Floats, q: Floats, index: Ints, noise: Noise | None = None) -> Equations:
        fits = self.fits(x, q, index)
        if noise is not None:
            fits = fits.with_lost_targets()
        loss, weight = losses(fits.square, self.coordinates(index)[fits.query, fits.target], noise)
        A, n = self.used[index].shape
        f = fits.J_x.shape[-1]
        # Gauss–Newton with the loss's slope as weight: its gradient is exact.
        J = np.concatenate([fits.J_x, fits.J_q, fits.r[..., None]], axis=-1)
        J = np.where(np.isfinite(J).all(axis=(1, 2), keepdims=True), J, 0.0)
        H = np.swapaxes(J, -1, -2) @ (weight[:, None, None] * J)
        out = np.zeros((A, n, f + 4, f + 4))
        out[fits.query, fits.target] = H
        cost = np.zeros((A, n))
        cost[fits.query, fits.target] = 0.5 * loss
        return Equations(
            cost.sum(axis=1),
            out[:, :, :f, :f].sum(axis=1),
            out[:, :, :f, f : f + 3],
            out[:, :, f : f + 3, f : f + 3],
            out[:, :, :f, f + 3].sum(axis=1),
            out[:, :, f : f + 3, f + 3],
        )


def views_of_codes(T: int, width: int) -> tuple[Floats, Floats, Floats]:
    """Return `before`, `after` and `shift` (T, …) of targets whose q is `(x_L, y_L, x_R)`, all else zero.

    The view before is affine, so all of it is in the shift, and its depth is 1; `width` is that of x̄.
    """
    before = np.zeros((T, 2, 3, 4))
    before[:, :, 2, 2] = 1.0
    after = np.zeros((T, 2, 3, 4, width))
    shift = np.zeros((T, 4, 2, 4))
    shift[:, 0, 0, 0] = shift[:, 0, 1, 1] = shift[:, 1, 0, 3] = 1.0
    return before, after, shift
