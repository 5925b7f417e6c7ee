"""Projection against OpenCV, and the borders of an image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vmf.geometry import camera_matrix, from_rotation_translation, in_view, parallel_rig, project, stereo_code
from vmf.geometry.camera import R_CAMERA_FROM_BODY

EPS = np.finfo(float).eps
K = np.array([[469.0, 1.5, 344.0], [0.0, 471.0, 256.0], [0.0, 0.0, 1.0]])


def test_projection_is_opencvs(rng):
    R = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix()
    p = np.array([0.1, -0.2, 0.3])
    P = rng.uniform(-1, 1, (50, 3)) + np.array([0, 0, 4])
    no_skew = K * [[1, 0, 1], [0, 1, 1], [0, 0, 1]]
    expected, _ = cv2.projectPoints(P, cv2.Rodrigues(R)[0], -R @ p, no_skew, None)
    pixels, depth = project(camera_matrix(no_skew, R, p), P)
    # Three-term sums of numbers below 3000 px, divided by depths above 2 m.
    np.testing.assert_allclose(pixels, expected[:, 0], rtol=0, atol=32 * EPS * 3000)
    np.testing.assert_allclose(depth, (P - p) @ R[2], rtol=0, atol=32 * EPS * 5)


def test_a_camera_sees_its_axis_in_the_principal_point_and_skew_in_x():
    M = camera_matrix(K, np.eye(3), [1.0, 2.0, 3.0])
    pixels, depth = project(M, [[1.0, 2.0, 5.0], [1.0, 3.0, 5.0]])
    np.testing.assert_allclose(pixels, [[344, 256], [344 + 0.75, 256 + 235.5]], rtol=32 * EPS)
    np.testing.assert_array_equal(depth, [2.0, 2.0])


def test_body_axes_are_a_rotation():
    np.testing.assert_array_equal(R_CAMERA_FROM_BODY @ R_CAMERA_FROM_BODY.T, np.eye(3))
    assert np.linalg.det(R_CAMERA_FROM_BODY) == pytest.approx(1.0)
    np.testing.assert_array_equal(R_CAMERA_FROM_BODY @ [1, 2, 3], [-2, -3, 1])


def test_parallel_rig_has_its_baseline_along_x_and_disparity_f_b_over_z(rng):
    rig = parallel_rig(K, K, 0.2, np.eye(3), [-0.1, 0.0, 0.1])
    P = rng.uniform(-0.5, 0.5, (20, 3)) + np.array([0, 0, 2])
    codes, depth = stereo_code(rig, P)
    assert codes.shape == (20, 4)
    assert depth.shape == (20, 2)
    np.testing.assert_allclose(
        codes[:, 0] - codes[:, 2], 469 * 0.2 / (P[:, 2] - 0.1), rtol=0, atol=64 * EPS * 700
    )
    np.testing.assert_allclose(codes[:, 1], codes[:, 3], rtol=0, atol=64 * EPS * 700)
    np.testing.assert_allclose(depth[:, 0], depth[:, 1], rtol=8 * EPS)
    for M, columns in ((rig.left, [0, 1]), (rig.right, [2, 3])):
        np.testing.assert_array_equal(project(M, P)[0], codes[:, columns])


def test_the_right_camera_stands_to_the_right_in_any_frame():
    rig = parallel_rig(K, K, 0.2, R_CAMERA_FROM_BODY, [0.1, 0.1, 0.0])
    # y points left in the body's frame: the right camera's centre is at y = −0.1.
    for M, centre in ((rig.left, [0.1, 0.1, 0.0]), (rig.right, [0.1, -0.1, 0.0])):
        np.testing.assert_allclose(M @ [*centre, 1.0], 0.0, atol=8 * EPS * 469)


def test_moving_the_world_and_moving_the_camera_are_one(rng):
    R = Rotation.from_rotvec([0.1, 0.2, -0.1]).as_matrix()
    E = from_rotation_translation(R, [0.1, 0.0, -0.2])
    P = rng.uniform(-0.5, 0.5, (10, 3)) + np.array([0, 0, 2])
    M = camera_matrix(K, np.eye(3), np.zeros(3))
    moved, _ = project(M, P @ R.T + E[:3, 3])
    np.testing.assert_allclose(project(M @ E, P)[0], moved, rtol=0, atol=64 * EPS * 2000)


def test_batches_of_cameras_and_points_broadcast(rng):
    M = rng.normal(size=(2, 1, 3, 4))
    P = rng.normal(size=(5, 3))
    pixels, depth = project(M, P)
    assert pixels.shape == (2, 5, 2)
    for i, j in np.ndindex(2, 5):
        np.testing.assert_allclose(pixels[i, j], project(M[i, 0], P[j])[0], rtol=1e-12)
        np.testing.assert_allclose(depth[i, j], M[i, 0, 2] @ [*P[j], 1], rtol=0, atol=32 * EPS)


def test_depth_is_zero_in_the_cameras_plane_and_negative_behind():
    _, depth = project(np.eye(3, 4), [[0.1, 0.2, 0.0], [0.1, 0.2, -1.0]])
    np.testing.assert_array_equal(depth, [0.0, -1.0])


def test_a_point_in_the_cameras_plane_is_no_trouble_for_large_pixels():
    _, depth = project(camera_matrix(K, np.eye(3), np.zeros(3)), [0.3, 0.2, 0.0])
    assert depth == 0.0


INSIDE = (100.0, 100.0, 100.0, 100.0)


@pytest.mark.parametrize("axis", [0, 1, 2, 3])
def test_an_image_reaches_from_minus_half_to_its_size_minus_half(axis):
    size = 640 if axis % 2 == 0 else 480
    for value, inside in (
        (-0.5, True),
        (np.nextafter(-0.5, -1), False),
        (size - 0.5, True),
        (np.nextafter(size - 0.5, 1e9), False),
        (np.nan, False),
    ):
        code = list(INSIDE)
        code[axis] = value
        assert in_view([code], [[1.0, 1.0]], (640, 480)).tolist() == [inside]


@pytest.mark.parametrize(
    ("depth", "visible"), [((1, 1), True), ((0, 1), False), ((1, -1), False), ((1, np.nan), False)]
)
def test_only_what_is_in_front_of_both_cameras_is_in_view(depth, visible):
    assert bool(in_view(INSIDE, depth, (640, 480))) is visible
