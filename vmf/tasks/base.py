"""A task space: which entries of a motion vary, and how a few numbers make a motion.

Every task is a linear embedding. With `x̄ = [ℓ(E); 1]` (§2) the whole 4×4 motion is linear in the lift,
`E = Σ_b U[:, :, b] x̄_b`, and the lift is a linear read-out of the motion, `x̄_a = Σ_ij S[a, i, j] E_ij`.
Closure, transport and the analytic parameters of all four tasks follow from `U` and `S`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.geometry import motion

Floats = NDArray[np.float64]

# The two axes that a turn about the third moves, in its sense.
_TURNS = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}


class Task(ABC):
    """One task space.

    Attributes
    ----------
    name : its name in a spec.
    components : names and units of the motion's components in error tables.
    n_motion : number of unknowns `m` of a motion.
    least_targets : fewest 3-D points whose displacement fixes a motion.
    embedding : (4, 4, k+1) `U`, from lift to motion.
    selection : (k+1, 4, 4) `S`, from motion to lift.
    closed : whether relative motions `E_i inv(E_c)` have the same lift as the poses `E_i`.
    """

    name: ClassVar[str]
    components: ClassVar[tuple[tuple[str, str], ...]]
    n_motion: ClassVar[int]
    least_targets: ClassVar[int] = 1
    embedding: Floats
    selection: Floats
    closed: bool = True

    @property
    def n_lift(self) -> int:
        """Number of entries `k` of the lift, the constant not counted."""
        return int(self.embedding.shape[2]) - 1

    def lift(self, E: ArrayLike) -> Floats:
        """Return `x̄ = [ℓ(E); 1]` (…, k+1) of motions (…, 4, 4)."""
        E = np.asarray(E, float)
        return np.asarray(E.reshape(*E.shape[:-2], 16) @ self.selection.reshape(-1, 16).T)

    def unlift(self, x_bar: ArrayLike) -> Floats:
        """Return the 4×4 arrays (…, 4, 4) that lifts (…, k+1) stand for; rigid only if the lift is one."""
        return np.asarray(np.einsum("ijb,...b->...ij", self.embedding, np.asarray(x_bar, float)))

    def departure(self, E: ArrayLike) -> Floats:
        """Return how far (…,) motions are from this task space: the largest entry the lift loses."""
        E = np.asarray(E, float)
        return np.asarray(np.abs(E - self.unlift(self.lift(E))).max(axis=(-2, -1)))

    def closure(self, E_c: ArrayLike) -> Floats:
        """Return `L_c` (…, k+1, k+1) with `x̄(E inv(E_c)) = L_c x̄(E)` (§4)."""
        inverse = motion.inverse(E_c)
        entries = inverse.reshape(*inverse.shape[:-2], 16) @ self._closure
        return np.asarray(entries.reshape(*inverse.shape[:-2], self.n_lift + 1, self.n_lift + 1))

    @cached_property
    def _closure(self) -> Floats:
        """The linear map (16, (k+1)²) from inv(E_c) to L_c."""
        return np.asarray(np.einsum("aij,ilb->ljab", self.selection, self.embedding).reshape(16, -1))

    def parameters(self, M: ArrayLike, P_c: ArrayLike) -> Floats:
        """Return the analytic parameters of a point, unit-depth gauge (Eq. 3.16–3.40, §2).

        Parameters
        ----------
        M : (…, 3, 4) camera matrices in S.
        P_c : (…, 3) points in S at the centre (m).

        Returns
        -------
        rows : (…, 3, k+1) `a, b, c`.
        """
        M, P_c = np.asarray(M, float), np.asarray(P_c, float)
        P = np.concatenate([P_c, np.ones((*P_c.shape[:-1], 1))], axis=-1)
        p = np.einsum("...ri,...i->...r", M, P)
        z = p[..., 2:]
        # Rows of N / z² (Eq. 3.8): e_x = (m1 − x m3)·E'P / m3·E'P, and m3·P / z = 1 is the unit depth.
        n = M / z[..., None]
        n = np.concatenate([n[..., :2, :] - (p[..., :2] / z)[..., None] * n[..., 2:, :], n[..., 2:, :]], -2)
        return np.asarray(np.einsum("...ri,ijb,...j->...rb", n, self.embedding, P))

    @property
    def identity_lift(self) -> Floats:
        """The lift `x̄(I)` (k+1,) of no motion."""
        return self.lift(np.eye(4))

    @abstractmethod
    def motion(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        """Return motions E' (…, 4, 4) from their unknowns p (…, m), starting at poses E_c (…, 4, 4)."""

    @abstractmethod
    def coordinates(self, E: ArrayLike, E_c: ArrayLike) -> Floats:
        """Return the unknowns p (…, m) of motions (…, 4, 4) from E_c: the inverse of `motion`."""

    @abstractmethod
    def lift_jacobian(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        """Return ∂x̄/∂p (…, k+1, m) at p (…, m) (A.1)."""

    def lift_and_jacobian(self, p: ArrayLike, E_c: ArrayLike) -> tuple[Floats, Floats]:
        """Return the lifts x̄ (…, k+1) of the motions p (…, m), and `lift_jacobian`."""
        return self.lift(self.motion(p, E_c)), self.lift_jacobian(p, E_c)

    @abstractmethod
    def project(self, A: ArrayLike, E_c: ArrayLike) -> Floats:
        """Return the unknowns p (…, m) of the motion nearest to any 4×4 arrays A (…, 4, 4)."""

    def plausible(self, p: ArrayLike, E_c: ArrayLike) -> NDArray[np.bool_]:
        """Tell which motions (…, m) a machine can make; the others answer only if nothing else does."""
        return np.ones(np.shape(p)[:-1], bool)

    def world(self) -> Task:
        """Return the task whose lift suits absolute poses E_i: itself, but for `pan_tilt` (C3)."""
        return self

    def from_world(self, rows: ArrayLike) -> Floats:
        """Return parameters (…, 3, k+1) over motions from those over absolute poses (`world`)."""
        return np.asarray(rows, float)


def read_out(entries: list[tuple[int, int]]) -> Floats:
    """Return the selection `S` that picks the given (row, column) entries and the constant 1."""
    S = np.zeros((len(entries) + 1, 4, 4))
    for a, (i, j) in enumerate(entries):
        S[a, i, j] = 1.0
    S[-1, 3, 3] = 1.0
    return S


def rotation(axes: str, angles: ArrayLike) -> Floats:
    """Return R (…, 3, 3) = R_{axes[0]}(angles[0]) R_{axes[1]}(angles[1]) … of angles (…, n) in rad.

    Parameters
    ----------
    axes : a string of `x`, `y`, `z`.
    angles : (…, n) rad.
    """
    angles = np.asarray(angles, float)
    R = _axis_rotation(axes[-1], angles[..., -1])
    for i in range(len(axes) - 2, -1, -1):
        R = _axis_rotation(axes[i], angles[..., i]) @ R
    return R


def rotation_derivatives(axes: str, angles: ArrayLike) -> tuple[Floats, Floats]:
    """Return the rotation of `rotation` and its partial derivatives.

    Returns
    -------
    R : (…, 3, 3).
    dR : (…, n, 3, 3), ∂R/∂angle.
    """
    angles = np.asarray(angles, float)
    factors = [_axis_rotation(axis, angles[..., i]) for i, axis in enumerate(axes)]
    R, dR = factors[-1], [_generated(axes[-1], factors[-1])]
    for axis, factor in zip(axes[-2::-1], factors[-2::-1], strict=True):
        R = factor @ R
        dR = [_generated(axis, R)] + [factor @ d for d in dR]
    return R, np.stack(dR, axis=-3)


def _generated(axis: str, A: Floats) -> Floats:
    """Return ∂R_axis(θ)/∂θ · inv(R_axis(θ)) · A: the cross product of the axis with the columns of A."""
    i, j = _TURNS[axis]
    out = np.zeros_like(A)
    out[..., i, :], out[..., j, :] = -A[..., j, :], A[..., i, :]
    return out


def _axis_rotation(axis: str, angle: Floats) -> Floats:
    i, j = _TURNS[axis]
    R = np.zeros((*angle.shape, 3, 3))
    R[..., 3 - i - j, 3 - i - j] = 1.0
    c, s = np.cos(angle), np.sin(angle)
    R[..., i, i] = R[..., j, j] = c
    R[..., i, j], R[..., j, i] = -s, s
    return R
