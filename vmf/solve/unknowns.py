"""What is solved for: the unknowns of a task's motion that are not given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.geometry import from_rotation_translation
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Three points in general position, with no axis or origin of a task on their plane or lines (m).
_GENERAL_POINTS = np.array([[1.1, 0.4, -0.3], [-0.5, 1.3, 0.7], [0.2, -0.6, 1.7]])


@dataclass(frozen=True)
class Unknowns:
    """The free unknowns x (…, f) of Q motions, out of all the unknowns p (…, m).

    Attributes
    ----------
    task : the task space.
    E_c : (Q, 4, 4) poses `E_S_from_W` at the start of each motion.
    given : (Q, m) unknowns where they are known, 0 elsewhere.
    free : (m,) which unknowns are solved for.
    """

    task: Task
    E_c: Floats
    given: Floats
    free: Bools

    @classmethod
    def of(cls, task: Task, E_c: Floats, R_known: ArrayLike | None = None) -> Unknowns:
        """Return the unknowns of motions from E_c (Q, 4, 4); those in metres if R is known.

        Raises
        ------
        ValueError : the rotations (Q, 3, 3) are known and the task has nothing else.
        """
        if R_known is None:
            return cls(task, E_c, np.zeros((len(E_c), task.n_motion)), np.ones(task.n_motion, bool))
        free = np.array([unit == "m" for _, unit in task.components])
        if not free.any():
            raise ValueError(f"{task.name} motions only rotate: a known rotation leaves nothing to solve")
        E = from_rotation_translation(np.asarray(R_known, float), np.zeros(3))
        return cls(task, E_c, np.where(free, 0.0, task.coordinates(E, E_c)), free)

    @property
    def n_free(self) -> int:
        """Number of free unknowns `f`."""
        return int(self.free.sum())

    def full(self, x: Floats, index: Ints) -> Floats:
        """Return all unknowns p (A, m) of the queries `index` from the free ones (A, f)."""
        if self.free.all():
            return np.asarray(x)
        p = self.given[index]
        p[:, self.free] = x
        return p

    def motion(self, x: Floats, index: Ints) -> Floats:
        """Return the motions E' (A, 4, 4) of the queries `index`."""
        return self.task.motion(self.full(x, index), self.E_c[index])

    def lift(self, x: Floats, index: Ints) -> tuple[Floats, Floats]:
        """Return the lifted motions x̄ (A, k+1) of the queries `index`, and ∂x̄/∂x (A, k+1, f)."""
        p, E_c = self.full(x, index), self.E_c[index]
        x_bar, J = self.task.lift_and_jacobian(p, E_c)
        return x_bar, J if self.free.all() else J[..., self.free]

    def motion_jacobian(self, x: Floats, index: Ints) -> Floats:
        """Return ∂E'/∂x (A, f, 4, 4): the motion is linear in its lift."""
        J = self.task.lift_jacobian(self.full(x, index), self.E_c[index])[..., self.free]
        return np.asarray(np.einsum("ijb,abf->afij", self.task.embedding, J))

    def canonical(self, x: Floats, index: Ints) -> Floats:
        """Return the same motions' free unknowns (A, f) with angles in their usual ranges."""
        return self.task.coordinates(self.motion(x, index), self.E_c[index])[:, self.free]

    def project(self, E: Floats, index: Ints) -> Floats:
        """Return the free unknowns (A, f) of the task's motions nearest to any 4×4 arrays (A, 4, 4)."""
        return self.task.project(E, self.E_c[index])[:, self.free]

    @property
    def fewest_targets(self) -> int:
        """The fewest points in general position whose places before and after determine a motion."""
        here = Unknowns(self.task, np.eye(4)[None], np.zeros((1, self.task.n_motion)), self.free)
        dE = here.motion_jacobian(np.zeros((1, self.n_free)), np.zeros(1, np.int64))[0]
        for n, points in enumerate((_GENERAL_POINTS[:1], _GENERAL_POINTS[:2]), start=1):
            if np.linalg.matrix_rank(moved(dE[:, None], points).reshape(self.n_free, -1)) == self.n_free:
                return n
        return len(_GENERAL_POINTS)


def moved(E: Floats, P: Floats) -> Floats:
    """Return points (…, 3) carried by 4×4 arrays (…, 4, 4), motions or derivatives of motions."""
    return np.asarray((E[..., :3, :3] @ P[..., None])[..., 0] + E[..., :3, 3])
