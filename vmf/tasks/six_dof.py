"""General rigid motion (Eq. 3.16): unknowns `α, β, φ, t` with R = R_z(α) R_y(β) R_x(φ)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from vmf.geometry import motion
from vmf.tasks.base import Floats, Task, read_out, rotation, rotation_derivatives


class SixDof(Task):
    """Lift `r1, r2, r3, t` (k = 12)."""

    name: ClassVar[str] = "six_dof"
    components: ClassVar[tuple[tuple[str, str], ...]] = (
        ("rot_z", "rad"),
        ("rot_y", "rad"),
        ("rot_x", "rad"),
        ("t_x", "m"),
        ("t_y", "m"),
        ("t_z", "m"),
    )
    n_motion: ClassVar[int] = 6
    least_targets: ClassVar[int] = 3

    def __init__(self) -> None:
        self.selection = read_out([(i, j) for j in range(4) for i in range(3)])
        self.embedding = np.moveaxis(self.selection, 0, -1)

    def motion(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        p = np.asarray(p, float)
        R = rotation("zyx", p[..., :3])
        return motion.from_rotation_translation(R, p[..., 3:])

    def coordinates(self, E: ArrayLike, E_c: ArrayLike) -> Floats:
        E = np.asarray(E, float)
        R = E[..., :3, :3]
        beta = np.arctan2(-R[..., 2, 0], np.hypot(R[..., 0, 0], R[..., 1, 0]))
        alpha = np.arctan2(R[..., 1, 0], R[..., 0, 0])
        phi = np.arctan2(R[..., 2, 1], R[..., 2, 2])
        return np.concatenate([np.stack([alpha, beta, phi], axis=-1), E[..., :3, 3]], axis=-1)

    def lift_jacobian(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        return self.lift_and_jacobian(p, E_c)[1]

    def lift_and_jacobian(self, p: ArrayLike, E_c: ArrayLike) -> tuple[Floats, Floats]:
        p = np.asarray(p, float)
        R, dR = rotation_derivatives("zyx", p[..., :3])
        lift = np.ones((*p.shape[:-1], 13))
        lift[..., :9] = np.swapaxes(R, -1, -2).reshape(*p.shape[:-1], 9)
        lift[..., 9:12] = p[..., 3:]
        J = np.zeros((*p.shape[:-1], 13, 6))
        # Columns of R stacked one under another, as [R]_{9×1} in Eq. 3.42.
        J[..., :9, :3] = np.swapaxes(np.swapaxes(dR, -1, -2).reshape(*p.shape[:-1], 3, 9), -1, -2)
        J[..., 9:12, 3:] = np.eye(3)
        return lift, J

    def project(self, A: ArrayLike, E_c: ArrayLike) -> Floats:
        A = np.asarray(A, float)
        R = motion.nearest_rotation(A[..., :3, :3])
        return self.coordinates(motion.from_rotation_translation(R, A[..., :3, 3]), E_c)
