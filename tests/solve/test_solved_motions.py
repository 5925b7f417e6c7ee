"""Solved motions against independent values, statistics, and what they are used for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vmf.geometry import from_rotation_translation, inverse, rotation_angle, stereo_code
from vmf.solve import Query, SolverOptions, StopReason, ask, command, solve
from vmf.tasks import make_task

EPS = np.finfo(float).eps
# MINPACK's default tolerance on the relative gain, √ε: the reference's optimiser stopped no later.
MINPACK_TOLERANCE = 1.5e-8


@pytest.mark.parametrize("name", ["translation", "planar", "six_dof", "pan_tilt"])
@pytest.mark.parametrize(("cost", "key"), [("algebraic", "algebraic_unit_depth"), ("geometric", "geometric")])
def test_reference_motions(reference, name, cost, key):
    """From pose 0 to 7 with the left camera's analytic parameters and noisy pixels in both views."""
    task = make_task(name, "thesis")
    data = reference["tasks"][name]
    E_c = np.array(data["E"])[:1]
    expected = np.array(data["solve_0_to_7_left_analytic_parameters"][key])
    rows = np.array([target["unit_depth_at_0"] for target in data["targets"]])
    rows = rows.reshape(1, len(rows), 1, 3, -1).repeat(2, axis=2)
    u = np.array([target["left_noisy"] for target in data["targets"]])
    errors = np.full((1, len(u), 2, 2), np.nan)
    errors[0, :, 0] = u[:, 7] - u[:, 0]
    solution = solve(task, rows, errors, E_c, SolverOptions(cost=cost, cameras="left"))[0]
    assert solution.converged

    def residuals(p):
        x_bar = task.lift(task.motion(p, E_c[0]))
        abc = rows[0, :, 0] @ x_bar
        if cost == "algebraic":
            return (abc[:, :2] - errors[0, :, 0] * abc[:, 2:]).ravel()
        return (abc[:, :2] / abc[:, 2:] - errors[0, :, 0]).ravel()

    ours, theirs = residuals(solution.p), residuals(expected)
    # 12 digits of rows and pixels move residuals by about 1e-9; the rest is the end of their optimiser.
    assert ours @ ours <= theirs @ theirs + 2e-9 * np.linalg.norm(theirs)
    h = 1e-6
    J = np.column_stack(
        [
            (residuals(solution.p + h * d) - residuals(solution.p - h * d)) / (2 * h)
            for d in np.eye(task.n_motion)
        ]
    )
    left = np.sqrt(2 * MINPACK_TOLERANCE) * np.linalg.norm(ours) + 1e-9
    assert np.linalg.norm(J @ (solution.p - expected)) <= left
    np.testing.assert_allclose(
        solution.p, expected, rtol=0, atol=left / np.linalg.svd(J, compute_uv=False)[-1]
    )
    if name != "six_dof":
        # Well-conditioned problems end far inside that: in ten digits.
        np.testing.assert_allclose(solution.p, expected, rtol=0, atol=1e-8)


def scene(case, rng, Q=1, n=6, reach=0.3):
    E_c, P = case.centres(rng, Q), case.points(rng, Q, n)
    p = case.unknowns(rng, Q, reach=reach)
    E = case.task.motion(p, E_c)
    rows = case.task.parameters(case.cameras.M, P[:, :, None])
    errors = case.pixels(case.move(E, P)) - case.pixels(P)
    return E_c, p, E, rows, errors


@pytest.mark.parametrize("name", ["translation", "six_dof", "planar", "pan_tilt"])
@pytest.mark.parametrize("cost", ["geometric", "algebraic"])
def test_covariance_is_what_repeating_the_experiment_gives(cases, rng, name, cost):
    """1000 repeats: a variance scatters by √(2/1000) = 4.5 %, so 15 % is 3.3 standard deviations."""
    case = cases[name]
    noise, repeats = 0.2, 1000
    E_c, p, _, rows, errors = scene(case, rng)
    many = np.repeat(errors, repeats, axis=0) + noise * rng.normal(size=(repeats, *errors.shape[1:]))
    solutions = solve(
        case.task,
        np.repeat(rows, repeats, axis=0),
        many,
        np.repeat(E_c, repeats, axis=0),
        SolverOptions(cost=cost, start="zero", noise_px=noise),
    )
    assert (solutions.status == "ok").all()
    claimed = solutions.covariance.mean(axis=0)
    spread = solutions.p - p
    # Whitened by the claim, the sample must have unit covariance; off the diagonal it scatters by 3.2 %.
    white = np.linalg.solve(np.linalg.cholesky(claimed), spread.T)
    np.testing.assert_allclose(white @ white.T / repeats, np.eye(len(p[0])), rtol=0, atol=0.15)


def test_covariance_without_a_given_noise_estimates_it(cases, rng):
    case = cases["translation"]
    E_c, _, _, rows, errors = scene(case, rng, Q=400)
    noisy = errors + 0.7 * rng.normal(size=errors.shape)
    given = solve(case.task, rows, noisy, E_c, SolverOptions(noise_px=0.7)).covariance
    own = solve(case.task, rows, noisy, E_c, SolverOptions()).covariance
    ratio = own[:, 0, 0] / given[:, 0, 0]
    # χ² of 24 − 3 degrees of freedom: mean 1, standard deviation √(2/21) = 0.31, over 400 queries 0.015.
    assert abs(ratio.mean() - 1.0) < 4 * 0.31 / np.sqrt(400)


def test_no_spare_equation_no_covariance_unless_noise_is_given(cases, rng):
    case = cases["pan_tilt"]
    E_c, _, _, rows, errors = scene(case, rng, n=1)
    left = solve(case.task, rows, errors, E_c, SolverOptions(cameras="left"))
    assert left.status[0] == "ok"
    assert np.isnan(left.covariance).all()
    given = solve(case.task, rows, errors, E_c, SolverOptions(cameras="left", noise_px=1.0))
    assert np.isfinite(given.covariance).all()


@pytest.mark.parametrize("name", ["six_dof", "planar", "translation"])
def test_with_a_known_rotation_one_target_gives_the_position(cases, rng, name):
    case = cases[name]
    E_c, p, E, rows, errors = scene(case, rng, Q=5, n=1)
    solutions = solve(case.task, rows, errors, E_c, SolverOptions(known_rotation=True), E[:, :3, :3])
    assert (solutions.status == "ok").all()
    np.testing.assert_allclose(solutions.p, p, rtol=0, atol=1e-9)
    # What was given has no variance.
    angles = [i for i, (_, unit) in enumerate(case.task.components) if unit == "rad"]
    np.testing.assert_array_equal(solutions.covariance[:, angles], 0.0)


def test_a_known_rotation_must_be_given(cases, rng):
    case = cases["six_dof"]
    E_c, _, _, rows, errors = scene(case, rng)
    with pytest.raises(ValueError, match="rotation"):
        solve(case.task, rows, errors, E_c, SolverOptions(known_rotation=True))


def test_a_known_rotation_leaves_a_pan_tilt_unit_nothing_to_solve_for(cases, rng):
    case = cases["pan_tilt"]
    E_c, _, E, rows, errors = scene(case, rng)
    with pytest.raises(ValueError, match="nothing"):
        solve(case.task, rows, errors, E_c, SolverOptions(known_rotation=True), E[:, :3, :3])


def test_six_dof_needs_the_rotation_when_there_is_one_target(cases, rng):
    case = cases["six_dof"]
    E_c, _, _, rows, errors = scene(case, rng, n=1)
    assert solve(case.task, rows, errors, E_c).status[0] == "refused"


class Views:
    """Queries in front of the rig, and the visuomotor function that an all-knowing learner would have."""

    def __init__(self, case, rng, Q=6, n=5):
        self.case = case
        self.E_c, self.p, self.E, _, _ = scene(case, rng, Q=Q)
        self.P = case.points(rng, Q, n)
        self.initial = stereo_code(case.cameras, self.P)[0]
        self.desired = stereo_code(case.cameras, case.move(self.E, self.P))[0]

    def query(self, initial=None, desired=None):
        return Query(
            self.initial if initial is None else initial,
            self.desired if desired is None else desired,
            self.E_c,
            self.E @ self.E_c,
        )

    def theta(self, codes):
        """Triangulate each code (four linear equations in three unknowns), then write down §2's rows."""
        M = self.case.cameras.M
        assert np.isfinite(codes).all()
        u = codes.reshape(-1, 2, 2)
        A = u[..., None] * M[:, None, 2] - M[:, :2]
        A = A.reshape(len(codes), 4, 4)
        P = (np.linalg.pinv(A[..., :3]) @ -A[..., 3:])[..., 0]
        return self.case.task.parameters(M, P[:, None])


def test_queries_know_their_truth(case, rng):
    views = Views(case, rng)
    query = views.query()
    assert len(query) == 6
    np.testing.assert_allclose(query.truth, views.E, rtol=0, atol=64 * EPS)
    np.testing.assert_allclose(query.reversed().truth, inverse(views.E), rtol=0, atol=64 * EPS)
    np.testing.assert_array_equal(query.select(np.array([1, 3])).initial, views.initial[[1, 3]])


def test_asking_forwards(case, rng):
    views = Views(case, rng)
    solutions = ask(case.task, views.theta, views.query(), SolverOptions())
    assert (solutions.status == "ok").all()
    np.testing.assert_allclose(solutions.E_to_from, views.E, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["translation", "planar", "six_dof"])
def test_without_stereo_at_the_start_the_desired_view_answers_and_is_inverted(cases, rng, name):
    case = cases[name]
    views = Views(case, rng)
    initial = views.initial.copy()
    initial[:3, :, 2:] = np.nan
    query = views.query(initial=initial)
    solutions = ask(case.task, views.theta, query, SolverOptions(noise_px=0.5))
    assert (solutions.status == "ok").all()
    np.testing.assert_allclose(solutions.E_to_from, views.E, rtol=0, atol=1e-9)
    np.testing.assert_allclose(solutions.p, views.p, rtol=0, atol=1e-9)
    # Covariances carry over: the same view asked forwards has the information of left errors only.
    assert np.isfinite(solutions.covariance).all()
    assert (np.linalg.eigvalsh(solutions.covariance) > 0).all()


def test_covariance_of_an_inverted_motion_is_what_repeating_gives(cases, rng):
    case = cases["planar"]
    views = Views(case, rng, Q=1)
    repeats, noise = 1000, 0.1
    initial = np.repeat(views.initial, repeats, axis=0)
    initial[:, :, :2] += noise * rng.normal(size=initial[:, :, :2].shape)
    initial[:, :, 2:] = np.nan
    query = Query(
        initial,
        np.repeat(views.desired, repeats, axis=0),
        np.repeat(views.E_c, repeats, axis=0),
        np.repeat(views.E @ views.E_c, repeats, axis=0),
    )
    solutions = ask(case.task, views.theta, query, SolverOptions(noise_px=noise, start="zero"))
    white = np.linalg.solve(np.linalg.cholesky(solutions.covariance.mean(axis=0)), (solutions.p - views.p).T)
    np.testing.assert_allclose(white @ white.T / repeats, np.eye(3), rtol=0, atol=0.15)


def test_without_stereo_in_either_view_there_are_no_equations(cases, rng):
    case = cases["six_dof"]
    views = Views(case, rng)
    initial, desired = views.initial.copy(), views.desired.copy()
    initial[0, :, 2:] = np.nan
    desired[0, :, :2] = np.nan
    solutions = ask(case.task, views.theta, views.query(initial, desired), SolverOptions())
    assert solutions.status[0] == "refused"
    assert (solutions.status[1:] == "ok").all()


def test_nothing_seen_anywhere_is_refused_everywhere(case, rng):
    views = Views(case, rng)
    blind = np.full_like(views.initial, np.nan)
    solutions = ask(case.task, views.theta, views.query(blind, blind), SolverOptions())
    assert set(solutions.status) == {"refused"}


def test_codes_the_function_does_not_know(case, rng):
    views = Views(case, rng)
    solutions = ask(
        case.task, lambda codes: np.full_like(views.theta(codes), np.nan), views.query(), SolverOptions()
    )
    assert set(solutions.reason) == {StopReason.NO_PARAMETERS}


@pytest.mark.parametrize("mounting", ["eye_in_hand", "eye_to_hand"])
def test_the_command_brings_the_robot_to_the_goal(case, rng, mounting):
    """§1: E_i = inv(W_T_S) with cameras on the robot, E_i = B_T_tool with the target on the tool."""
    views = Views(case, rng)
    query = views.query()
    solutions = ask(case.task, views.theta, query, SolverOptions())
    T_now = query.E_initial if mounting == "eye_to_hand" else inverse(query.E_initial)
    T_goal = command(T_now, solutions.E_to_from, mounting)
    reached = T_goal if mounting == "eye_to_hand" else inverse(T_goal)
    np.testing.assert_allclose(reached, query.E_desired, rtol=0, atol=2e-9)


def turned(case, rng, Q, n=8):
    """Arbitrary rotations about the targets' own middle, which keep every target in view."""
    P = case.points(rng, Q, n)
    middle = np.array([0.0, 0.0, 2.0])
    R = Rotation.random(Q, rng=rng).as_matrix()
    E = from_rotation_translation(R, middle - R @ middle + rng.uniform(-0.2, 0.2, (Q, 3)))
    rows = case.task.parameters(case.cameras.M, P[:, :, None])
    return rows, case.pixels(case.move(E, P)) - case.pixels(P), np.broadcast_to(np.eye(4), (Q, 4, 4)), E


def success(case, rng, start, cameras, noise):
    rows, errors, E_c, E = turned(case, rng, 100)
    errors = errors + noise * rng.normal(size=errors.shape)
    solutions = solve(case.task, rows, errors, E_c, SolverOptions(start=start, cameras=cameras))
    ok = solutions.status == "ok"
    ok[ok] = rotation_angle(solutions.E_to_from[ok] @ inverse(E[ok])) < 0.1
    return ok.mean()


@pytest.mark.parametrize(
    ("cameras", "noise"),
    [
        ("both", 0.0),
        ("both", 1.0),
        ("left", 0.0),
        ("left", 1.0),
    ],
)
def test_the_second_start_saves_large_rotations(cases, cameras, noise):
    """§8: arbitrary rotations leave Levenberg–Marquardt from zero in local minima."""
    zero, multi = (
        success(cases["six_dof"], np.random.default_rng(5), start, cameras, noise)
        for start in ("zero", "multi")
    )
    assert zero < 1.0
    assert 1.0 - multi < (1.0 - zero) / 2


@pytest.mark.parametrize("cameras", ["both", "left"])
def test_the_linear_start_survives_noise(cases, cameras):
    """Eight targets give 16 equations an image for 12 unknowns: half a pixel must not turn it around."""
    assert success(cases["six_dof"], np.random.default_rng(5), "linear", cameras, 0.5) > 0.9
