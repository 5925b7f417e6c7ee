"""Velocities from the function's derivative: the classical interaction matrix, and a V that decreases."""

from __future__ import annotations

import numpy as np
import pytest

from vmf.errors import InputError
from vmf.geometry import stereo_code
from vmf.spec.model import Rig
from vmf.spec.studies import Box, FeedbackStudy, Training
from vmf.study import StudyResult, carry_out
from vmf.study.feedback import interaction_matrix
from vmf.study.rig import rig_cameras, visible_points
from vmf.tasks import make_task

SMALL = FeedbackStudy(
    starts=4, duration_s=4.0, sources=("analytic",), pixel_px=(0.0,), training=Training(frames=80, targets=18)
)


def found(result: StudyResult) -> dict[tuple[str, str, str], float]:
    return {(q.quantity, q.case, q.component): q.value for q in result.quantities}


def test_the_derivative_is_that_of_the_pixels(rng: np.random.Generator) -> None:
    task, cameras = make_task("six_dof"), rig_cameras(Rig())
    P = visible_points(Box(), Rig(), 5, rng)
    J = interaction_matrix(task, task.parameters(cameras.M, P[None, :, None, :]))
    h = 1e-6
    for k in range(6):
        ends = []
        for sign in (1, -1):
            E = task.motion(sign * h * np.eye(6)[k], np.eye(4))
            ends.append(stereo_code(cameras, P @ E[:3, :3].T + E[:3, 3])[0].ravel())
        # Pixels change by hundreds per unit; second derivatives cancel.
        np.testing.assert_allclose(J[0, :, k], (ends[0] - ends[1]) / (2 * h), rtol=1e-6, atol=1e-4)


def test_the_derivative_is_the_interaction_matrix_of_visual_servoing(rng: np.random.Generator) -> None:
    """Of cameras beside S, for motions of the points; the camera's are minus those."""
    rig = Rig(forward_m=0.0, baseline_m=0.2)
    task, cameras = make_task("six_dof"), rig_cameras(rig)
    P = visible_points(Box(), rig, 4, rng)
    J = interaction_matrix(task, task.parameters(cameras.M, P[None, :, None, :])).reshape(4, 2, 2, 6)
    for k, point in enumerate(P):
        for side, offset in enumerate((-0.1, 0.1)):
            X, Y, Z = point - [offset, 0.0, 0.0]
            x, y = X / Z, Y / Z
            translation = np.array([[1 / Z, 0, -x / Z], [0, 1 / Z, -y / Z]])
            # A turn about S moves the point, seen from this camera, by ω × point.
            cross = np.array([[0, point[2], -point[1]], [-point[2], 0, point[0]], [point[1], -point[0], 0]])
            rotation = translation @ cross
            scale = np.diag([rig.fx_px, rig.fy_px])
            # Unknowns are turns about z, y, x, then the translation.
            expected = scale @ np.column_stack([rotation[:, ::-1], translation])
            np.testing.assert_allclose(J[k, side], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("source", ["analytic", "structured", "transport"])
def test_v_decreases_at_every_step_from_every_start(source: str) -> None:
    values = found(carry_out(SMALL.model_copy(update={"sources": (source,)})))
    for gain in SMALL.gains_per_s:
        component = f"gain={gain:g}"
        assert values["steps_under_way", source, component] > 50
        assert values["lyapunov_increases_share", source, component] == 0.0
        # V̇ = −2 λ rate V: negative wherever a start came by.
        assert values["lyapunov_rate_min", source, component] > 0.0
        assert values["arrived_share", source, component] == 1.0


def test_a_gain_that_the_rate_does_not_allow_is_not_stable() -> None:
    """Steps of more than twice the error overshoot: Euler's x ← (1 − λ/rate) x with λ/rate > 2."""
    values = found(carry_out(SMALL.model_copy(update={"gains_per_s": (2.5 * SMALL.rate_hz,)})))
    increases = [v for (name, _, _), v in values.items() if name == "lyapunov_increases_share"]
    assert increases
    assert min(increases) > 0.5


def test_noise_in_the_loop_leaves_its_own_size() -> None:
    values = found(carry_out(SMALL.model_copy(update={"pixel_px": (1.0,), "gains_per_s": (2.0,)})))
    assert values["lyapunov_increases_share", "analytic, 1 px", "gain=2"] == 0.0
    assert 0.01 < values["final_error_median", "analytic, 1 px", "gain=2"] < 5.0


def test_what_cannot_be_learned_is_an_input_error() -> None:
    few = SMALL.model_copy(
        update={"sources": ("structured",), "training": Training(frames=3, targets=3), "targets": 3}
    )
    with pytest.raises(InputError, match=r"study\.training: structured learned nothing"):
        carry_out(few)


@pytest.mark.parametrize(("gain", "said"), [(7.0, 0), (12.0, 1), (20.0, 1)])
def test_gains_that_cannot_be_stable_are_named(gain: float, said: int) -> None:
    result = carry_out(SMALL.model_copy(update={"gains_per_s": (gain,), "rate_hz": 4.0}))
    assert len([note for note in result.notes if "cannot be stable" in note]) == said
    # The bound is 8: below it errors shrink, well above they grow.
    (share,) = [q.value for q in result.quantities if q.quantity == "decreased_share"]
    assert share == 1.0 - said
