"""Two views of many targets, each at its best place for a given motion (§6.3).

A target has three numbers `q` of its own, with `q̃ = (q_1, q_2, 1, q_3)`. What both cameras see of it before
the motion is a projective view of q̃, and after the motion one whose matrix is linear in the lifted motion
x̄. Cameras that are known, and a visuomotor function known near a stereo code, both have this form.

For a given motion every target is a small problem of its own. The cost that is left depends on the motion
alone, with the Jacobian `J_x` less its projection on the target's `J_q` (variable projection: Golub and
Pereyra 1973, Kaufman 1975), so that the work grows with the number of targets and `JᵀJ` is the Schur
complement of the full problem.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.geometry.triangulate import homogeneous, linear_start, locate, project_derivative, reproject
from vmf.solve.unknowns import Unknowns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Below this squared norm a robust residual is its plain one to the last bit.
_TINY = 1e-24
# To a robust loss, a target that no place explains is this far off (px).
_NOWHERE_PX = 1e4


@dataclass(frozen=True)
class Fits:
    """Residuals of A queries with n targets at given motions.

    Attributes
    ----------
    r : (A, n, 8) px, every target at its best place; zero where not seen.
    J : (A, n, 8, f) derivatives with respect to the motion, the targets' places making up for what they can.
    """

    r: Floats
    J: Floats

    @property
    def square(self) -> Floats:
        """Squared residual norms (A, n) in px²."""
        return np.asarray(np.square(self.r).sum(axis=-1))

    def with_lost_targets(self) -> Fits:
        """Return the same with targets that no place explains off by a constant, whatever the motion."""
        lost = ~(np.isfinite(self.r).all(axis=-1) & np.isfinite(self.J).all(axis=(-1, -2)))
        if not lost.any():
            return self
        r, J = self.r.copy(), self.J.copy()
        r[lost], J[lost] = _NOWHERE_PX, 0.0
        return Fits(r, J)

    def weighted(self, weight: Floats) -> tuple[Floats, Floats]:
        """Return residuals (A, 8n) and Jacobians (A, 8n, f) times weights (A, n)."""
        A, n, _, f = self.J.shape
        r, J = weight[..., None] * self.r, weight[..., None, None] * self.J
        return r.reshape(A, 8 * n), J.reshape(A, 8 * n, f)


@dataclass(frozen=True)
class TwoViews:
    """Q queries of n targets, as functions of the motion.

    Attributes
    ----------
    unknowns : of the motions.
    pixels : (Q, n, 4, 2) left and right at the start, left and right at the goal (px); NaN where not seen.
    used : (Q, n) targets that count.
    before : (Q, n, 2, 3, 4) views of q̃ before the motion.
    after : (Q, n, 2, 3, 4, k+1) views of q̃ after it, per entry of x̄.
    shift : (Q, n, 4, 2, 4) what is to be added to all four projections, linear in q̃.
    q : (Q, n, 3) where to start; NaN for a start from all views.
    """

    unknowns: Unknowns
    pixels: Floats
    used: Bools
    before: Floats
    after: Floats
    shift: Floats
    q: Floats

    @property
    def seen(self) -> Bools:
        """Which pixels (Q, n, 4) count."""
        return np.asarray(np.isfinite(self.pixels).all(axis=-1) & self.used[..., None])

    @property
    def n_equations(self) -> Ints:
        """Coordinates (Q,) that count, in both views and both cameras."""
        return np.asarray(2 * self.seen.sum(axis=(1, 2)))

    @property
    def n_spare(self) -> Ints:
        """Equations (Q,) beyond the unknowns of targets and motion."""
        return np.asarray(self.n_equations - 3 * self.used.sum(axis=1) - self.unknowns.n_free)

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

    def fits(self, x: Floats, index: Ints) -> Fits:
        """Return what is left at motions x (A, f) of the queries `index`; NaN behind a camera."""
        x_bar, dx_bar = self.unknowns.lift(x, index)
        a, j = np.nonzero(self.used[index])
        query = index[a]
        after, shift = self.after[query, j], self.shift[query, j]
        seen = self.seen[query, j]
        pixels = np.where(seen[..., None], self.pixels[query, j], np.nan)
        views = np.empty((len(a), 4, 3, 4))
        views[:, :2] = self.before[query, j]
        views[:, 2:] = (after @ x_bar[a][:, None, None, :, None])[..., 0]
        fit = locate(views, pixels, self._start(views, pixels, shift, query, j), shift)
        predicted, J_q, depth = reproject(views, fit.x, shift)
        # ∂(view x̄ q̃)/∂x for the desired view; the initial view does not depend on the motion.
        h = np.einsum("tcrqb,tq->tcrb", after, homogeneous(fit.x))
        dh = h.reshape(len(a), 6, h.shape[-1]) @ dx_bar[a]
        J_x = np.zeros((len(a), 4, 2, dh.shape[-1]))
        projected = predicted[:, 2:] - (shift[:, 2:] @ homogeneous(fit.x)[:, None, :, None])[..., 0]
        J_x[:, 2:] = project_derivative(dh.reshape(len(a), 2, 3, dh.shape[-1]), projected, depth[:, 2:])
        r = np.where(seen[..., None], predicted - pixels, 0.0).reshape(len(a), 8)
        J_q = np.where(seen[..., None, None], J_q, 0.0).reshape(len(a), 8, 3)
        J_x = np.where(seen[..., None, None], J_x, 0.0).reshape(len(a), 8, dh.shape[-1])
        A, n = self.used[index].shape
        out = Fits(np.zeros((A, n, 8)), np.zeros((A, n, 8, dh.shape[-1])))
        out.r[a, j], out.J[a, j] = r, _without(J_q, J_x)
        return out

    def residuals(self, x: Floats, index: Ints, noise: Noise | None = None) -> tuple[Floats, Floats]:
        """Return residuals (A, 8n) and Jacobians (A, 8n, f) whose squares sum to the cost.

        With `noise` each target's residual `r` is made `r √(ρ(s)/s)`, s being its squared norm in units of
        the scale: the sum of squares is then that of the losses ρ, in px².
        """
        fits = self.fits(x, index)
        if noise is None:
            return fits.weighted(np.ones(fits.r.shape[:2]))
        fits = fits.with_lost_targets()
        s = fits.square / noise.scale_px**2
        rho, slope = noise.loss(s, self.coordinates(index))
        small = s <= _TINY
        safe = np.where(small, 1.0, s)
        factor = np.sqrt(np.where(small, slope, rho / safe))
        r, J = fits.weighted(factor)
        # ∂(factor)/∂s = (ρ' s − ρ)/(2 s² factor), and ∂s/∂x = 2 rᵀJ/σ².
        change = np.where(small, 0.0, (slope * s - rho) / (np.square(safe) * factor))
        rJ = np.einsum("ani,anif->anf", fits.r, fits.J) / noise.scale_px**2
        return r, J + (change[..., None, None] * fits.r[..., None] * rJ[:, :, None, :]).reshape(J.shape)

    def coordinates(self, index: Ints) -> Floats:
        """Return what is left of each target's coordinates (A, n) when its place is taken off, at least 1."""
        return np.asarray(np.maximum(2.0 * self.seen[index].sum(axis=-1) - 3.0, 1.0))

    def _start(self, views: Floats, pixels: Floats, shift: Floats, query: Ints, j: Ints) -> Floats:
        q = self.q[query, j]
        unknown = ~np.isfinite(q).all(axis=1)
        if unknown.any():
            q[unknown] = linear_start(views[unknown], pixels[unknown])
        return q


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


def _without(J_q: Floats, J_x: Floats) -> Floats:
    """Return `J_x` (T, 8, f) less what a change of the target's place, `J_q` (T, 8, 3), makes up for."""
    span: Floats = np.linalg.qr(J_q).Q
    return np.asarray(J_x - span @ (np.swapaxes(span, -1, -2) @ J_x), float)
