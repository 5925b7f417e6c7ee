import cv2
import numpy as np
from rival_scenes import K, random_query, thesis_rig
from scipy.optimize import least_squares

from vmf.geometry import motion, stereo_code
from vmf.reconstruct import reconstruct, triangulate
from vmf.solve import Query
from vmf.tasks import make_task

RIG = thesis_rig("six_dof")
CAMERAS = RIG.cameras()
SIX_DOF = make_task("six_dof")


def test_left_camera_only_agrees_with_opencv():
    query = random_query("six_dof", 10, 8, np.random.default_rng(1), noise_px=0.5)
    desired = query.desired.copy()
    desired[..., 2:] = np.nan
    query = Query(query.initial, desired, query.E_initial, query.E_desired)
    found = reconstruct("pnp", SIX_DOF, CAMERAS, query)
    assert (found.status == "ok").all()
    points = triangulate(CAMERAS, query.initial).points
    fine = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-14)
    for i in range(len(query)):
        pixels = np.ascontiguousarray(desired[i, :, :2])
        # From the true pose: OpenCV's own start can end in another minimum.
        r = cv2.Rodrigues(query.truth[i, :3, :3])[0]
        t = (query.truth[i, :3, 3] - RIG.p_left_in_S)[:, None]
        _, r, t = cv2.solvePnP(points[i], pixels, K, None, r, t, True, cv2.SOLVEPNP_ITERATIVE)
        r, t = cv2.solvePnPRefineLM(points[i], pixels, K, None, r, t, fine)
        # OpenCV's pose is the left camera's, at p_left in S.
        E = motion.from_rotation_translation(cv2.Rodrigues(r)[0], t[:, 0] + RIG.p_left_in_S)
        np.testing.assert_allclose(found.E_to_from[i], E, atol=1e-5)


def test_both_cameras_minimise_the_reprojection_error_of_the_triangulated_points():
    query = random_query("six_dof", 5, 6, np.random.default_rng(2), noise_px=1.0)
    query.desired[:, 4, 2:] = np.nan
    query.desired[:, 5, :2] = np.nan
    found = reconstruct("pnp", SIX_DOF, CAMERAS, query)
    points = triangulate(CAMERAS, query.initial).points
    for i in range(len(query)):
        seen = np.isfinite(query.desired[i])

        def error(p, i=i, seen=seen):
            E = SIX_DOF.motion(p, np.eye(4))
            return (stereo_code(CAMERAS, points[i] @ E[:3, :3].T + E[:3, 3])[0] - query.desired[i])[seen]

        best = least_squares(error, found.p[i], x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(found.p[i], best.x, atol=1e-6)
        np.testing.assert_allclose(found.residual_px[i], np.sqrt(np.mean(best.fun**2)), rtol=1e-9)


def test_the_desired_view_can_carry_the_points():
    query = random_query("six_dof", 5, 6, np.random.default_rng(3))
    query.initial[..., 2:] = np.nan
    for method in ("pnp", "bundle"):
        found = reconstruct(method, SIX_DOF, CAMERAS, query)
        assert (found.status == "ok").all()
        np.testing.assert_allclose(found.E_to_from, query.truth, atol=1e-7)
