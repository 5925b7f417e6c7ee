import numpy as np
import pytest
from rival_scenes import TARGETS, random_query, thesis_rig
from scipy.optimize import least_squares

from vmf.estimate.noise import Noise
from vmf.geometry import stereo_code
from vmf.reconstruct import reconstruct, triangulate
from vmf.reconstruct.bundle import two_views
from vmf.solve import Query
from vmf.tasks import TASKS, make_task

# Half the digits: costs agree to rounding, minimisers to its square root.
HALF_DIGITS = 1e-6


def patchy_query(task, Q, seed, noise_px=2.0):
    """Return queries with one target not seen right at first, and one not seen left in the end."""
    query = random_query(task, Q, TARGETS[task] + 2, np.random.default_rng(seed), noise_px=noise_px)
    query.initial[:, -1, 2:] = np.nan
    query.desired[:, -2, :2] = np.nan
    return query


@pytest.mark.parametrize("task", TASKS)
def test_is_the_optimum_over_points_and_motion_together(task):
    space, cameras = make_task(task), thesis_rig(task).cameras()
    query = patchy_query(task, 3, seed=1)
    found = reconstruct("bundle", space, cameras, query)
    assert (found.status == "ok").all()
    m, n = space.n_motion, query.initial.shape[1]
    for i, E_c in enumerate(query.E_initial):
        seen = np.isfinite(np.concatenate([query.initial[i], query.desired[i]]))
        measured = np.concatenate([query.initial[i], query.desired[i]])[seen]

        def error(x, E_c=E_c, seen=seen, measured=measured):
            E, P = space.motion(x[:m], E_c), x[m:].reshape(n, 3)
            views = [stereo_code(cameras, Q)[0] for Q in (P, P @ E[:3, :3].T + E[:3, 3])]
            return np.concatenate(views)[seen] - measured

        first = triangulate(cameras, query.initial[i]).points
        later = triangulate(cameras, query.desired[i]).points
        back = (later - found.E_to_from[i, :3, 3]) @ found.E_to_from[i, :3, :3]
        start = np.concatenate([found.p[i], np.where(np.isfinite(first), first, back).ravel()])
        best = least_squares(error, start, "3-point", x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(found.p[i], best.x[:m], atol=HALF_DIGITS)
        assert found.residual_px[i] == pytest.approx(np.sqrt(np.mean(best.fun**2)), rel=1e-9)
        variance = 2.0 * best.cost / (len(measured) - m - 3 * n)
        covariance = np.linalg.inv(best.jac.T @ best.jac)[:m, :m] * variance
        np.testing.assert_allclose(found.covariance[i], covariance, rtol=1e-4, atol=1e-6 * covariance.max())


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("noise", [None, Noise(2.0, 3.0), Noise(2.0)])
def test_gradients_are_those_of_the_cost(task, noise):
    space = make_task(task)
    query = patchy_query(task, 4, seed=2)
    problem, _ = two_views(space, thesis_rig(task).cameras(), query)
    everything = np.arange(len(query))
    x = space.coordinates(query.truth, query.E_initial) + 0.01
    q = problem.starts(x, everything)
    here = problem.equations(x, q, everything, noise)

    def slope(dx, dq):
        up, down = (problem.equations(x + s * dx, q + s * dq, everything, noise).cost for s in (1e-5, -1e-5))
        return (up - down) / 2e-5

    # Second-order differences of a cost of about 1e2 with curvature of about 1e6.
    for i, axis in enumerate(np.eye(space.n_motion)):
        np.testing.assert_allclose(here.g_x[:, i], slope(axis, 0.0), rtol=1e-4, atol=1e-2)
    for i, axis in enumerate(np.eye(3 * q.shape[1]).reshape(-1, *q.shape[1:])):
        gradient = here.g_q.reshape(len(q), -1)[:, i]
        np.testing.assert_allclose(gradient, slope(0.0, axis), rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("task", TASKS)
def test_no_other_rival_has_a_lower_cost(task):
    space, cameras = make_task(task), thesis_rig(task).cameras()
    query = patchy_query(task, 40, seed=3)
    problem, _ = two_views(space, cameras, query)
    best = reconstruct("bundle", space, cameras, query)
    assert (best.status == "ok").all()
    bundle_cost = np.square(best.residual_px) * problem.n_equations
    for method in ("pnp", "triangulate_arun"):
        rival = reconstruct(method, space, cameras, query)
        good = np.nonzero(rival.status == "ok")[0]
        x = rival.p[good]
        cost = 2.0 * problem.equations(x, problem.starts(x, good), good).cost
        assert not (bundle_cost[good] > cost * (1.0 + 1e-9)).any()


def test_covariance_accounts_for_the_errors():
    task, noise_px = make_task("translation"), 3.0
    query = random_query("translation", 1000, 2, np.random.default_rng(4), noise_px=noise_px)
    found = reconstruct(
        "bundle", task, thesis_rig("translation").cameras(), query, noise=Noise(noise_px, np.inf)
    )
    error = found.p - query.truth[:, :3, 3]
    d2 = np.einsum("qi,qij,qj->q", error, np.linalg.inv(found.covariance), error)
    # A χ² of 3 degrees of freedom; the standard error of its mean is 2.6 %, the rest is second order.
    assert d2.mean() == pytest.approx(3.0, rel=0.15)


def test_noise_is_estimated_from_what_the_unknowns_leave():
    task, noise_px = make_task("planar"), 1.0
    query = random_query("planar", 300, 4, np.random.default_rng(5), noise_px=noise_px)
    cameras = thesis_rig("planar").cameras()
    given = reconstruct("bundle", task, cameras, query, noise=Noise(noise_px, np.inf)).covariance[:, 0, 0]
    found = reconstruct("bundle", task, cameras, query).covariance[:, 0, 0]
    # 32 equations − 15 unknowns: a relative standard error of √(2/17/300) = 2 %.
    assert np.mean(found / given) == pytest.approx(1.0, abs=0.08)


def test_without_spare_equations_the_noise_is_not_known():
    query = random_query("pan_tilt", 3, 1, np.random.default_rng(6), noise_px=0.5)
    one_eyed = query.desired.copy()
    one_eyed[..., 2:] = np.nan
    query = Query(query.initial, one_eyed, query.E_initial, query.E_desired)
    # 6 coordinates for 3 + 2 unknowns leave one; with known noise a covariance needs none.
    cameras, task = thesis_rig("pan_tilt").cameras(), make_task("pan_tilt")
    assert np.isfinite(reconstruct("bundle", task, cameras, query).covariance).all()
    three = random_query("translation", 3, 1, np.random.default_rng(6), noise_px=0.5)
    three.desired[..., 2:] = np.nan
    refused = reconstruct("bundle", make_task("translation"), thesis_rig("translation").cameras(), three)
    assert (refused.status == "refused").all()
