"""The equations of both cameras at once against one camera's augmented rows at a time (§3.3, §4)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.estimate import StereoEquations, augmented_rows, least_squares
from vmf.geometry import inverse

EPS = np.finfo(float).eps


def observations(rng, case, m, *batch):
    """Lifts (…, m, k+1) and pixels (…, m, 2, 2), in general position."""
    E = case.task.motion(case.unknowns(rng, *batch, m), np.eye(4))
    return E, rng.uniform(-100.0, 100.0, (*batch, m, 2, 2))


def plain_gram(x_bar, u):
    """Inner products (…, 2, 3k+3, 3k+3) of each camera's augmented rows, written out."""
    rows = augmented_rows(x_bar[..., None, :], u)
    rows = np.moveaxis(rows, -3, -4).reshape(*u.shape[:-3], 2, -1, rows.shape[-1])
    return np.swapaxes(rows, -1, -2) @ rows


def assert_gram(R, expected, m):
    """Each entry of a Gram matrix is a sum of products of two columns: rounding goes with their norms."""
    size = np.sqrt(np.einsum("...ii->...i", expected))
    atol = 40 * m * EPS * (size[..., :, None] * size[..., None, :] + np.finfo(float).tiny)
    assert (np.abs(np.swapaxes(R, -1, -2) @ R - expected) <= atol).all()


@pytest.mark.parametrize("m", [1, 5, 40, 200])
def test_factors_are_those_of_the_augmented_rows(case, rng, m):
    E, u = observations(rng, case, m, 3)
    x_bar = case.task.lift(E)
    R = StereoEquations.of(x_bar, u).triangular().factors()
    np.testing.assert_array_equal(R, np.triu(R))
    assert_gram(R, plain_gram(x_bar, u), m)


@given(sizes=st.lists(st.integers(0, 9), min_size=1, max_size=6), seed=st.integers(0, 2**32 - 1))
def test_portions_add_up(cases, sizes, seed):
    case, rng = cases["six_dof"], np.random.default_rng(seed)
    E, u = observations(rng, case, sum(sizes) + 1)
    x_bar = case.task.lift(E)
    so_far = StereoEquations.none(case.task.n_lift + 1)
    for begin, end in zip(np.cumsum([0, *sizes[:-1]]), np.cumsum(sizes), strict=True):
        so_far = so_far.with_others(StereoEquations.of(x_bar[begin:end], u[begin:end]))
    so_far = so_far.with_others(StereoEquations.of(x_bar[-1:], u[-1:]))
    assert_gram(so_far.factors(), plain_gram(x_bar, u), len(u))


def test_another_centre_sees_its_own_pairs(case, rng):
    """Closure: the equations over poses, moved to a centre, are those of the motions from it."""
    E, u = observations(rng, case, 60)
    c = case.centres(rng, 4)
    u_c = rng.uniform(-100.0, 100.0, (4, 2, 2))
    x_bar = case.task.lift(E @ inverse(c)[:, None])
    over_poses = StereoEquations.of(case.task.lift(E), u).triangular()
    four = StereoEquations(np.stack([over_poses.lifts] * 4), np.stack([over_poses.rest] * 4))
    moved = four.seen_from(case.task.closure(c), u_c).triangular()
    # Pixels up to 100 are the difference of such: ‖L‖ < 10 and the subtraction cost a digit or two.
    assert_gram(moved.factors(), plain_gram(x_bar, u - u_c[:, None]), 60 * 100)


def test_pooled_centres_are_all_their_rows_times_their_weights(cases, rng):
    case = cases["planar"]
    E, u = observations(rng, case, 9, 3)
    x_bar = case.task.lift(E)
    each = StereoEquations.of(x_bar, u).triangular()
    members, weight = np.array([[0, 2, 0], [1, 0, 0]]), np.array([[1.0, 2.0, 0.0], [0.5, 0.0, 0.0]])
    R = each.pooled(members, weight).factors()
    G = plain_gram(x_bar, u)
    assert_gram(R[0], G[0] + 4.0 * G[2], 18)
    assert_gram(R[1], 0.25 * G[1], 9)


def test_substitution_is_least_squares(case, rng):
    E, u = observations(rng, case, 80, 5)
    equations = StereoEquations.of(case.task.lift(E), u).triangular()
    rows, regular = equations.least_squares()
    expected = least_squares(equations.factors(), case.n_free)
    known = np.asarray(expected.rank == 3 * (case.task.n_lift + 1) - 1)
    np.testing.assert_array_equal(regular, known)
    # World poses of pan-tilt leave r23 = 0: nine of the ten lifts, and nothing to substitute.
    assert regular.all() == (case.id != "pan_tilt")
    gap = np.linalg.norm((rows - expected.rows)[regular], axis=(1, 2))
    size = np.linalg.norm(expected.rows[regular], axis=(1, 2))
    assert (gap <= 100 * EPS * expected.condition[regular] * size).all()


@pytest.mark.parametrize("m", [1, 3, 12, 18])
def test_too_few_observations_are_never_called_regular(cases, rng, m):
    """Six degrees of freedom: 38 unknowns and two equations an observation."""
    case = cases["six_dof"]
    E, u = observations(rng, case, m, 2)
    equations = StereoEquations.of(case.task.lift(E), u).triangular()
    rows, regular = equations.least_squares()
    assert rows.shape == (2, 2, 3, 13)
    assert not regular.any()


def test_one_camera_may_be_regular_and_the_other_not(cases, rng):
    """A right camera that always sees the same pixel says nothing about its motion."""
    case = cases["translation"]
    E, u = observations(rng, case, 40)
    u[:, 1] = 5.0
    equations = StereoEquations.of(case.task.lift(E), u).triangular()
    rows, regular = equations.least_squares()
    np.testing.assert_array_equal(regular, [True, False])
    np.testing.assert_allclose(rows[0], least_squares(equations.factors()[0], 4).rows, rtol=1e-9)


def test_nearly_dependent_columns_are_left_to_the_singular_values(cases, rng):
    case = cases["translation"]
    E, u = observations(rng, case, 40)
    E[:, 2, 3] = E[:, 1, 3] + 1e-12 * rng.normal(size=40)
    _, regular = StereoEquations.of(case.task.lift(E), u).triangular().least_squares()
    assert not regular.any()
