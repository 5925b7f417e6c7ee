"""Motion of a mobile robot in the plane (Eq. 3.37): unknowns `α, tx, ty` with R = R_z(α)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from vmf.geometry import motion
from vmf.tasks.base import Floats, Task, read_out, rotation


class Planar(Task):
    """Lift `R11, R12, tx, ty` (k = 4), with R12 = −sin α (C5)."""

    name: ClassVar[str] = "planar"
    components: ClassVar[tuple[tuple[str, str], ...]] = (("heading", "rad"), ("t_x", "m"), ("t_y", "m"))
    n_motion: ClassVar[int] = 3
    least_targets: ClassVar[int] = 2

    def __init__(self) -> None:
        self.selection = read_out([(0, 0), (0, 1), (0, 3), (1, 3)])
        self.embedding = np.moveaxis(self.selection, 0, -1).copy()
        self.embedding[1, 1, 0] = 1.0
        self.embedding[1, 0, 1] = -1.0
        self.embedding[2, 2, -1] = 1.0

    def motion(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        p = np.asarray(p, float)
        R = rotation("z", p[..., :1])
        t = np.concatenate([p[..., 1:], np.zeros((*p.shape[:-1], 1))], axis=-1)
        return motion.from_rotation_translation(R, t)

    def coordinates(self, E: ArrayLike, E_c: ArrayLike) -> Floats:
        E = np.asarray(E, float)
        return np.stack([np.arctan2(E[..., 1, 0], E[..., 0, 0]), E[..., 0, 3], E[..., 1, 3]], axis=-1)

    def lift_jacobian(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        p = np.asarray(p, float)
        J = np.zeros((*p.shape[:-1], 5, 3))
        J[..., 0, 0] = -np.sin(p[..., 0])
        J[..., 1, 0] = -np.cos(p[..., 0])
        J[..., 2, 1] = J[..., 3, 2] = 1.0
        return J

    def project(self, A: ArrayLike, E_c: ArrayLike) -> Floats:
        A = np.asarray(A, float)
        alpha = np.arctan2(A[..., 1, 0] - A[..., 0, 1], A[..., 0, 0] + A[..., 1, 1])
        return np.stack([alpha, A[..., 0, 3], A[..., 1, 3]], axis=-1)
