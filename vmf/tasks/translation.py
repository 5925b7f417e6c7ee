"""Pure translation (Eq. 3.30): unknowns `t`."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from vmf.geometry import motion
from vmf.tasks.base import Floats, Task, read_out


class Translation(Task):
    """Lift `t` (k = 3)."""

    name: ClassVar[str] = "translation"
    components: ClassVar[tuple[tuple[str, str], ...]] = (("t_x", "m"), ("t_y", "m"), ("t_z", "m"))
    n_motion: ClassVar[int] = 3

    def __init__(self) -> None:
        self.selection = read_out([(0, 3), (1, 3), (2, 3)])
        self.embedding = np.moveaxis(self.selection, 0, -1).copy()
        self.embedding[[0, 1, 2], [0, 1, 2], -1] = 1.0

    def motion(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        return motion.from_rotation_translation(np.eye(3), p)

    def coordinates(self, E: ArrayLike, E_c: ArrayLike) -> Floats:
        return np.asarray(E, float)[..., :3, 3]

    def lift_jacobian(self, p: ArrayLike, E_c: ArrayLike) -> Floats:
        shape = np.asarray(p).shape[:-1]
        return np.broadcast_to(np.eye(4)[:, :3], (*shape, 4, 3)).copy()

    def project(self, A: ArrayLike, E_c: ArrayLike) -> Floats:
        return self.coordinates(A, E_c)
