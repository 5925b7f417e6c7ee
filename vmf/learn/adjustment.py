"""Sparse robust bundle adjustment with known motions: two cameras and three numbers per target (§4).

Everything is in normalised pixels `(u − centre) / width`, and every target in the frame S of its own first
observation, so that no world coordinate is ever large. Unknowns are both camera matrices `M` (3, 4), up to
one scale each, a radial coefficient of each lens where that is asked for, and the targets. The targets
couple only to the cameras, so each step solves the 26 cameras' equations that are left when the targets are
eliminated (Schur complement).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.robust import HUBER
from vmf.estimate.robust import huber as huber_weight

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Share of a target's equations below which a direction counts as unseen.
_RIDGE = 1e-9
# A camera matrix and a radial coefficient.
_PER_CAMERA = 13
CAMERAS = 2 * _PER_CAMERA


@dataclass(frozen=True)
class Scene:
    """M observations of K targets, sorted by target.

    Attributes
    ----------
    target : (M,) target of each observation.
    E : (M, 4, 4) motions from the target's first observation.
    pixels : (M, 2, 2) normalised pixels, left and right.
    seen : (M, 2) which cameras saw it.
    lenses : whether the radial coefficients are unknowns; else they stay.
    """

    target: Ints
    E: Floats
    pixels: Floats
    seen: Bools
    lenses: bool = False

    @property
    def starts(self) -> Ints:
        """First observation (K,) of each target."""
        return np.nonzero(np.append(True, np.diff(self.target) > 0))[0]

    def select(self, keep: Bools) -> Scene:
        """Return some of the observations, with the targets numbered anew."""
        target = np.unique(self.target[keep], return_inverse=True)[1].astype(np.int64)
        return replace(self, target=target, E=self.E[keep], pixels=self.pixels[keep], seen=self.seen[keep])


@dataclass(frozen=True)
class Estimate:
    """Cameras, lenses and targets.

    Attributes
    ----------
    M : (2, 3, 4) camera matrices for normalised pixels.
    radial : (2,) coefficient k of each lens: `(1 + k r²)` takes a normalised pixel at the distance r from the
        image centre to that of a pinhole camera (Fitzgibbon's division model, to first order); 0 without.
    points : (K, 3) targets.
    """

    M: Floats
    radial: Floats
    points: Floats

    def moved(self, cameras: Floats, points: Floats) -> Estimate:
        """Return the estimate after steps of both cameras (26,) and of the targets (K, 3)."""
        step = cameras.reshape(2, _PER_CAMERA)
        return Estimate(
            self.M + step[:, :12].reshape(2, 3, 4), self.radial + step[:, 12], self.points + points
        )


def pinhole(pixels: Floats, radial: Floats) -> Floats:
    """Return normalised pixels (…, 2, 2) of both cameras as pinhole cameras would have them."""
    return np.asarray(pixels * (1.0 + radial[:, None] * np.square(pixels).sum(axis=-1, keepdims=True)))


# A robust loss: ρ(s²) and its derivative ρ'(s²), of squared residual norms in units of their scale.
RobustLoss = Callable[[Floats], tuple[Floats, Floats]]


def huber(s2: Floats) -> tuple[Floats, Floats]:
    """Huber's loss with 95 % efficiency."""
    s = np.sqrt(s2)
    return np.where(s > HUBER, 2 * HUBER * s - HUBER**2, s2), huber_weight(s)


def cauchy(s2: Floats) -> tuple[Floats, Floats]:
    """Cauchy's redescending loss with 95 % efficiency (c = 2.385)."""
    c2 = 2.385**2
    return c2 * np.log1p(s2 / c2), 1.0 / (1.0 + s2 / c2)


def residuals(scene: Scene, now: Estimate) -> tuple[Floats, Floats]:
    """Return residuals (M, 2, 2), zero where not seen, and depths (M, 2)."""
    Y = _points_in_S(scene, now.points)
    p = np.einsum("cri,mi->mcr", now.M[:, :, :3], Y) + now.M[:, :, 3]
    depth = p[..., 2]
    safe = np.where(np.abs(depth) > 1e-12, depth, 1e-12)
    r = p[..., :2] / safe[..., None] - pinhole(scene.pixels, now.radial)
    return np.where(scene.seen[..., None], r, 0.0), depth


def _points_in_S(scene: Scene, points: Floats) -> Floats:
    P = points[scene.target]
    return np.asarray(np.einsum("mij,mj->mi", scene.E[:, :3, :3], P) + scene.E[:, :3, 3])


def adjust(
    scene: Scene, start: Estimate, loss: RobustLoss, scale: float, max_iterations: int = 50
) -> tuple[Estimate, float]:
    """Return the estimate of least robust cost, and that cost, by Levenberg–Marquardt.

    Parameters
    ----------
    scene : the observations.
    start : cameras with every target in front of them, or nearly.
    loss : the robust loss.
    scale : noise scale of the loss, in normalised pixels.
    max_iterations : steps tried at most.
    """
    now = normalised(start)
    cost = _cost(scene, now, loss, scale)
    damping, growth = 1e-4, 2.0
    system = linearised(scene, now, loss, scale)
    for _ in range(max_iterations):
        new = normalised(now.moved(*system.step(damping)))
        new_cost = _cost(scene, new, loss, scale)
        if new_cost < cost:
            small = cost - new_cost <= 1e-7 * cost
            now, cost = new, new_cost
            damping, growth = max(damping / 4.0, 1e-12), 2.0
            if small:
                break
            system = linearised(scene, now, loss, scale)
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > 1e8:
                break
    return now, cost


def normalised(now: Estimate) -> Estimate:
    """Scale each camera so that its depths are in metres: the free scale of a camera matrix."""
    size = np.linalg.norm(now.M[:, 2, :3], axis=-1)
    return replace(now, M=now.M / size[:, None, None])


def _cost(scene: Scene, now: Estimate, loss: RobustLoss, scale: float) -> float:
    r, depth = residuals(scene, now)
    s2 = _in_front(np.square(r / scale).sum(axis=-1), depth, scale)
    return float(loss(s2)[0][scene.seen].sum())


def _in_front(s2: Floats, depth: Floats, scale: float) -> Floats:
    """Return squared residual norms, behind the camera as far off as the image is wide."""
    return np.where(depth <= 0.0, np.maximum(s2, 1.0 / scale**2), s2)


@dataclass(frozen=True)
class System:
    """Normal equations about an estimate.

    Attributes
    ----------
    H_c, H_p, H_cp : (26, 26), (K, 3, 3), (K, 26, 3) of the cameras, of each target, and of both.
    g_c, g_p : (26,) and (K, 3) gradients.
    cost, seen : (K,) robust cost of each target, and how many pixels it is the sum of.
    """

    H_c: Floats
    H_p: Floats
    H_cp: Floats
    g_c: Floats
    g_p: Floats
    cost: Floats
    seen: Ints

    @classmethod
    def nothing(cls, K: int) -> System:
        """Return the equations of no observations of K targets."""
        H, g = (np.zeros((K, *shape)) for shape in ((3, 3), (3,)))
        coupling = np.zeros((K, CAMERAS, 3))
        none = np.zeros(K, np.int64)
        return cls(np.zeros((CAMERAS, CAMERAS)), H, coupling, np.zeros(CAMERAS), g, np.zeros(K), none)

    def reduced(self, damping: float = 0.0) -> tuple[Floats, Floats, Floats]:
        """Return the cameras' equations `S x = −b`, (26, 26) and (26,), with the targets eliminated.

        The third array (K, 3, 27) gives the targets from the cameras: `−(gain[…, 26] + gain[…, :26] x)`.
        """
        H_p = self.H_p.copy()
        diagonal = np.einsum("kii->ki", H_p)
        diagonal += damping * (diagonal + 1e-9 * diagonal.max(initial=0.0)) + 1e-300
        H_c = self.H_c.copy()
        d = H_c.diagonal().copy()
        H_c[np.arange(CAMERAS), np.arange(CAMERAS)] += damping * (d + 1e-9 * d.max())
        H_pc = np.swapaxes(self.H_cp, -1, -2)
        gain = np.linalg.solve(H_p, np.concatenate([H_pc, self.g_p[..., None]], axis=-1))
        eliminated = H_pc.reshape(-1, CAMERAS).T @ gain.reshape(-1, CAMERAS + 1)
        return H_c - eliminated[:, :CAMERAS], self.g_c - eliminated[:, CAMERAS], gain

    def step(self, damping: float) -> tuple[Floats, Floats]:
        """Return the steps of the cameras (26,) and the targets (K, 3)."""
        S, b, gain = self.reduced(damping)
        # Each camera has a free scale, and the task may leave more: the least step does not move along them.
        cameras = np.asarray(-np.linalg.lstsq(S, b, rcond=1e-14)[0], float)
        # Nor along what has no equations, a lens that is not learned, not even by rounding.
        cameras[self.H_c.diagonal() == 0.0] = 0.0
        return cameras, -(gain[..., CAMERAS] + gain[..., :CAMERAS] @ cameras)

    def with_more(self, more: System, target: Ints) -> System:
        """Return these equations with further ones of some targets (K',), about the same estimate."""
        H_p, H_cp, g_p = self.H_p.copy(), self.H_cp.copy(), self.g_p.copy()
        cost, seen = self.cost.copy(), self.seen.copy()
        H_p[target] += more.H_p
        H_cp[target] += more.H_cp
        g_p[target] += more.g_p
        cost[target] += more.cost
        seen[target] += more.seen
        return System(self.H_c + more.H_c, H_p, H_cp, self.g_c + more.g_c, g_p, cost, seen)


def linearised(scene: Scene, now: Estimate, loss: RobustLoss, scale: float) -> System:
    """Return the normal equations of the robust cost about an estimate, noise scale in normalised pixels."""
    Y = _points_in_S(scene, now.points)
    Y1 = np.concatenate([Y, np.ones((len(Y), 1))], axis=1)
    p = np.einsum("cri,mi->mcr", now.M, Y1)
    depth = np.where(np.abs(p[..., 2]) > 1e-12, p[..., 2], 1e-12)
    u = p[..., :2] / depth[..., None]
    r = np.where(scene.seen[..., None], u - pinhole(scene.pixels, now.radial), 0.0) / scale
    # Triggs' first-order weights: the square root of ρ' scales residual and Jacobian alike.
    s2 = np.square(r).sum(axis=-1)
    weight = np.sqrt(loss(s2)[1]) * scene.seen
    cost = loss(_in_front(s2, p[..., 2], scale))[0] * scene.seen
    r = r * weight[..., None]
    factor = weight / depth / scale
    J = np.zeros((*u.shape, _PER_CAMERA))
    J_M = J[..., :12].reshape(*u.shape, 3, 4)
    J_M[:, :, 0, 0] = J_M[:, :, 1, 1] = factor[..., None] * Y1[:, None, :]
    J_M[:, :, :, 2] = -(factor[..., None] * u)[..., None] * Y1[:, None, None, :]
    J[..., :12] = J_M.reshape(*u.shape, 12)
    if scene.lenses:
        bent = scene.pixels * np.square(scene.pixels).sum(axis=-1, keepdims=True)
        J[..., 12] = -(weight / scale)[..., None] * bent
    MR = np.einsum("cri,mij->mcrj", now.M[:, :, :3], scene.E[:, :3, :3])
    J_p = (MR[:, :, :2] - u[..., None] * MR[:, :, 2:]) * factor[..., None, None]
    starts = scene.starts
    flat_c = np.moveaxis(J, 1, 0).reshape(2, -1, _PER_CAMERA)
    H = np.swapaxes(flat_c, -1, -2) @ flat_c
    H_c = np.zeros((CAMERAS, CAMERAS))
    H_c[:_PER_CAMERA, :_PER_CAMERA], H_c[_PER_CAMERA:, _PER_CAMERA:] = H
    flat_p = J_p.reshape(len(Y), 4, 3)
    flat_p_t = np.swapaxes(flat_p, -1, -2)
    H_p = np.add.reduceat(flat_p_t @ flat_p, starts)
    g_p = np.add.reduceat((flat_p_t @ r.reshape(-1, 4, 1))[..., 0], starts)
    coupling = (np.swapaxes(J, -1, -2) @ J_p).reshape(len(Y), CAMERAS, 3)
    g_c = np.einsum("mcrk,mcr->ck", J, r).ravel()
    each = np.add.reduceat(cost.sum(axis=1), starts), np.add.reduceat(scene.seen.sum(axis=1), starts)
    return System(H_c, H_p, np.add.reduceat(coupling, starts), g_c, g_p, *each)


def triangulated(scene: Scene, M: Floats, radial: Floats) -> Floats:
    """Return targets (K, 3) by the linear equations of all their observations with known motions.

    Where the motions show no parallax (pure rotation about the camera) only the direction is meant.
    """
    view = np.einsum("cri,mij->mcrj", M[:, :, :3], scene.E[:, :3, :])
    view[..., 3] += M[:, :, 3]
    rows = view[:, :, :2] - pinhole(scene.pixels, radial)[..., None] * view[:, :, 2:]
    rows = np.where(scene.seen[..., None, None], rows, 0.0).reshape(len(scene.target), 4, 4)
    H = np.add.reduceat(np.swapaxes(rows, -1, -2) @ rows, scene.starts)
    A, b = H[:, :3, :3], H[:, :3, 3:]
    size = np.einsum("kii->k", A)
    points = -np.linalg.solve(A + _RIDGE * size[:, None, None] * np.eye(3), b)[..., 0]
    ray = np.linalg.eigh(A)[1][:, :, 0]
    depth = np.einsum("mj,mj->m", view[:, 0, 2, :3], ray[scene.target])
    facing = np.where(np.add.reduceat(np.sign(depth), scene.starts) < 0.0, -1.0, 1.0)
    flat = np.linalg.norm(b[..., 0], axis=1) < _RIDGE * size
    return np.where(flat[:, None], ray * facing[:, None], points)
