"""A serial arm by Denavit and Hartenberg, and two lifts of its joint motions: over SE(3), over the joints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from vmf.geometry import from_rotation_translation, inverse
from vmf.spec.studies import KinematicsError, Link
from vmf.tasks import make_task

Floats = NDArray[np.float64]


class Arm:
    """An arm of revolute joints that carries S.

    Parameters
    ----------
    links : from the base on.
    error : what is wrong with them.
    """

    def __init__(self, links: Sequence[Link], error: KinematicsError | None = None) -> None:
        error = error or KinematicsError(name="none")
        signs = [1 if k % 2 == 0 else -1 for k in range(len(links))]
        self.zero = np.array([sign * error.zero_rad for sign in signs])
        # What follows the joint's rotation in each link: T_z(d) T_x(a) R_x(α).
        self.after = np.stack(
            [
                from_rotation_translation(
                    Rotation.from_euler(
                        "x", link.alpha_deg + sign * error.twist_deg, degrees=True
                    ).as_matrix(),
                    [link.a_m + sign * error.length_m, 0.0, link.d_m + sign * error.length_m],
                )
                for link, sign in zip(links, signs, strict=True)
            ]
        )
        self.tool = from_rotation_translation(np.eye(3), np.full(3, error.tool_m))

    @property
    def n_joints(self) -> int:
        """How many joints."""
        return len(self.after)

    def E_S_from_W(self, q: ArrayLike) -> Floats:
        """Return poses (…, 4, 4) of joint angles (…, n) in rad."""
        return self._pose(np.asarray(q, float), None)

    def derivatives(self, q: ArrayLike) -> Floats:
        """Return ∂E/∂q (…, n, 4, 4)."""
        q = np.asarray(q, float)
        return np.stack([self._pose(q, joint) for joint in range(self.n_joints)], axis=-3)

    def _pose(self, q: Floats, derived: int | None) -> Floats:
        E = np.broadcast_to(np.eye(4), (*q.shape[:-1], 4, 4))
        for joint in range(self.n_joints):
            turn = _inverse_turn(q[..., joint] + self.zero[joint], joint == derived)
            E = inverse(self.after[joint]) @ turn @ E
        return inverse(self.tool) @ E


def _inverse_turn(angle: Floats, derived: bool) -> Floats:
    """Return R_z(−angle) as (…, 4, 4), or its derivative by the angle."""
    c, s = np.cos(angle), np.sin(angle)
    E = np.zeros((*angle.shape, 4, 4))
    if derived:
        E[..., 0, 0] = E[..., 1, 1] = -s
        E[..., 0, 1], E[..., 1, 0] = c, -c
        return E
    E[..., 0, 0] = E[..., 1, 1] = c
    E[..., 0, 1], E[..., 1, 0] = s, -s
    E[..., 2, 2] = E[..., 3, 3] = 1.0
    return E


class JointLift(ABC):
    """A vector of functions of a joint motion Δ from home in which the function is a projective camera.

    Attributes
    ----------
    size : its length k + 1; the last entry is the constant 1.
    """

    size: int

    @abstractmethod
    def lift(self, delta: ArrayLike) -> Floats:
        """Return `x̄` (…, k+1) of joint motions (…, n) in rad."""

    @abstractmethod
    def jacobian(self, delta: ArrayLike) -> Floats:
        """Return ∂x̄/∂Δ (…, k+1, n)."""

    @property
    def unknowns(self) -> int:
        """Parameters of a camera up to scale: three rows, less one."""
        return 3 * self.size - 1


class TrigonometricLift(JointLift):
    """All products of one of `cos Δ_i, sin Δ_i, 1` for every joint: k + 1 = 3ⁿ.

    Every entry of a product of revolute joints and constant transforms is linear in each of these triples, so
    `M E(home + Δ) P` is linear in their products, whatever the links are.
    """

    def __init__(self, n_joints: int) -> None:
        self.n_joints = n_joints
        self.size = 3**n_joints

    def lift(self, delta: ArrayLike) -> Floats:
        return self._product(np.asarray(delta, float), None)

    def jacobian(self, delta: ArrayLike) -> Floats:
        delta = np.asarray(delta, float)
        return np.stack([self._product(delta, joint) for joint in range(self.n_joints)], axis=-1)

    def _product(self, delta: Floats, derived: int | None) -> Floats:
        x_bar = np.ones((*delta.shape[:-1], 1))
        for joint in range(self.n_joints):
            c, s = np.cos(delta[..., joint]), np.sin(delta[..., joint])
            entries = (-s, c, 0 * c) if joint == derived else (c, s, 0 * c + 1)
            factor = np.stack(entries, axis=-1)
            x_bar = (x_bar[..., :, None] * factor[..., None, :]).reshape(*delta.shape[:-1], -1)
        return x_bar


class KinematicLift(JointLift):
    """The lift of Eq. 3.17 of the motion that an arm's kinematics, right or wrong, gives to Δ."""

    def __init__(self, arm: Arm, home: ArrayLike) -> None:
        self.arm, self.home = arm, np.asarray(home, float)
        self.task = make_task("six_dof")
        self.size = self.task.n_lift + 1
        self._from_home = inverse(arm.E_S_from_W(self.home))

    def lift(self, delta: ArrayLike) -> Floats:
        return self.task.lift(self.arm.E_S_from_W(self.home + np.asarray(delta, float)) @ self._from_home)

    def jacobian(self, delta: ArrayLike) -> Floats:
        dE = self.arm.derivatives(self.home + np.asarray(delta, float)) @ self._from_home
        # The lift is a linear read-out; its constant does not change.
        return np.swapaxes(self.task.lift(dE), -1, -2)
