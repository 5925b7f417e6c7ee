import cv2
import numpy as np
import pytest
from rival_scenes import thesis_rig
from scipy.optimize import approx_fprime, least_squares

from vmf.geometry import StereoCameras, stereo_code
from vmf.reconstruct import CalibrationError, disturb, triangulate

PARALLEL = thesis_rig("six_dof").cameras()
VERGING = disturb(thesis_rig("six_dof"), CalibrationError(2.0, 3.0, 4.0, 5.0))


def random_points(rng, *shape):
    return rng.uniform([-0.5, -0.5, 1.0], [0.5, 0.5, 4.0], (*shape, 3))


@pytest.mark.parametrize("cameras", [PARALLEL, VERGING])
def test_noise_free_codes_give_the_points_back_as_opencv_does(cameras):
    P = random_points(np.random.default_rng(1), 50)
    codes, _ = stereo_code(cameras, P)
    found = triangulate(cameras, codes)
    h = cv2.triangulatePoints(cameras.left, cameras.right, codes[:, :2].T, codes[:, 2:].T)
    # A pixel's rounding, 1e-13 px, over a disparity of at least 20 px.
    np.testing.assert_allclose(found.points, P, atol=1e-10)
    np.testing.assert_allclose(found.points, (h[:3] / h[3]).T, atol=1e-9)
    assert found.ok.all()
    assert found.residual_px.max() < 1e-10


def test_points_of_least_reprojection_error():
    rng = np.random.default_rng(2)
    P = random_points(rng, 10)
    codes = stereo_code(VERGING, P)[0] + 3.0 * rng.standard_normal((10, 4))
    found = triangulate(VERGING, codes)
    for j, code in enumerate(codes):
        best = least_squares(lambda x, c=code: stereo_code(VERGING, x)[0] - c, P[j], xtol=1e-15, ftol=1e-15)
        # A flat minimum: half the digits of the cost.
        np.testing.assert_allclose(found.points[j], best.x, rtol=1e-6, atol=1e-7)
        assert found.residual_px[j] == pytest.approx(np.sqrt(2.0 * best.cost / 4.0), rel=1e-9)


def test_a_parallel_rig_takes_the_mean_row_and_the_measured_columns():
    rng = np.random.default_rng(3)
    codes = stereo_code(PARALLEL, random_points(rng, 20))[0] + rng.standard_normal((20, 4))
    seen = stereo_code(PARALLEL, triangulate(PARALLEL, codes).points)[0]
    row = codes[:, [1, 3]].mean(axis=1)
    np.testing.assert_allclose(seen, np.column_stack([codes[:, 0], row, codes[:, 2], row]), atol=1e-9)


def test_covariance_is_the_inverse_information_of_the_code():
    P = random_points(np.random.default_rng(4), 5)
    found = triangulate(VERGING, stereo_code(VERGING, P)[0])
    for j in range(5):
        J = approx_fprime(P[j], lambda x: stereo_code(VERGING, x)[0], 1e-7)
        np.testing.assert_allclose(found.covariance[j], np.linalg.inv(J.T @ J), rtol=1e-4, atol=1e-12)


def test_what_cannot_be_triangulated_is_not_ok_and_leaves_the_rest_alone():
    P = random_points(np.random.default_rng(5), 2, 3)
    codes = stereo_code(PARALLEL, P)[0]
    whole = triangulate(PARALLEL, codes)
    codes[0, 1, 2:] = np.nan
    codes[1, 2] = codes[1, 2][[2, 3, 0, 1]]  # left and right exchanged: behind the cameras
    found = triangulate(PARALLEL, codes)
    assert found.ok.tolist() == [[True, False, True], [True, True, False]]
    for name in ("points", "q", "residual_px", "covariance"):
        one, other = getattr(found, name), getattr(whole, name)
        np.testing.assert_array_equal(one[found.ok], other[found.ok])
        assert np.isnan(one[~found.ok]).all()


def test_cameras_with_one_centre_see_no_depth():
    with pytest.raises(ValueError, match="different centres"):
        triangulate(StereoCameras(np.stack([PARALLEL.left, PARALLEL.left])), np.zeros((1, 4)))
