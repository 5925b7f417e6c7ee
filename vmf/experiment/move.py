"""What `vmf solve` answers: a motion, the command it stands for, and how well both are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from scipy.spatial.transform import Rotation

from vmf.geometry import inverse, rotation_angle
from vmf.solve import Solution
from vmf.solve import command as pose_to_command
from vmf.tasks import Task

Floats = NDArray[np.float64]
Matrix = tuple[tuple[float, ...], ...]

_POSE = ("x", "y", "z", "rot_x", "rot_y", "rot_z")


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class Covariance(_Part):
    """A covariance, rows and columns in the order of the named components."""

    components: tuple[str, ...]
    units: tuple[str, ...]
    matrix: Matrix


class Unknown(_Part):
    """One unknown of the task; `given` if it was known beforehand, `std` null where the noise is unknown."""

    name: str
    unit: str
    value: float
    std: float | None
    given: bool


class Motion(_Part):
    """A solved motion.

    Attributes
    ----------
    E_desired_from_initial : E', which takes coordinates (m) in S at the initial view to S at the desired.
    angle_rad, distance_m : its geodesic angle and the length of its translation.
    unknowns : the same in the task's parametrisation.
    covariance : of the unknowns, null where the noise is unknown.
    """

    E_desired_from_initial: Matrix
    angle_rad: float
    distance_m: float
    unknowns: tuple[Unknown, ...]
    covariance: Covariance | None


class PoseCommand(_Part):
    """The pose to command, in the frames of the poses trained with.

    The covariance is the motion's, carried over to first order: position in `frame_id`, and small rotations
    about the fixed axes of `frame_id`, as in `geometry_msgs/msg/PoseWithCovariance`. The present pose counts
    as exact.
    """

    frame_id: str
    position_m: tuple[float, ...]
    quaternion_xyzw: tuple[float, ...]
    covariance: Covariance | None


class JointCommand(_Part):
    """The angles to command to a pan-tilt unit: the present ones plus the solved ones."""

    pan_rad: float
    tilt_rad: float


class Command(_Part):
    """What to command; null where the robot's report does not say from where."""

    pose: PoseCommand | None
    joints: JointCommand | None


class TargetReport(_Part):
    """What the learned function knows of one target, and what the solver made of it.

    Attributes
    ----------
    id : its name.
    weight : how far it was trusted, from 1 down to 0; null if it could not be used.
    rejected : whether it was left out as a wrong correspondence.
    support : data behind the parameters at the code that was asked, null where no code was.
    initial_outside_px, desired_outside_px : how far the codes lie outside the region of trained codes, at
        least where one camera does not see the target; null where neither does.
    """

    id: str
    weight: float | None
    rejected: bool
    support: float | None
    initial_outside_px: float | None
    desired_outside_px: float | None


class Move(_Part):
    """The answer to two views; without a motion to use, `motion` and `command` are null.

    Attributes
    ----------
    status, reason : `ok`, `refused` or `diverged`, and why.
    task, mounting : of the model.
    motion, command : what was solved, and where to send the robot if its present pose is known.
    residual_px, iterations, condition : of the solution.
    targets : those in both views.
    unused : names of those in one.
    notes : what a person should know.
    """

    status: str
    reason: str
    task: str
    mounting: str
    motion: Motion | None
    command: Command | None
    residual_px: float | None
    iterations: int
    condition: float | None
    targets: tuple[TargetReport, ...]
    unused: tuple[str, ...]
    notes: tuple[str, ...]


def motion_of(task: Task, solution: Solution, rotation_given: bool) -> Motion:
    """Return a solution that converged as a motion with named unknowns."""
    E, std = solution.E_to_from, np.sqrt(np.diagonal(solution.covariance))
    names, units = zip(*task.components, strict=True)
    unknowns = tuple(
        Unknown(name=name, unit=unit, value=float(p), std=number(s), given=rotation_given and unit == "rad")
        for name, unit, p, s in zip(names, units, solution.p, std, strict=True)
    )
    return Motion(
        E_desired_from_initial=_matrix(E),
        angle_rad=float(rotation_angle(E)),
        distance_m=float(np.linalg.norm(E[:3, 3])),
        unknowns=unknowns,
        covariance=_covariance(names, units, solution.covariance),
    )


def pose_command(
    task: Task, solution: Solution, T_now: Floats, E_initial: Floats, mounting: str, frame_id: str
) -> PoseCommand:
    """Return the command of a solved motion (§1) with its covariance.

    Parameters
    ----------
    task : the task space.
    solution : a motion to use.
    T_now : (4, 4) present pose, `W_T_S` eye-in-hand, `B_T_tool` eye-to-hand.
    E_initial : (4, 4) the same as `E_S_from_W`.
    mounting, frame_id : what carries the cameras, and the name of W or B.
    """
    T = pose_to_command(T_now, solution.E_to_from, mounting)
    dE = np.einsum("ijb,bf->fij", task.embedding, task.lift_jacobian(solution.p, E_initial))
    # T* = T inv(E') eye-in-hand, and d inv(E') = −inv(E') dE' inv(E'); T* = E' T eye-to-hand.
    dT = dE @ T_now if mounting == "eye_to_hand" else -T @ dE @ inverse(solution.E_to_from)
    J = np.empty((6, task.n_motion))
    J[:3] = dT[:, :3, 3].T
    turned = dT[:, :3, :3] @ T[:3, :3].T
    J[3:] = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]])
    return PoseCommand(
        frame_id=frame_id,
        position_m=_floats(T[:3, 3]),
        quaternion_xyzw=_floats(Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)),
        covariance=_covariance(_POSE, ("m",) * 3 + ("rad",) * 3, J @ solution.covariance @ J.T),
    )


def number(value: float) -> float | None:
    """Return a number, None where there is none."""
    return float(value) if np.isfinite(value) else None


def _matrix(values: Floats) -> Matrix:
    return tuple(_floats(row) for row in values)


def _floats(values: Floats) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _covariance(names: tuple[str, ...], units: tuple[str, ...], values: Floats) -> Covariance | None:
    if not np.isfinite(values).all():
        return None
    return Covariance(components=names, units=units, matrix=_matrix(values))
