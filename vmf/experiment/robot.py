"""What is known of the robot when a motion is asked for: its present pose, and a rotation that is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.data import BodyPoses, PanTiltJoints
from vmf.errors import InputError
from vmf.experiment.build import build_task
from vmf.experiment.views import Request
from vmf.geometry import from_quaternion, from_rotation_translation, inverse, rotation_angle
from vmf.spec import Spec

Floats = NDArray[np.float64]

# A pan-tilt head's pose may be off by this much (rad) as its axes are.
_NO_PAN_TILT = 0.02


@dataclass(frozen=True)
class Robot:
    """Where the robot is, as far as that is known, and what is given of its motion.

    Attributes
    ----------
    T : (4, 4) present pose as reported, None where it is not.
    joints : present pan and tilt (rad), None for other tasks.
    E_initial : (4, 4) present pose `E_S_from_W`; any will do where the task does not need it.
    E_desired : (4, 4) a pose whose motion from there has the given rotation.
    """

    T: Floats | None
    joints: Floats | None
    E_initial: Floats
    E_desired: Floats

    @classmethod
    def of(cls, spec: Spec, request: Request) -> Robot:
        """Take what the task needs.

        Raises
        ------
        InputError : that is missing, or there is something that the model has no use for.
        """
        T, joints, E = None, None, np.eye(4)
        if request.joints is not None and spec.task != "pan_tilt":
            raise InputError(f"joints: found, but {spec.task} has none; they belong to pan_tilt")
        if request.pose_numbers is not None:
            body = _body(request.pose_numbers)
            T = from_quaternion(body.position_m, body.quaternion_xyzw)[0]
            E = body.motions(spec.mounting)[0]
        if request.joints is not None:
            joints = np.array(request.joints)
            E = PanTiltJoints(joints[:1], joints[1:]).motions(spec.mounting)[0]
        elif spec.task == "pan_tilt":
            if T is None:
                raise InputError(
                    "pan_tilt: the present tilt is missing, --joints PAN,TILT or --pose is accepted"
                )
            task = build_task(spec).world()
            joints = task.coordinates(E, np.eye(4))
            off = float(rotation_angle(inverse(task.motion(joints, np.eye(4))) @ E))
            if off > _NO_PAN_TILT:
                raise InputError(
                    f"pose: found an orientation that is {off:.3g} rad off any that pan and tilt reach, at "
                    f"most {_NO_PAN_TILT:g} rad is accepted"
                )
        R = _given_rotation(spec, request, E)
        return cls(T, joints, E, from_rotation_translation(R, np.zeros(3)) @ E)


def _given_rotation(spec: Spec, request: Request, E_initial: Floats) -> Floats:
    """Return the rotation (3, 3) of the motion E' where it is given, none where it is asked for."""
    asked_for = spec.solver.known != "rotation"
    for name, value in (("rotation", request.rotation), ("orientation", request.orientation)):
        if asked_for and value is not None:
            raise InputError(
                f"{name}: found, but this model solves for it; solver.known=rotation takes it as given"
            )
    if asked_for:
        return np.eye(3)
    if request.rotation is not None:
        return from_quaternion(np.zeros(3), request.rotation)[:3, :3]
    if request.orientation is None:
        raise InputError(
            "rotation: missing, solver.known is rotation; --rotation of the motion, or --orientation of the "
            "goal, is accepted"
        )
    if request.pose_numbers is None:
        raise InputError("orientation: found without the present pose, --pose beside it is accepted")
    goal = _body((0.0, 0.0, 0.0, *request.orientation)).motions(spec.mounting)[0]
    return np.asarray(goal[:3, :3] @ E_initial[:3, :3].T)


def _body(numbers: tuple[float, ...]) -> BodyPoses:
    values = np.array(numbers)[None]
    return BodyPoses(values[:, :3], values[:, 3:])
