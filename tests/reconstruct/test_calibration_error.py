import numpy as np
import pytest
from rival_scenes import K, thesis_rig
from scipy.spatial.transform import Rotation

from vmf.geometry import parallel_rig, stereo_code
from vmf.reconstruct import CalibrationError, RigModel, disturb, label, triangulate
from vmf.spec.model import CalibrationError as StatedInASpec

RIG = thesis_rig("planar")


def decompose(M):
    """Intrinsics, orientation and centre of a camera matrix with a positive depth axis."""
    A = M[:, :3]
    # RQ by QR of the reversed transpose.
    Q, R = np.linalg.qr(np.flipud(A).T)
    R, Q = np.fliplr(np.flipud(R.T)), np.flipud(Q.T)
    sign = np.diag(np.sign(np.diag(R)))
    return R @ sign, sign @ Q, -np.linalg.solve(A, M[:, 3])


def test_no_error_is_the_parallel_rig():
    exact = parallel_rig(K, K, RIG.baseline_m, RIG.R_camera_from_S, RIG.p_left_in_S)
    np.testing.assert_allclose(RIG.cameras().M, exact.M, atol=1e-12)


def test_every_part_changes_what_it_says():
    cameras = disturb(RIG, CalibrationError(1.0, 2.0, 0.5, 10.0))
    (K_l, R_l, p_l), (K_r, R_r, p_r) = (decompose(M) for M in cameras.M)
    wanted = np.array([[469.0 / 1.01, 0.0, 342.0], [0.0, 472.0 / 1.01, 253.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(K_l, wanted, atol=1e-9)
    np.testing.assert_allclose(K_r, wanted, atol=1e-9)
    np.testing.assert_allclose(p_l, RIG.p_left_in_S, atol=1e-12)
    np.testing.assert_allclose(1.1 * (p_r - p_l), RIG.baseline_m * RIG.R_camera_from_S[0], atol=1e-12)
    # Vergence: about the camera's y axis, half by each.
    for R, half in ((R_l, 0.25), (R_r, -0.25)):
        turn = Rotation.from_matrix(R @ RIG.R_camera_from_S.T).as_rotvec(degrees=True)
        np.testing.assert_allclose(turn, [0.0, half, 0.0], atol=1e-9)


def test_a_spec_states_errors_the_same_way():
    parts = {"focal_percent": 1.0, "rotation_deg": 0.5}
    same = disturb(RIG, StatedInASpec(**parts)).M
    np.testing.assert_array_equal(same, disturb(RIG, CalibrationError(**parts)).M)
    assert label("pnp", StatedInASpec(**parts)) == label("pnp", CalibrationError(**parts))


def test_a_wrong_baseline_scales_depth():
    P = np.array([2.0, 0.1, -0.2])
    true, said = (disturb(RIG, CalibrationError(baseline_percent=b)) for b in (0.0, 10.0))
    disparity = [code[0] - code[2] for code in (stereo_code(true, P)[0], stereo_code(said, P)[0])]
    assert disparity[0] == pytest.approx(1.1 * disparity[1])


def test_the_truth_is_off_from_the_calibration_by_the_error():
    """Disturbing what a wrong calibration says by the same error gives the truth back."""
    error = CalibrationError(1.0, 2.0, 0.0, 10.0)
    K_said = K * [[1 / 1.01, 1.0, 1.0], [1.0, 1 / 1.01, 1.0], [1.0, 1.0, 1.0]]
    K_said[:2, 2] -= 2.0
    said = RigModel(K_said, K_said, RIG.R_camera_from_S, RIG.p_left_in_S, RIG.baseline_m / 1.1)
    np.testing.assert_allclose(disturb(RIG, error).M, said.cameras().M, atol=1e-12)


def test_cameras_truly_turned_inwards_make_points_seem_farther():
    P = np.array([[2.0, 0.1, -0.2], [1.5, -0.2, 0.1], [2.5, 0.0, 0.3]])
    codes = stereo_code(RIG.cameras(), P)[0]
    for error, sign in ((0.5, 1), (-0.5, -1)):
        found = triangulate(disturb(RIG, CalibrationError(rotation_deg=error)), codes).points
        assert (sign * (found[:, 0] - P[:, 0]) > 0.05).all()


@pytest.mark.parametrize(
    ("error", "name"),
    [
        (CalibrationError(), "bundle"),
        (CalibrationError(focal_percent=1.0, rotation_deg=0.5), "bundle[focal=1%,rot=0.5deg]"),
        (CalibrationError(principal_px=2.0), "bundle[pp=2px]"),
        (CalibrationError(baseline_percent=1.0), "bundle[base=1%]"),
        (CalibrationError(-0.5, 2.0, 0.25, 1.0), "bundle[focal=-0.5%,pp=2px,rot=0.25deg,base=1%]"),
    ],
)
def test_labels_state_the_parts_that_are_wrong(error, name):
    assert label("bundle", error) == name
