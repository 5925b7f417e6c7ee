"""Laws that every task space keeps (§2, §4)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.estimate import thesis_gauge, unit_depth_gauge
from vmf.estimate.gauge import depth_ratio_at_rest
from vmf.geometry import inverse, project, rotation_angle
from vmf.tasks import TASKS, Task, make_task

EPS = np.finfo(float).eps
# Entries of motions here stay below 1 (rotations) or 3 (m); each goes through a few dozen operations.
ENTRY = 64 * EPS
# Pixels stay below 2000 and depth ratios within 4 of one.
PIXEL = 64 * EPS * 2000 * 4

seeds = st.integers(0, 2**32 - 1)


def predicted(rows, x_bar):
    """a·x̄ / c·x̄ and b·x̄ / c·x̄ of rows (…, 3, k+1)."""
    abc = (rows @ x_bar[..., None])[..., 0]
    return abc[..., :2] / abc[..., 2:], abc[..., 2]


@given(seeds)
def test_prediction_with_analytic_parameters_is_projection(case, seed):
    rng = np.random.default_rng(seed)
    E_c, p, P_c = case.centres(rng), case.unknowns(rng), case.points(rng)
    E = case.task.motion(p, E_c)
    P = E[:3, :3] @ P_c + E[:3, 3]
    for M in case.cameras.M:
        before, depth_before = project(M, P_c)
        after, depth_after = project(M, P)
        e, ratio = predicted(case.task.parameters(M, P_c), case.task.lift(E))
        np.testing.assert_allclose(e, after - before, rtol=0, atol=PIXEL)
        assert ratio == pytest.approx(depth_after / depth_before, rel=64 * EPS * 4)


def test_both_cameras_and_many_points_at_once(case, rng):
    P = case.points(rng, 4, 5)
    rows = case.task.parameters(case.cameras.M, P[..., None, :])
    assert rows.shape == (4, 5, 2, 3, case.task.n_lift + 1)
    for i in np.ndindex(4, 5, 2):
        one = case.task.parameters(case.cameras.M[i[2]], P[i[:2]])
        np.testing.assert_allclose(rows[i], one, rtol=0, atol=PIXEL)


@given(seeds)
def test_motions_between_poses_belong_to_the_task(case, seed):
    rng = np.random.default_rng(seed)
    E_i, E_c = case.poses(rng), case.centres(rng)
    E = E_i @ inverse(E_c)
    p = case.task.coordinates(E, E_c)
    np.testing.assert_allclose(case.task.motion(p, E_c), E, rtol=0, atol=ENTRY)


@given(seeds)
def test_the_lift_is_closed_under_right_multiplication(case, seed):
    rng = np.random.default_rng(seed)
    task = case.task
    E_i, E_c = case.poses(rng, 7), case.centres(rng)
    L = task.closure(E_c)
    assert L.shape == (task.n_lift + 1,) * 2
    np.testing.assert_allclose(task.lift(E_i) @ L.T, task.lift(E_i @ inverse(E_c)), rtol=0, atol=2 * ENTRY)


@given(seeds)
def test_closure_is_a_representation(case, seed):
    rng = np.random.default_rng(seed)
    E, F = case.centres(rng), case.centres(rng)
    L = case.task.closure
    # L(E) L(F) x̄(G) = x̄(G F⁻¹ E⁻¹) = L(E F) x̄(G); the 8-entry lift loses r23 only for tilted centres.
    np.testing.assert_allclose(L(E) @ L(F), L(E @ F), rtol=0, atol=8 * ENTRY)
    np.testing.assert_allclose(L(np.eye(4)), np.eye(case.task.n_lift + 1), rtol=0, atol=0)
    np.testing.assert_allclose(L(np.stack([E, F]))[1], L(F), rtol=0, atol=ENTRY)


@given(seeds)
def test_lift_and_unlift_are_inverse_within_the_task(case, seed):
    rng = np.random.default_rng(seed)
    E_c = case.centres(rng)
    if case.thesis_lift:
        E_c = np.eye(4)
    E = case.task.motion(case.unknowns(rng, 3), E_c)
    np.testing.assert_allclose(case.task.unlift(case.task.lift(E)), E, rtol=0, atol=ENTRY)
    assert (case.task.departure(E) <= ENTRY).all()


def test_departure_tells_foreign_motions(cases, rng):
    E = cases["six_dof"].poses(rng)
    lost = {
        "translation": np.abs(E[:3, :3] - np.eye(3)).max(),
        "pan_tilt": np.abs(E[:3, 3]).max(),
        "pan_tilt_thesis": max(np.abs(E[:3, 3]).max(), abs(E[1, 2])),
        "six_dof": 0.0,
    }
    for name, amount in lost.items():
        assert cases[name].task.departure(E) == pytest.approx(amount, abs=ENTRY)
    upright = np.array([[E[0, 0], E[0, 1]], [-E[0, 1], E[0, 0]]])
    planar = max(
        np.abs(E[:2, :2] - upright).max(),
        np.abs(E[2, :3] - [0, 0, 1]).max(),
        np.abs(E[:2, 2]).max(),
        abs(E[2, 3]),
    )
    assert cases["planar"].task.departure(E) == pytest.approx(planar, abs=ENTRY)


@given(seeds)
def test_transported_parameters_are_analytic_at_the_new_centre(case, seed):
    """§4: c_c = L_c^-T c, a_c = L_c^-T (a − x_c c), b_c = L_c^-T (b − y_c c)."""
    rng = np.random.default_rng(seed)
    P_0 = case.points(rng)
    E_c = case.centres(rng)
    P_c = E_c[:3, :3] @ P_0 + E_c[:3, 3]
    L = case.task.closure(E_c)
    for M in case.cameras.M:
        a, b, c = case.task.parameters(M, P_0)
        x, y = project(M, P_c)[0] - project(M, P_0)[0]
        transported = np.linalg.solve(L.T, np.stack([a - x * c, b - y * c, c]).T).T
        expected = case.task.parameters(M, P_c)
        # The transported parameters come out in the gauge of centre 0: their depth ratio there is not 1.
        found = unit_depth_gauge(transported, case.task.identity_lift)
        size = np.linalg.cond(L) * np.abs(expected).max()
        np.testing.assert_allclose(found, expected, rtol=0, atol=64 * EPS * size)


@given(seeds)
def test_motion_and_coordinates_are_inverse(case, seed):
    rng = np.random.default_rng(seed)
    E_c = case.centres(rng, 5)
    # Away from the singular pitch of six_dof's Euler angles, at 1.4 rad at most: 1/cos 1.4 = 6.
    p = case.unknowns(rng, 5, reach=1.4)
    E = case.task.motion(p, E_c)
    np.testing.assert_allclose(case.task.coordinates(E, E_c), p, rtol=0, atol=6 * ENTRY)
    assert E.shape == (5, 4, 4)


@pytest.mark.parametrize("name", ["planar", "pan_tilt", "pan_tilt_thesis", "six_dof"])
def test_headings_reach_all_the_way_round(cases, name, rng):
    case = cases[name]
    p = case.unknowns(rng, 40)
    p[:, 0] = np.linspace(-3.1, 3.1, 40)
    E_c = case.centres(rng, 40)
    found = case.task.coordinates(case.task.motion(p, E_c), E_c)
    np.testing.assert_allclose(found, p, rtol=0, atol=6 * ENTRY)


def test_tilt_wraps_into_half_turns(cases):
    case = cases["pan_tilt"]
    E_c = case.task.motion(np.array([0.2, 3.0]), np.eye(4))
    p = np.array([0.1, 0.5])
    found = case.task.coordinates(case.task.motion(p, E_c), E_c)
    np.testing.assert_allclose(found, p, rtol=0, atol=6 * ENTRY)


@given(seeds)
def test_no_motion_is_the_identity(case, seed):
    E_c = case.centres(np.random.default_rng(seed))
    E = case.task.motion(np.zeros(case.task.n_motion), E_c)
    np.testing.assert_allclose(E, np.eye(4), rtol=0, atol=ENTRY)
    np.testing.assert_array_equal(case.task.identity_lift, case.task.lift(np.eye(4)))


@given(seeds)
def test_jacobian_is_the_finite_difference(case, seed):
    rng = np.random.default_rng(seed)
    E_c, p = case.centres(rng, 3), case.unknowns(rng, 3, reach=2.0)
    # Truncation h²/6 · |x̄'''| with |x̄'''| ≤ 1, rounding ε|x̄|/h with |x̄| ≤ 2: both 4e-11 at h = 1e-5.
    h = 1e-5
    J = case.task.lift_jacobian(p, E_c)
    assert J.shape == (3, case.task.n_lift + 1, case.task.n_motion)
    for i, axis in enumerate(np.eye(case.task.n_motion)):
        ahead, behind = (case.task.lift(case.task.motion(p + s * axis, E_c)) for s in (h, -h))
        slope = (ahead - behind) / (2 * h)
        np.testing.assert_allclose(J[..., i], slope, rtol=0, atol=h**2 / 6 + 8 * ENTRY / h)


@given(seeds)
def test_projecting_a_motion_of_the_task_returns_it(case, seed):
    rng = np.random.default_rng(seed)
    E_c, p = case.centres(rng, 4), case.unknowns(rng, 4, reach=1.2)
    E = case.task.motion(p, E_c)
    np.testing.assert_allclose(case.task.project(E, E_c), p, rtol=0, atol=10 * ENTRY)


@given(seeds)
def test_projecting_anything_gives_a_motion_of_the_task(case, seed):
    rng = np.random.default_rng(seed)
    E_c, p = case.centres(rng, 4), case.unknowns(rng, 4)
    noisy = case.task.motion(p, E_c) + rng.normal(0, 0.05, (4, 4, 4))
    q = case.task.project(noisy, E_c)
    E = case.task.motion(q, E_c)
    R = E[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=ENTRY)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=ENTRY)
    # Noise of 0.05 an entry, ‖noise‖₂ < 0.25, moves a rotation by at most ‖noise‖₂ / (1 − ‖noise‖₂) < 0.3,
    # and a pair of angles read off it by no more than twice that.
    assert (np.linalg.norm((noisy - E)[:, :3, :3], axis=(1, 2)) < 1.2).all()
    assert (np.abs(q - p) < 0.6).all()


def test_projection_to_planar_and_six_dof_is_the_nearest(cases, rng):
    """No motion close by is nearer in the Frobenius norm."""
    for name in ("planar", "six_dof", "translation"):
        case = cases[name]
        A = case.task.motion(case.unknowns(rng), np.eye(4)) + rng.normal(0, 0.05, (4, 4))
        q = case.task.project(A, np.eye(4))
        distance = np.linalg.norm(case.task.motion(q, np.eye(4)) - A)
        around = q + rng.normal(0, 1e-3, (200, case.task.n_motion))
        others = np.linalg.norm(case.task.motion(around, np.eye(4)) - A, axis=(1, 2))
        assert (others > distance).all()


@given(seeds, st.floats(-100.0, 100.0).filter(lambda s: abs(s) > 0.01))
def test_gauges_there_and_back(case, seed, scale):
    rng = np.random.default_rng(seed)
    rows = case.task.parameters(case.cameras.left, case.points(rng, 3))
    rest = case.task.identity_lift
    np.testing.assert_allclose(depth_ratio_at_rest(rows, rest), 1.0, rtol=0, atol=64 * EPS * 4)
    thesis = thesis_gauge(scale * rows)
    np.testing.assert_array_equal(thesis[..., 2, -1], 1.0)
    size = np.abs(rows).max() * (1 + np.abs(thesis[..., 2, :]).max())
    np.testing.assert_allclose(unit_depth_gauge(thesis, rest), rows, rtol=0, atol=64 * EPS * size)


def test_no_gauge_where_its_entry_is_zero():
    rows = np.ones((2, 3, 4))
    rows[1, 2] = [1.0, 2.0, 3.0, 0.0]
    np.testing.assert_array_equal(np.isnan(thesis_gauge(rows)).all(axis=(1, 2)), [False, True])
    np.testing.assert_array_equal(
        np.isnan(unit_depth_gauge(rows, np.array([0.0, 0.0, 0.0, 1.0]))).all(axis=(1, 2)), [False, True]
    )


def quadratic(q):
    """All monomials of degree ≤ 2 of q (N, 3)."""
    one = np.ones((len(q), 1))
    full = np.concatenate([one, q], axis=1)
    i, j = np.triu_indices(4)
    return full[:, i] * full[:, j]


@pytest.mark.parametrize("camera", ["left", "right"])
def test_unit_depth_parameters_are_a_quadratic_of_the_code(case, camera, rng):
    P = case.points(rng, 60)
    M = getattr(case.cameras, camera)
    rows = case.task.parameters(M, P).reshape(60, -1)
    left, right = project(case.cameras.left, P)[0], project(case.cameras.right, P)[0]
    q = np.column_stack([left, left[:, 0] - right[:, 0]])
    q = (q - q.mean(axis=0)) / q.std(axis=0)
    A = quadratic(q)
    fitted = np.linalg.lstsq(A[:30], rows[:30], rcond=None)[0]
    # Held out: 30 codes fit ten coefficients, the others are predicted.
    missed = np.abs(A[30:] @ fitted - rows[30:]).max()
    size = np.abs(rows).max()
    assert missed <= 64 * EPS * np.linalg.cond(A[:30]) * np.abs(A).max() * size
    # The thesis gauge contains 1/disparity, which no quadratic is. For pan_tilt and six_dof, whose point
    # is carried by the rotation, its constant is n34, the same for every point up to the depth.
    thesis = thesis_gauge(rows.reshape(60, 3, -1)).reshape(60, -1)
    fitted = np.linalg.lstsq(A[:30], thesis[:30], rcond=None)[0]
    if case.id in ("pan_tilt", "pan_tilt_thesis", "six_dof"):
        assert np.abs(A[30:] @ fitted - thesis[30:]).max() > 1e-6 * np.abs(thesis).max()


@pytest.mark.parametrize(
    ("name", "lift", "k", "count"),
    [
        ("six_dof", "general", 12, 38),
        ("pan_tilt", "thesis", 8, 26),
        ("pan_tilt", "general", 9, 29),
        ("translation", "general", 3, 11),
        ("planar", "general", 4, 14),
    ],
)
def test_numbers_of_parameters_are_the_thesis(name, lift, k, count):
    task = make_task(name, lift)
    assert task.n_lift == k
    assert 3 * (task.n_lift + 1) - 1 == count


def test_every_task_keeps_the_protocol():
    assert set(TASKS) == {"pan_tilt", "translation", "planar", "six_dof"}
    for name, make in TASKS.items():
        task = make()
        assert isinstance(task, Task)
        assert task.name == name
        assert len(task.components) == task.n_motion
        assert {unit for _, unit in task.components} <= {"m", "rad"}
        # Reading the lift from the motion that a lift stands for returns it.
        product = np.einsum("aij,ijb->ab", task.selection, task.embedding)
        np.testing.assert_array_equal(product, np.eye(task.n_lift + 1))


def test_only_pan_tilt_has_another_lift_for_absolute_poses(cases, rng):
    for name in ("translation", "planar", "six_dof"):
        assert cases[name].task.world() is cases[name].task
        assert cases[name].task.closed
    case = cases["pan_tilt"]
    assert not case.task.closed
    x_bar = case.task.lift(case.poses(rng, 100))
    world = case.task.world().lift(case.poses(rng, 100))
    # Nine entries are rank-deficient over absolute poses, eight are not (C3).
    assert np.linalg.matrix_rank(x_bar) == x_bar.shape[1] - 1
    assert np.linalg.matrix_rank(world) == world.shape[1]


def test_rotation_components_are_what_their_names_say(cases):
    """α turns about z (pan, heading), β about y (tilt), φ about x."""
    for name, axes in (("six_dof", "zyx"), ("planar", "z"), ("pan_tilt", "zy")):
        task = cases[name].task
        for i, axis in enumerate(axes):
            p = np.zeros(task.n_motion)
            p[i] = 0.3
            E = task.motion(p, np.eye(4))
            unit = np.eye(3)["xyz".index(axis)]
            np.testing.assert_allclose(E[:3, :3] @ unit, unit, atol=ENTRY)
            assert rotation_angle(E) == pytest.approx(0.3)
            turn = np.cross(unit, np.roll(unit, 1)) @ E[:3, :3] @ np.roll(unit, 1)
            assert turn == pytest.approx(np.sin(0.3))


@given(seeds)
def test_parameters_over_poses_become_parameters_over_motions(case, seed):
    """C3: the ninth entry of pan_tilt follows from the rank-1 structure, and transport from all nine."""
    rng = np.random.default_rng(seed)
    P = case.points(rng, 4)
    E_c = case.centres(rng)
    L = case.task.closure(E_c)
    for M in case.cameras.M:
        rows = case.task.from_world(case.task.world().parameters(M, P))
        expected = case.task.parameters(M, P)
        # Each of nine rows n_r (X, Y, Z) is off by its own rounding and by that of the ratio Z / X, whose
        # smallest column (0.3 m of 2 m or less) counts the most.
        size = np.abs(expected).max() * np.linalg.norm(P, axis=-1).max() / np.abs(P).max(axis=-1).min()
        np.testing.assert_allclose(rows, expected, rtol=0, atol=64 * EPS * size * 4)
        there = case.move(E_c, P)
        e = project(M, there)[0] - project(M, P)[0]
        shifted = np.concatenate([rows[:, :2] - e[:, :, None] * rows[:, 2:], rows[:, 2:]], axis=1)
        found = unit_depth_gauge(shifted @ np.linalg.inv(L), case.task.identity_lift)
        at_c = case.task.parameters(M, there)
        np.testing.assert_allclose(found, at_c, rtol=0, atol=64 * EPS * np.linalg.cond(L) * size * 4)


def test_noise_in_parameters_over_poses_is_not_blown_up(cases, rng):
    """The completed entry is as good as its neighbours: no more than a few times their noise."""
    task = cases["pan_tilt"].task
    P = cases["pan_tilt"].points(rng, 200)
    M = cases["pan_tilt"].cameras.left
    rows = task.world().parameters(M, P)
    rows *= 1.0 + 1e-3 * rng.normal(size=rows.shape)
    missed = np.abs(task.from_world(rows) - task.parameters(M, P))[..., 7]
    scale = np.abs(task.parameters(M, P)).max(axis=-1)
    assert np.median(missed / scale) < 1e-2
