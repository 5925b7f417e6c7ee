"""The thesis's formulas written out entry by entry, against the task spaces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import cos, sin

from vmf.data.poses import PanTiltJoints
from vmf.estimate import thesis_gauge
from vmf.geometry import inverse, project

EPS = np.finfo(float).eps
seeds = st.integers(0, 2**32 - 1)
angles = st.floats(-3.1, 3.1)


def visuomotor_camera(M, P):
    """The rows of N / z of Eq. 3.8, in the unit-depth gauge: N / z²."""
    u, depth = project(M, P)
    m1, m2, m3 = M
    return np.stack([m1 - u[0] * m3, m2 - u[1] * m3, m3]) / depth


def six_dof_row(n, P):
    X, Y, Z = P
    return [
        n[0] * X, n[1] * X, n[2] * X,
        n[0] * Y, n[1] * Y, n[2] * Y,
        n[0] * Z, n[1] * Z, n[2] * Z,
        n[0], n[1], n[2], n[3],
    ]  # fmt: skip


def translation_row(n, P):
    X, Y, Z = P
    return [n[0], n[1], n[2], n[0] * X + n[1] * Y + n[2] * Z + n[3]]


def planar_row(n, P):
    X, Y, Z = P
    return [n[0] * X + n[1] * Y, n[0] * Y - n[1] * X, n[0], n[1], n[2] * Z + n[3]]


def pan_tilt_row(n, P):
    return [*six_dof_row(n, P)[:9], n[3]]


def pan_tilt_thesis_row(n, P):
    row = pan_tilt_row(n, P)
    del row[7]
    return row


ROWS = {
    "six_dof": six_dof_row,
    "translation": translation_row,
    "planar": planar_row,
    "pan_tilt": pan_tilt_row,
    "pan_tilt_thesis": pan_tilt_thesis_row,
}


@given(seeds)
def test_literal_rows(case, seed):
    P = case.points(np.random.default_rng(seed))
    for M in case.cameras.M:
        n = visuomotor_camera(M, P)
        expected = np.array([ROWS[case.id](row, P) for row in n])
        size = np.abs(M).max() * (1 + np.abs(P).max()) * 4
        np.testing.assert_allclose(case.task.parameters(M, P), expected, rtol=0, atol=64 * EPS * size)


@given(seeds)
def test_thesis_numbering_of_six_dof(cases, seed):
    """Eq. 3.15 and 3.18: θ1 = o11 X … θ13 = o14, θ14 = o21 X …, θ38 = o33, and o34 = 1 is not a parameter."""
    case = cases["six_dof"]
    P = case.points(np.random.default_rng(seed))
    M = case.cameras.left
    theta = thesis_gauge(case.task.parameters(M, P)).ravel()
    N = visuomotor_camera(M, P)
    o = N / N[2, 3]
    expected = {
        1: o[0, 0] * P[0], 2: o[0, 1] * P[0], 4: o[0, 0] * P[1], 9: o[0, 2] * P[2], 10: o[0, 0], 13: o[0, 3],
        14: o[1, 0] * P[0], 22: o[1, 2] * P[2], 26: o[1, 3], 27: o[2, 0] * P[0], 35: o[2, 2] * P[2],
        36: o[2, 0], 38: o[2, 2], 39: 1.0,
    }  # fmt: skip
    size = np.abs(o).max() * 3
    for number, value in expected.items():
        assert theta[number - 1] == pytest.approx(value, abs=64 * EPS * size)


@given(angles, angles)
def test_pan_tilt_lift_is_equation_3_43(cases, alpha, beta):
    x_bar = cases["pan_tilt_thesis"].task.lift(
        cases["pan_tilt_thesis"].task.motion(np.array([alpha, beta]), np.eye(4))
    )
    expected = [
        cos(alpha) * cos(beta), sin(alpha), -sin(beta) * cos(alpha),
        -cos(beta) * sin(alpha), cos(alpha), sin(beta) * sin(alpha),
        sin(beta), cos(beta), 1.0,
    ]  # fmt: skip
    np.testing.assert_allclose(x_bar, expected, rtol=0, atol=16 * EPS)


@given(angles, st.floats(-5, 5), st.floats(-5, 5))
def test_planar_lift_is_equation_3_45_with_the_sign_of_c5(cases, alpha, tx, ty):
    task = cases["planar"].task
    x_bar = task.lift(task.motion(np.array([alpha, tx, ty]), np.eye(4)))
    np.testing.assert_allclose(x_bar, [cos(alpha), -sin(alpha), tx, ty, 1.0], rtol=0, atol=4 * EPS)


@given(angles, angles, angles, seeds)
def test_appendix_a1(cases, a, b, f, seed):
    """f_x and its printed Jacobian entries for a random row v of V."""
    rng = np.random.default_rng(seed)
    v = np.array([np.nan, *rng.normal(size=13)])
    t = rng.normal(size=3)
    p = np.array([a, b, f, *t])
    task = cases["six_dof"].task
    E_c = np.eye(4)
    value = (
        v[1] * cos(a) * cos(b) + v[2] * sin(a) * cos(b) - v[3] * sin(b)
        + v[4] * (-sin(a) * cos(f) + cos(a) * sin(b) * sin(f))
        + v[5] * (cos(a) * cos(f) + sin(a) * sin(b) * sin(f))
        + v[6] * cos(b) * sin(f)
        + v[7] * (sin(a) * sin(f) + cos(a) * sin(b) * cos(f))
        + v[8] * (-cos(a) * sin(f) + sin(a) * sin(b) * cos(f))
        + v[9] * cos(b) * cos(f)
        + v[10] * t[0] + v[11] * t[1] + v[12] * t[2] + v[13]
    )  # fmt: skip
    d_alpha = (
        -v[1] * sin(a) * cos(b) + v[2] * cos(a) * cos(b)
        + v[4] * (-cos(a) * cos(f) - sin(a) * sin(b) * sin(f))
        + v[5] * (-sin(a) * cos(f) + cos(a) * sin(b) * sin(f))
        + v[7] * (cos(a) * sin(f) - sin(a) * sin(b) * cos(f))
        + v[8] * (sin(a) * sin(f) + cos(a) * sin(b) * cos(f))
    )  # fmt: skip
    d_beta = (
        -v[1] * cos(a) * sin(b) - v[2] * sin(a) * sin(b)
        - v[3] * cos(b) + v[4] * cos(a) * cos(b) * sin(f)
        + v[5] * sin(a) * cos(b) * sin(f) - v[6] * sin(b) * sin(f)
        + v[7] * cos(a) * cos(b) * cos(f) + v[8] * sin(a) * cos(b) * cos(f)
        - v[9] * sin(b) * cos(f)
    )  # fmt: skip
    d_phi = (
        v[4] * (sin(a) * sin(f) + cos(a) * sin(b) * cos(f))
        + v[5] * (-cos(a) * sin(f) + sin(a) * sin(b) * cos(f))
        + v[6] * cos(b) * cos(f) + v[7] * (sin(a) * cos(f) - cos(a) * sin(b) * sin(f))
        + v[8] * (-cos(a) * cos(f) - sin(a) * sin(b) * sin(f)) - v[9] * cos(b) * sin(f)
    )  # fmt: skip
    rounding = 64 * EPS * np.abs(v[1:]).sum() * (1 + np.abs(t).max())
    assert v[1:] @ task.lift(task.motion(p, E_c)) == pytest.approx(value, abs=rounding)
    printed = [d_alpha, d_beta, d_phi, v[10], v[11], v[12]]
    np.testing.assert_allclose(v[1:] @ task.lift_jacobian(p, E_c), printed, rtol=0, atol=rounding)


@given(seeds)
def test_c3_pan_tilt_motions_leave_the_eight_entry_lift(cases, seed):
    """Between configurations r23 = −sin(α_i − α_c) sin β_c, which eight entries lose and nine keep."""
    rng = np.random.default_rng(seed)
    alpha, beta = rng.uniform(-0.8, 0.8, (2, 2))
    E_i, E_c = PanTiltJoints(alpha, beta).motions("eye_in_hand")
    E = E_i @ inverse(E_c)
    r23 = -sin(alpha[0] - alpha[1]) * sin(beta[1])
    assert E[1, 2] == pytest.approx(r23, abs=16 * EPS)
    assert cases["pan_tilt_thesis"].task.departure(E) == pytest.approx(abs(r23), abs=16 * EPS)
    assert cases["pan_tilt"].task.departure(E) == 0.0
    p = cases["pan_tilt"].task.coordinates(E, E_c)
    np.testing.assert_allclose(p, [alpha[0] - alpha[1], beta[0] - beta[1]], rtol=0, atol=32 * EPS)


@given(angles, angles)
def test_joints_and_the_task_mean_the_same_angles(cases, pan, tilt):
    E = PanTiltJoints(np.array([pan]), np.array([tilt])).motions("eye_in_hand")[0]
    expected = cases["pan_tilt"].task.motion(np.array([pan, tilt]), np.eye(4))
    np.testing.assert_allclose(E, expected, rtol=0, atol=16 * EPS)


@pytest.mark.parametrize("name", ["translation", "planar", "six_dof", "pan_tilt_thesis"])
def test_reference_parameters(cases, reference, name):
    """Both gauges of every target at pose 0, and the pixels they come from, to the 12 digits printed."""
    task = cases[name].task
    data = reference["tasks"][name.removesuffix("_thesis")]
    E = np.array(data["E"])
    for target in data["targets"]:
        P = np.array(target["P"])
        seen = E[:, :3, :3] @ P + E[:, :3, 3]
        for camera in ("left", "right"):
            M = np.array(data[f"M_{camera}"])
            # E has 12 decimals, 0.5e-12 per entry: times |P| ~ 4 and a focal length of 469 px, over a depth
            # of at least half a metre, three times (a numerator, a denominator of up to 700 px, a sum).
            np.testing.assert_allclose(project(M, seen)[0], target[camera], rtol=1e-11, atol=3e-8)
        rows = task.parameters(np.array(data["M_left"]), P)
        np.testing.assert_allclose(rows.ravel(), target["unit_depth_at_0"], rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(
            thesis_gauge(rows).ravel(), target["thesis_gauge_at_0"], rtol=1e-11, atol=1e-11
        )
