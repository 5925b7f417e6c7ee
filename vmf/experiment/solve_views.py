"""`vmf solve`: from two views to one command, with a trained model."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vmf.data import Query
from vmf.data.recording import FIXED_FRAMES
from vmf.errors import InputError
from vmf.experiment import model_file
from vmf.experiment.asking import answer
from vmf.experiment.build import build_task, idle_solver_settings
from vmf.experiment.known import Known
from vmf.experiment.model_file import Model
from vmf.experiment.move import (
    Command,
    JointCommand,
    Move,
    motion_of,
    number,
    pose_command,
)
from vmf.experiment.parallel import one_blas_thread
from vmf.experiment.robot import Robot
from vmf.experiment.run import read_record
from vmf.experiment.views import Request
from vmf.solve import Solution
from vmf.spec import Spec

_OPEN = ("solver",)


def solve_views(
    path: Path,
    request: Request,
    overrides: tuple[str, ...] = (),
    *,
    anyway: bool = False,
    frame_id: str | None = None,
) -> Move:
    """Return the motion that makes the initial view the desired one.

    Parameters
    ----------
    path : a run directory, its `latest` link, or a `model.npz`.
    request : the views, and what is known of the robot.
    overrides : dotted settings of `solver`.
    anyway : also ask about codes outside the trained region.
    frame_id : frame of the present pose and of the command; by default the recording's parent frame, else
        `world` eye-in-hand and `base` eye-to-hand.

    Raises
    ------
    InputError : no such model, a code outside the trained region, or something is missing.
    """
    one_blas_thread()
    model = load_model(path)
    spec, learner = model_file.overridden(model, overrides, _OPEN), model.learner
    pairs = request.pairs()
    robot = Robot.of(spec, request)
    known = Known.of(learner, pairs)
    doubts = known.doubts()
    if doubts and not anyway:
        raise InputError(*(f"{doubt}; --anyway solves all the same" for doubt in doubts))
    query = Query(pairs.initial[None], pairs.desired[None], robot.E_initial[None], robot.E_desired[None])
    solution = answer(spec, learner, query)[0]
    targets = known.reports(solution.weights)
    against = "the others" if len(targets) > 1 else "what was learned: its two views do not go together"
    rejected = tuple(f"target {t.id} contradicts {against} and was rejected" for t in targets if t.rejected)
    in_stereo = np.atleast_1d(np.isfinite(np.stack([pairs.initial, pairs.desired])).all(axis=-1).any(axis=0))
    idle = tuple(
        f"target {t.id} has no view in both cameras and was not used"
        for t, seen in zip(targets, in_stereo, strict=True)
        if not seen
    )
    unused = tuple(f"target {name} is in one view only and was not used" for name in pairs.unused)
    task = learner.task
    return Move(
        status=solution.reason.status,
        reason=solution.reason.value,
        task=spec.task,
        mounting=spec.mounting,
        motion=motion_of(task, solution, spec.solver.known == "rotation") if solution.converged else None,
        command=_command(spec, solution, robot, frame_id or _frame_of(spec)) if solution.converged else None,
        residual_px=None if all(t.rejected for t in targets) else number(solution.residual_px),
        iterations=solution.iterations,
        condition=number(solution.condition),
        targets=targets,
        unused=pairs.unused,
        notes=doubts + rejected + idle + unused + idle_solver_settings(spec),
    )


def _command(spec: Spec, solution: Solution, robot: Robot, frame_id: str) -> Command | None:
    """Return what to command, None where the present pose is not known."""
    pose = joints = None
    if robot.T is not None:
        pose = pose_command(build_task(spec), solution, robot.T, robot.E_initial, spec.mounting, frame_id)
    if robot.joints is not None:
        pan, tilt = robot.joints + solution.p
        joints = JointCommand(pan_rad=float(pan), tilt_rad=float(tilt))
    return None if pose is None and joints is None else Command(pose=pose, joints=joints)


def _frame_of(spec: Spec) -> str:
    """Return the frame that the poses of the training were in, as far as the spec says it."""
    recording = spec.data.recording
    if recording is not None and recording.pose is not None and recording.pose.parent is not None:
        # Without tf's old leading slash, which tf2 refuses.
        return recording.pose.parent.lstrip("/")
    return FIXED_FRAMES[spec.mounting]


def load_model(path: Path) -> Model:
    """Load the model of a finished run, or a `model.npz` by itself.

    Raises
    ------
    InputError : there is none.
    """
    if not path.is_dir():
        return model_file.load(path)
    status = read_record(path).get("status")
    if status != "done":
        raise InputError(f"{path}: status {status}, a finished run is expected")
    return model_file.load(path / "model.npz")
