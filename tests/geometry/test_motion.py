"""Laws of rigid motions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from vmf.geometry import (
    from_quaternion,
    from_rotation_translation,
    interpolate,
    inverse,
    nearest_rotation,
    rotation_angle,
)

EPS = np.finfo(float).eps
# Rounding of a product of a few 4×4 matrices with unit columns: a dozen operations an entry.
ROUNDING = 32 * EPS

rotation_vectors = arrays(float, 3, elements=st.floats(-3.0, 3.0))
positions = arrays(float, 3, elements=st.floats(-100.0, 100.0))


def rigid(rotvec, t):
    return from_rotation_translation(Rotation.from_rotvec(rotvec).as_matrix(), t)


@given(rotation_vectors, positions)
def test_inverse_undoes_a_motion(rotvec, t):
    E = rigid(rotvec, t)
    size = 1.0 + np.abs(t).max()
    np.testing.assert_allclose(inverse(E) @ E, np.eye(4), rtol=0, atol=ROUNDING * size)
    np.testing.assert_allclose(E @ inverse(E), np.eye(4), rtol=0, atol=ROUNDING * size)
    np.testing.assert_allclose(inverse(inverse(E)), E, rtol=0, atol=ROUNDING * size)


def test_inverse_keeps_batch_axes(rng):
    E = rigid(rng.normal(size=(6, 3)), rng.normal(size=(6, 3))).reshape(2, 3, 4, 4)
    together = inverse(E)
    for i in np.ndindex(2, 3):
        np.testing.assert_allclose(together[i], np.linalg.inv(E[i]), rtol=0, atol=10 * ROUNDING)


def test_rotation_and_translation_broadcast():
    E = from_rotation_translation(np.eye(3), np.arange(6.0).reshape(2, 3))
    assert E.shape == (2, 4, 4)
    np.testing.assert_array_equal(E[:, :3, 3], [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(E[:, 3], [[0, 0, 0, 1]] * 2)


@given(rotation_vectors, st.floats(0.1, 10.0))
def test_quaternions_of_any_length_mean_one_rotation(rotvec, length):
    rotation = Rotation.from_rotvec(rotvec)
    E = from_quaternion(np.zeros(3), length * rotation.as_quat())
    np.testing.assert_allclose(E[:3, :3], rotation.as_matrix(), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-100, 1e-16, 1e-8, 1e-3, 1.0, 3.0])
def test_rotation_angle_is_relatively_accurate_down_to_zero(angle):
    axis = np.array([0.6, 0.0, 0.8])
    # I + sin θ [u]× + … : written with its small terms, the matrix itself holds a tiny angle exactly.
    cross = np.cross(np.eye(3), -axis)
    R = np.eye(3) + np.sin(angle) * cross + 2 * np.sin(angle / 2) ** 2 * cross @ cross
    assert rotation_angle(R) == pytest.approx(angle, rel=1e-14, abs=0.0)


@pytest.mark.parametrize("short_of_pi", [0.0, 1e-12, 1e-8, 1e-4, 0.1])
def test_rotation_angle_is_accurate_near_half_a_turn(short_of_pi):
    E = from_rotation_translation(
        Rotation.from_rotvec((np.pi - short_of_pi) * np.array([0.6, 0.0, 0.8])).as_matrix(), np.ones(3)
    )
    # An arc cosine of the trace would be off by √eps = 1.5e-8 here.
    assert abs(rotation_angle(E) - (np.pi - short_of_pi)) <= ROUNDING


@given(arrays(float, (3, 3), elements=st.floats(-10.0, 10.0)))
def test_nearest_rotation_is_a_rotation_and_none_is_nearer(A):
    R = nearest_rotation(A)
    np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0, atol=ROUNDING)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=ROUNDING)
    distance = np.linalg.norm(R - A)
    rotations = np.concatenate(
        [
            Rotation.random(200, rng=np.random.default_rng(1)).as_matrix(),
            Rotation.from_rotvec(np.random.default_rng(2).normal(0, 1e-3, (50, 3))).as_matrix() @ R,
        ]
    )
    assert (np.linalg.norm(rotations - A, axis=(1, 2)) >= distance - 100 * ROUNDING).all()


@given(rotation_vectors, st.floats(0.1, 10.0))
def test_nearest_rotation_leaves_a_scaled_rotation_alone(rotvec, scale):
    R = Rotation.from_rotvec(rotvec).as_matrix()
    np.testing.assert_allclose(nearest_rotation(scale * R), R, rtol=0, atol=ROUNDING)


def test_nearest_rotation_of_a_reflection_is_no_reflection():
    R = nearest_rotation(np.diag([3.0, 2.0, -1.0]))
    np.testing.assert_allclose(R, np.eye(3), rtol=0, atol=ROUNDING)


class TestInterpolate:
    TIMES = np.array([0, 1_000_000_000, 3_000_000_000], dtype=np.int64)

    @pytest.fixture
    def E(self, rng):
        return rigid(rng.normal(0, 0.7, (3, 3)), rng.normal(size=(3, 3)))

    def test_is_exact_at_the_known_times(self, E):
        np.testing.assert_allclose(interpolate(self.TIMES, E, self.TIMES), E, rtol=0, atol=4 * ROUNDING)

    def test_halfway_of_pure_rotation_is_slerp(self, E):
        R = from_rotation_translation(E[:, :3, :3], np.zeros(3))
        at = np.array([500_000_000, 2_000_000_000, 2_300_000_001], dtype=np.int64)
        expected = Slerp(self.TIMES.astype(float), Rotation.from_matrix(E[:, :3, :3]))(at.astype(float))
        found = interpolate(self.TIMES, R, at)
        np.testing.assert_allclose(found[:, :3, :3], expected.as_matrix(), rtol=0, atol=4 * ROUNDING)
        np.testing.assert_array_equal(found[:, :3, 3], 0.0)

    def test_pure_translation_is_linear(self):
        E = from_rotation_translation(np.eye(3), np.array([[0.0, 0, 0], [1, 2, 3], [1, 2, 7]]))
        found = interpolate(self.TIMES, E, np.array([250_000_000, 2_500_000_000]))
        np.testing.assert_allclose(
            found[:, :3, 3], [[0.25, 0.5, 0.75], [1, 2, 6]], rtol=0, atol=10 * ROUNDING
        )

    def test_twist_is_constant_between_neighbours(self, E):
        # Ten equal steps of one stretch are ten times the same motion.
        at = np.linspace(1e9, 3e9, 11)
        found = interpolate(self.TIMES, E, at)
        steps = inverse(found[:-1]) @ found[1:]
        np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), rtol=0, atol=20 * ROUNDING)
        np.testing.assert_allclose(
            np.linalg.matrix_power(steps[0], 10), inverse(E[1]) @ E[2], rtol=0, atol=200 * ROUNDING
        )

    def test_does_not_depend_on_the_world_frame(self, E, rng):
        G = rigid(rng.normal(size=3), rng.normal(size=3))
        at = np.array([700_000_000])
        np.testing.assert_allclose(
            interpolate(self.TIMES, G @ E, at), G @ interpolate(self.TIMES, E, at), atol=40 * ROUNDING, rtol=0
        )

    def test_unsorted_questions_are_answered_in_their_order(self, E):
        at = np.array([2_500_000_000, 100, 1_000_000_000])
        found = interpolate(self.TIMES, E, at)
        for one, t in zip(found, at, strict=True):
            np.testing.assert_array_equal(one, interpolate(self.TIMES, E, np.array([t]))[0])

    def test_no_question_no_answer(self, E):
        assert interpolate(self.TIMES, E, np.array([], dtype=np.int64)).shape == (0, 4, 4)

    def test_one_known_motion_answers_its_own_time(self, E):
        np.testing.assert_allclose(
            interpolate(np.array([5]), E[:1], np.array([5])), E[:1], rtol=0, atol=ROUNDING * 4
        )

    @pytest.mark.parametrize("outside", [-1, 3_000_000_001])
    def test_refuses_to_extrapolate(self, E, outside):
        with pytest.raises(ValueError, match="outside"):
            interpolate(self.TIMES, E, np.array([outside]))
