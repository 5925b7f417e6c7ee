"""Pan and tilt (Eq. 3.23): poses R = R_y(β) R_z(α); a motion changes both angles.

Between two configurations `R_ic = R_y(β_i) R_z(α_i − α_c) R_y(−β_c)` has r23 ≠ 0 (C3), so motions lift to
all nine entries while poses lift to eight. The unknowns of a motion are Δα and Δβ; the tilt β_c of the
start is known from the encoders.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.geometry import motion
from vmf.tasks.base import Floats, Task, read_out, rotation, rotation_derivatives

# Rounds of alternating least squares; the start is exact without noise and the ratio contracts fast.
_RANK_1_ROUNDS = 20

_ROTATION = [(i, j) for j in range(3) for i in range(3)]


class PanTilt(Task):
    """Lift of all nine entries of R (k = 9), or with `lift="thesis"` all but r23 (k = 8)."""

    name: ClassVar[str] = "pan_tilt"
    components: ClassVar[tuple[tuple[str, str], ...]] = (("pan", "rad"), ("tilt", "rad"))
    n_motion: ClassVar[int] = 2

    def __init__(self, lift: str = "general") -> None:
        thesis = lift == "thesis"
        self.thesis_lift = thesis
        self.closed = False
        self.selection = read_out([e for e in _ROTATION if not (thesis and e == (1, 2))])
        self.embedding = np.moveaxis(self.selection, 0, -1)

    def _tilt(self, E_c: ArrayLike) -> Floats:
        """Tilt β_c (…,) of poses; zero in the thesis's form, which knows no other centre."""
        E_c = np.asarray(E_c, float)
        if self.thesis_lift:
            return np.zeros(E_c.shape[:-2])
        return np.asarray(np.arctan2(E_c[..., 0, 2], E_c[..., 2, 2]))

    def _angles(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        """Angles (β_c + Δβ, Δα, −β_c) of the three factors of R_ic."""
        p, beta_c = np.asarray(p, float), self._tilt(E_c)
        alpha, beta = p[..., 0], p[..., 1]
        beta_c = np.broadcast_to(beta_c, alpha.shape)
        return np.stack([beta_c + beta, alpha, -beta_c], axis=-1)

    def motion(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        R = rotation("yzy", self._angles(p, E_c))
        return motion.from_rotation_translation(R, np.zeros(3))

    def coordinates(self, E: ArrayLike, E_c: ArrayLike) -> Floats:
        beta_c = self._tilt(E_c)
        R_c = rotation("y", beta_c[..., None])
        R = np.asarray(E, float)[..., :3, :3] @ R_c
        alpha = np.arctan2(R[..., 1, 0], R[..., 1, 1])
        beta = np.arctan2(R[..., 0, 2], R[..., 2, 2]) - beta_c
        return np.stack([alpha, (beta + np.pi) % (2 * np.pi) - np.pi], axis=-1)

    def lift_jacobian(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        _, dR = rotation_derivatives("yzy", self._angles(p, E_c))
        dE = np.zeros((*dR.shape[:-3], 2, 4, 4))
        dE[..., 0, :3, :3] = dR[..., 1, :, :]
        dE[..., 1, :3, :3] = dR[..., 0, :, :]
        return np.asarray(np.einsum("aij,...nij->...an", self.selection, dE))

    def project(self, A: ArrayLike, E_c: ArrayLike) -> Floats:
        R = motion.nearest_rotation(np.asarray(A, float)[..., :3, :3])
        return self.coordinates(motion.from_rotation_translation(R, np.zeros(3)), E_c)

    def plausible(self, p: ArrayLike, E_c: ArrayLike) -> NDArray[np.bool_]:
        """Refuse to tilt over the top: turned by π, the head would see a single target just as well."""
        tilt = self._tilt(E_c) + np.asarray(p, float)[..., 1]
        return np.asarray(np.abs(tilt) <= np.pi / 2)

    def world(self) -> Task:
        return PanTilt("thesis")

    def from_world(self, rows: ArrayLike) -> Floats:
        """Complete the entry `n_r2 Z` that poses cannot show, from the rank-1 structure `P ⊗ n` (C3)."""
        rows = np.asarray(rows, float)
        if self.thesis_lift:
            return rows
        # Pixels of a and b outweigh the depths of c by the focal length; a common size lets all count.
        size = np.linalg.norm(rows, axis=-1, keepdims=True)
        size = np.where(size > 0.0, size, 1.0)
        scaled = rows / size
        # One 9×3 block: rows n_r1, n_r2, n_r3 of a, b, c; columns X, Y, Z, with n_r2 Z unknown.
        block = np.zeros((*rows.shape[:-2], 3, 3, 3))
        block[..., :, :, 0] = scaled[..., 0:3]
        block[..., :, :, 1] = scaled[..., 3:6]
        block[..., :, [0, 2], 2] = scaled[..., 6:8]
        n_Z = _complete_rank_1(block.reshape(*rows.shape[:-2], 9, 3)).reshape(*rows.shape[:-2], 3, 3)
        missing = n_Z[..., 1:2] * size
        return np.concatenate([rows[..., :7], missing, rows[..., 7:]], axis=-1)


def _complete_rank_1(A: Floats) -> Floats:
    """Return the last column (…, 9) of the rank-1 matrix nearest to A (…, 9, 3) in its known entries.

    The middle row of each block of three is unknown in the last column. Starts from the two complete
    columns and alternates between the two factors, each step a linear least squares.
    """
    known = np.ones(A.shape[-2:])
    known[1::3, 2] = 0.0
    U, s, Vt = np.linalg.svd(A[..., :2])
    u = U[..., :, 0] * s[..., :1]
    v = np.concatenate([Vt[..., 0, :], np.zeros((*A.shape[:-2], 1))], axis=-1)
    tiny = np.finfo(float).tiny
    for _ in range(_RANK_1_ROUNDS):
        v = np.einsum("ij,...ij,...i->...j", known, A, u) / (np.einsum("ij,...i->...j", known, u**2) + tiny)
        u = np.einsum("ij,...ij,...j->...i", known, A, v) / (np.einsum("ij,...j->...i", known, v**2) + tiny)
    return np.asarray(u * v[..., 2:])
