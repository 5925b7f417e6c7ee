"""The function over joints: exact without noise, indifferent to kinematics, of one configuration."""

from __future__ import annotations

import pytest

from vmf.spec.studies import JointSpaceStudy, KinematicsError, Link
from vmf.study import StudyResult, carry_out

SMALL = JointSpaceStudy(targets=16, frames=(150,), questions=20, wrong=())


def found(result: StudyResult) -> dict[tuple[str, str, str], float]:
    return {(q.quantity, q.case, q.component): q.value for q in result.quantities}


@pytest.fixture(scope="module")
def noisy() -> dict[tuple[str, str, str], float]:
    wrong = (
        KinematicsError(name="off", length_m=0.05, zero_rad=0.1),
        KinematicsError(name="changed", tool_m=0.1, after_training=True),
    )
    return found(carry_out(SMALL.model_copy(update={"wrong": wrong})))


def test_without_noise_nothing_is_left_over_joints_whatever_the_links(
    noisy: dict[tuple[str, str, str], float],
) -> None:
    exact = 1e-9
    assert noisy["model_error_median", "joint space", ""] < exact
    assert noisy["model_error_median", "SE(3), exact kinematics", ""] < exact
    # Over SE(3) wrong kinematics leave something, and more if they change after training.
    assert noisy["model_error_median", "SE(3), off", ""] > 1e3 * exact
    assert noisy["model_error_median", "SE(3), changed", ""] > 1e3 * exact


def test_with_noise_a_change_of_tool_spoils_the_function_over_poses_only(
    noisy: dict[tuple[str, str, str], float],
) -> None:
    for protocol in ("trained_code", "held_out"):
        component = f"{protocol}, frames=150"
        joints = noisy["joint_error_median", "joint space", component]
        exact = noisy["joint_error_median", "SE(3), exact kinematics", component]
        changed = noisy["joint_error_median", "SE(3), changed", component]
        still = noisy["joint_error_median", "no motion", component]
        assert max(joints, exact) < 0.5 * still
        assert changed > 2 * joints


def test_parameters_over_joints_belong_to_a_configuration(noisy: dict[tuple[str, str, str], float]) -> None:
    assert noisy["configuration_change_median", "first joint", ""] < 1e-9
    assert noisy["configuration_change_median", "all joints", ""] > 1.0


def test_unknowns_are_counted_for_as_many_joints_as_arms_have(
    noisy: dict[tuple[str, str, str], float],
) -> None:
    assert noisy["unknowns", "SE(3)", ""] == 38
    assert noisy["unknowns", "joint space", "joints=3"] == 80
    assert noisy["unknowns", "joint space", "joints=6"] == 2186


def test_two_joints_do_with_fewer_frames() -> None:
    two = SMALL.model_copy(
        update={
            "links": (Link(d_m=0.3, a_m=0.2, alpha_deg=90.0), Link(a_m=0.3, alpha_deg=-90.0)),
            "home_rad": (0.1, 0.2),
            "frames": (60,),
            "pixel_px": 0.5,
        }
    )
    values = found(carry_out(two))
    error = values["joint_error_median", "joint space", "trained_code, frames=60"]
    assert error < 0.1 * values["joint_error_median", "no motion", "trained_code, frames=60"]
