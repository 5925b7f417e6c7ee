import numpy as np
import pytest
from rival_scenes import random_query, thesis_rig
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from vmf.estimate.noise import Noise
from vmf.geometry import StereoCameras, motion, stereo_code
from vmf.reconstruct import reconstruct, triangulate
from vmf.reconstruct.arun import closed_form
from vmf.solve import Query, StopReason
from vmf.solve.unknowns import Unknowns
from vmf.tasks import make_task


def noisy_fit(task, n, seed=1, **options):
    """Solutions and the point pairs they were fitted to."""
    query = random_query(task, 12, n, np.random.default_rng(seed), noise_px=1.0)
    cameras = thesis_rig(task).cameras()
    solutions = reconstruct("triangulate_arun", make_task(task), cameras, query, **options)
    assert (solutions.status == "ok").all()
    P, P_moved = (triangulate(cameras, codes).points for codes in (query.initial, query.desired))
    return query, solutions, P, P_moved


def arun(P, P_moved, used):
    """Return the rigid motions (Q, 4, 4) nearest to point pairs (Q, n, 3)."""
    everything = np.arange(len(P))
    E_c = np.tile(np.eye(4), (len(P), 1, 1))
    unknowns = Unknowns(make_task("six_dof"), E_c, np.zeros((len(P), 6)), np.ones(6, bool))
    return unknowns.motion(closed_form(unknowns, P, P_moved, used, everything), everything)


def test_closed_form_agrees_with_scipy_and_skips_unused_points():
    rng = np.random.default_rng(2)
    P = rng.normal(size=(20, 7, 3))
    E = motion.from_rotation_translation(Rotation.random(20, rng=rng).as_matrix(), rng.normal(size=(20, 3)))
    P_moved = P @ np.swapaxes(E[:, :3, :3], -1, -2) + E[:, None, :3, 3] + 0.3 * rng.normal(size=P.shape)
    used = np.ones((20, 7), bool)
    used[:, 5:] = False
    P[:, 5:] = np.nan
    for found, a, b in zip(arun(P, P_moved, used), P[:, :5], P_moved[:, :5], strict=True):
        R, _ = Rotation.align_vectors(b - b.mean(axis=0), a - a.mean(axis=0))
        np.testing.assert_allclose(found[:3, :3], R.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(found[:3, 3], b.mean(axis=0) - R.apply(a.mean(axis=0)), atol=1e-12)


def test_points_on_a_plane_are_not_reflected():
    P = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 2.0, 0.0]]])
    R = Rotation.from_rotvec([0.3, -2.0, 0.5]).as_matrix()
    found = arun(P, P @ R.T, np.ones((1, 4), bool))
    np.testing.assert_allclose(found[0, :3, :3], R, atol=1e-12)


def test_six_dof_is_the_closed_form():
    _, solutions, P, P_moved = noisy_fit("six_dof", 6)
    closed_form = arun(P, P_moved, np.ones(P.shape[:2], bool))
    # The minimisation ends at a relative change of cost of 1e-14, of motion of its square root.
    np.testing.assert_allclose(solutions.E_to_from, closed_form, rtol=0, atol=1e-7)


def test_translation_is_the_mean_difference():
    _, solutions, P, P_moved = noisy_fit("translation", 3)
    np.testing.assert_allclose(solutions.p, (P_moved - P).mean(axis=1), atol=1e-10)


def test_planar_is_procrustes_in_the_plane():
    _, solutions, P, P_moved = noisy_fit("planar", 2)
    a, b = (x[..., :2] - x[..., :2].mean(axis=1, keepdims=True) for x in (P, P_moved))
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    heading = np.arctan2(cross.sum(axis=1), (a * b).sum(axis=(1, 2)))
    np.testing.assert_allclose(solutions.p[:, 0], heading, atol=1e-10)
    R = solutions.E_to_from[:, :2, :2]
    t = P_moved[..., :2].mean(axis=1) - (R @ P[..., :2].mean(axis=1)[..., None])[..., 0]
    np.testing.assert_allclose(solutions.p[:, 1:], t, atol=1e-10)


@pytest.mark.parametrize("n", [1, 2, 4])
def test_pan_tilt_is_the_least_distance_over_both_angles(n):
    task = make_task("pan_tilt")
    query, solutions, P, P_moved = noisy_fit("pan_tilt", n)
    truth = task.coordinates(query.truth, query.E_initial)
    for i, E_c in enumerate(query.E_initial):

        def distances(p, i=i, E_c=E_c):
            return (P[i] @ task.motion(p, E_c)[:3, :3].T - P_moved[i]).ravel()

        best = least_squares(distances, truth[i], xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(solutions.p[i], best.x, atol=1e-6)


def test_known_rotation_leaves_the_mean_of_what_it_does_not_explain():
    query, solutions, P, P_moved = noisy_fit("six_dof", 2, known_rotation=True)
    R = query.truth[:, :3, :3]
    np.testing.assert_allclose(solutions.E_to_from[:, :3, :3], R, atol=1e-12)
    t = (P_moved - P @ np.swapaxes(R, -1, -2)).mean(axis=1)
    np.testing.assert_allclose(solutions.p[:, 3:], t, atol=1e-10)


def test_targets_on_a_line_leave_a_rotation_free():
    cameras = thesis_rig("six_dof").cameras()
    P = np.linspace([-0.3, -0.2, 1.5], [0.4, 0.3, 2.5], 4)
    E = motion.from_rotation_translation(Rotation.from_rotvec([0.1, 0.05, 0.3]).as_matrix(), [0.1, 0.0, 0.1])
    codes = [stereo_code(cameras, Q)[0][None] for Q in (P, P @ E[:3, :3].T + E[:3, 3])]
    query = Query(*codes, np.eye(4)[None], E[None])
    for method in ("triangulate_arun", "bundle"):
        solution = reconstruct(method, make_task("six_dof"), cameras, query)[0]
        assert solution.reason is StopReason.RANK_DEFICIENT
        assert np.isnan(solution.E_to_from).all()


def test_covariance_tells_the_spread_of_the_answers():
    rng = np.random.default_rng(5)
    noise_px, N = 0.5, 2000
    one = random_query("planar", 1, 3, rng)
    initial, desired = (np.tile(c, (N, 1, 1)) for c in (one.initial, one.desired))
    initial = initial + noise_px * rng.standard_normal(initial.shape)
    desired = desired + noise_px * rng.standard_normal(desired.shape)
    poses = (np.tile(E, (N, 1, 1)) for E in (one.E_initial, one.E_desired))
    query = Query(initial, desired, *poses)
    cameras, task = StereoCameras(thesis_rig("planar").cameras().M), make_task("planar")
    given = reconstruct("triangulate_arun", task, cameras, query, noise=Noise(noise_px, np.inf))
    error = given.p - task.coordinates(query.truth, query.E_initial)
    d2 = np.einsum("qi,qij,qj->q", error, np.linalg.inv(given.covariance), error)
    # Mean of a χ² of 3 degrees of freedom; standard error √(6/2000) = 0.055, plus second order.
    assert d2.mean() == pytest.approx(3.0, rel=0.08)
    found = reconstruct("triangulate_arun", task, cameras, query)
    ratio = found.covariance[:, 0, 0] / given.covariance[:, 0, 0]
    # Six spare coordinates: the variance estimate has a relative standard error of √(2/6/2000) = 0.013.
    assert ratio.mean() == pytest.approx(1.0, abs=0.05)
