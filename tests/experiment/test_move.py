"""The command of a solved motion: its pose for both mountings, and its covariance."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from vmf.errors import InputError
from vmf.experiment.move import Command, Move, PoseCommand, motion_of, pose_command
from vmf.geometry import from_quaternion, from_rotation_translation, inverse
from vmf.move_output import rendered
from vmf.solve import Solution, StopReason, command
from vmf.tasks import Task, make_task

TASKS = ("pan_tilt", "translation", "planar", "six_dof")
MOUNTINGS = ("eye_in_hand", "eye_to_hand")
STEP = 1e-6


def present_pose(task: Task, mounting: str, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A reported pose, and the same as `E_S_from_W`; of a pan-tilt head it is one that the head can have."""
    if task.name == "pan_tilt":
        E = task.world().motion(random.uniform(-0.5, 0.5, 2), np.eye(4))
    else:
        E = from_rotation_translation(Rotation.random(rng=random).as_matrix(), random.normal(size=3))
    return (E if mounting == "eye_to_hand" else inverse(E)), E


def solution(task: Task, p: np.ndarray, E_initial: np.ndarray, covariance: np.ndarray) -> Solution:
    return Solution(task.motion(p, E_initial), p, covariance, 0.1, 5, 10.0, StopReason.CONVERGED, np.ones(2))


def as_matrix(pose: PoseCommand) -> np.ndarray:
    return from_quaternion(pose.position_m, pose.quaternion_xyzw)


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("name", TASKS)
def test_the_pose_is_that_of_the_method_and_its_covariance_first_order(name: str, mounting: str) -> None:
    """Column by column: the pose moves by J dp, position in the parent frame, turned about its fixed axes."""
    random = np.random.default_rng(5)
    task = make_task(name)
    T, E = present_pose(task, mounting, random)
    p = random.uniform(-0.6, 0.6, task.n_motion)
    A = random.normal(size=(task.n_motion, task.n_motion))
    covariance = A @ A.T

    solved = solution(task, p, E, covariance)
    pose = pose_command(task, solved, T, E, mounting, "somewhere")
    np.testing.assert_allclose(as_matrix(pose), command(T, solved.E_to_from, mounting), atol=1e-14)
    assert pose.frame_id == "somewhere"

    columns = []
    for axis in np.eye(task.n_motion):
        ends = [command(T, task.motion(p + s * axis, E), mounting) for s in (STEP, -STEP)]
        turned = Rotation.from_matrix(ends[0][:3, :3] @ ends[1][:3, :3].T).as_rotvec()
        columns.append(np.concatenate([ends[0][:3, 3] - ends[1][:3, 3], turned]) / (2 * STEP))
    J = np.stack(columns, axis=1)
    assert pose.covariance is not None
    # Central differences are good to rounding over the step.
    np.testing.assert_allclose(pose.covariance.matrix, J @ covariance @ J.T, rtol=1e-7, atol=1e-7)


def test_a_motion_of_unknown_noise_has_no_covariance() -> None:
    task = make_task("six_dof")
    solved = solution(task, np.full(6, 0.1), np.eye(4), np.full((6, 6), np.nan))
    motion = motion_of(task, solved, rotation_given=False)
    assert motion.covariance is None
    assert {unknown.std for unknown in motion.unknowns} == {None}
    assert pose_command(task, solved, np.eye(4), np.eye(4), "eye_in_hand", "world").covariance is None


def test_a_message_with_covariance_needs_one() -> None:
    task = make_task("translation")
    solved = solution(task, np.full(3, 0.1), np.eye(4), np.full((3, 3), np.nan))
    pose = pose_command(task, solved, np.eye(4), np.eye(4), "eye_in_hand", "world")
    move = Move(
        status="ok",
        reason="converged",
        task="translation",
        mounting="eye_in_hand",
        motion=motion_of(task, solved, rotation_given=False),
        command=Command(pose=pose, joints=None),
        residual_px=None,
        iterations=5,
        condition=None,
        targets=(),
        unused=(),
        notes=(),
    )
    assert yaml.safe_load(rendered(move, "pose_stamped") or "")["pose"]["orientation"]["w"] == 1.0
    assert json.loads(rendered(move, "json") or "")["motion"]["covariance"] is None
    with pytest.raises(InputError, match="covariance is unknown, pose_stamped is accepted"):
        rendered(move, "pose_with_covariance_stamped")
