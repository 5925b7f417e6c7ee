"""Batched Levenberg–Marquardt against MINPACK, and the independence of its problems."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from vmf.optimise import Stop, levenberg_marquardt

EPS = np.finfo(float).eps


def rosenbrock(x, index):
    r = np.stack([10.0 * (x[:, 1] - x[:, 0] ** 2), 1.0 - x[:, 0]], axis=1)
    J = np.zeros((len(x), 2, 2))
    J[:, 0, 0], J[:, 0, 1], J[:, 1, 0] = -20.0 * x[:, 0], 10.0, -1.0
    return r, J


T = np.linspace(0.0, 2.0, 15)


def decays(y):
    """Fit y = A exp(−λ t) + B to each row."""

    def problem(x, index):
        E = np.exp(-x[:, 1:2] * T)
        r = x[:, :1] * E + x[:, 2:] - y[index]
        J = np.stack([E, -x[:, :1] * T * E, np.ones_like(E)], axis=-1)
        return r, J

    return problem


def noisy_decays(rng, Q, sigma=0.02):
    truth = np.column_stack([rng.uniform(1, 3, Q), rng.uniform(0.8, 2.5, Q), rng.uniform(-1, 1, Q)])
    y = truth[:, :1] * np.exp(-truth[:, 1:2] * T) + truth[:, 2:]
    return truth, y + sigma * rng.normal(size=y.shape)


def test_rosenbrock_from_many_starts(rng):
    starts = rng.uniform(-2, 2, (50, 2))
    fit = levenberg_marquardt(rosenbrock, starts, max_iterations=500)
    assert fit.converged.all()
    # r = 0 at (1, 1), where J has singular values ≈ 22.4 and 0.45: x is off by rounding of r over 0.45.
    np.testing.assert_allclose(fit.x, 1.0, rtol=0, atol=100 * EPS / 0.45)
    assert (fit.iterations > 0).all()


def test_fits_end_where_minpack_ends(rng):
    _, y = noisy_decays(rng, 40)
    start = np.tile([1.0, 1.0, 0.0], (40, 1))
    fit = levenberg_marquardt(decays(y), start)
    assert fit.converged.all()
    for q in range(40):
        problem = decays(y[q : q + 1])
        expected = least_squares(
            lambda x, f=problem: f(x[None], np.array([0]))[0][0],
            start[q],
            jac=lambda x, f=problem: f(x[None], np.array([0]))[1][0],
            method="lm",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        # A relative gain below cost_tolerance = 1e-14 ends ours: the rest is of that order.
        assert fit.cost[q] <= expected.cost * (1 + 1e-13)
        # ‖J δx‖ ≤ √1e-14 ‖r‖ at such an end, hence δx.
        J = problem(expected.x[None], np.array([0]))[1][0]
        bound = 1e-7 * np.sqrt(2 * expected.cost) / np.linalg.svd(J, compute_uv=False)[-1]
        np.testing.assert_allclose(fit.x[q], expected.x, rtol=0, atol=2 * bound)


def test_cost_is_half_the_squared_norm(rng):
    _, y = noisy_decays(rng, 5)
    fit = levenberg_marquardt(decays(y), np.tile([1.0, 1.0, 0.0], (5, 1)))
    r, _ = decays(y)(fit.x, np.arange(5))
    np.testing.assert_allclose(fit.cost, 0.5 * np.square(r).sum(axis=1), rtol=32 * EPS)


@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
def test_an_answer_does_not_depend_on_its_neighbours(seed, Q):
    rng = np.random.default_rng(seed)
    _, y = noisy_decays(rng, Q, sigma=0.1)
    # Bad starts too: some of these problems take long or come to nothing, which must not touch the others.
    start = rng.uniform(-3, 3, (Q, 3))
    start[0, 0] = np.nan
    with np.errstate(over="ignore", invalid="ignore"):
        together = levenberg_marquardt(decays(y), start)
        for q in range(Q):
            alone = levenberg_marquardt(decays(y[q : q + 1]), start[q : q + 1])
            assert alone.stop[0] == together.stop[q]
            np.testing.assert_allclose(alone.x[0], together.x[q], rtol=1e-12, atol=1e-12)
            assert alone.iterations[0] == together.iterations[q]


def test_order_of_problems_does_not_matter(rng):
    _, y = noisy_decays(rng, 10)
    start = np.tile([1.0, 1.0, 0.0], (10, 1))
    order = rng.permutation(10)
    fit, shuffled = levenberg_marquardt(decays(y), start), levenberg_marquardt(decays(y[order]), start)
    np.testing.assert_allclose(shuffled.x, fit.x[order], rtol=1e-12, atol=1e-12)


def test_a_start_that_is_not_finite_ends_at_once_and_alone(rng):
    starts = np.array([[np.nan, 0.0], [np.inf, 0.0], [-1.2, 1.0]])
    with np.errstate(all="ignore"):
        fit = levenberg_marquardt(rosenbrock, starts, max_iterations=500)
    assert fit.stop[:2].tolist() == [Stop.NOT_FINITE, Stop.NOT_FINITE]
    assert fit.iterations[:2].tolist() == [0, 0]
    assert fit.converged.tolist() == [False, False, True]


def test_zero_residual_problems_converge_to_rounding(rng):
    truth, y = noisy_decays(rng, 20, sigma=0.0)
    fit = levenberg_marquardt(decays(y), np.tile([1.0, 1.0, 0.0], (20, 1)))
    assert fit.converged.all()
    J = decays(y)(truth, np.arange(20))[1]
    smallest = np.linalg.svd(J, compute_uv=False)[:, -1]
    assert (np.abs(fit.x - truth).max(axis=1) <= 32 * EPS * 15 * 3 / smallest).all()


def test_starting_at_the_answer_takes_no_step():
    fit = levenberg_marquardt(rosenbrock, np.ones((1, 2)))
    assert fit.stop[0] == Stop.GRADIENT
    assert fit.iterations[0] == 0
    np.testing.assert_array_equal(fit.x, [[1.0, 1.0]])


def test_an_answer_at_zero_converges(rng):
    """Steps relative to an answer of length zero must not keep a problem going."""
    A = rng.normal(size=(30, 6, 3))

    def linear(x, index):
        return np.sin(A[index] @ x[..., None])[..., 0], np.cos(A[index] @ x[..., None]) * A[index]

    fit = levenberg_marquardt(linear, 1e-3 * rng.normal(size=(30, 3)))
    assert fit.converged.all()
    assert (np.abs(fit.x) <= 1e-12).all()


@pytest.mark.parametrize("limit", [0, 1, 3])
def test_no_more_steps_than_allowed(limit):
    fit = levenberg_marquardt(rosenbrock, np.array([[-1.2, 1.0]]), max_iterations=limit)
    assert fit.stop[0] == Stop.MAX_ITERATIONS
    assert fit.iterations[0] == limit
    assert not fit.converged[0]
    assert fit.cost[0] <= 0.5 * (4.4**2 + 2.2**2) * (1 + 8 * EPS)


def test_a_step_into_nowhere_is_refused():
    """√x has no values left of zero: the minimiser at x = 1e-4 is reached from the right."""

    def root(x, index):
        s = np.sqrt(np.where(x > 0, x, np.nan))
        return s - 0.01, (0.5 / s)[..., None]

    fit = levenberg_marquardt(root, np.array([[4.0]]))
    assert fit.converged[0]
    assert fit.x[0, 0] == pytest.approx(1e-4, rel=1e-10)


def test_unknowns_without_influence_stay_where_they_are(rng):
    def blind(x, index):
        r, J = rosenbrock(x[:, :2], index)
        return r, np.concatenate([J, np.zeros((len(x), 2, 1))], axis=2)

    fit = levenberg_marquardt(blind, np.array([[-1.2, 1.0, 7.0]]), max_iterations=500)
    assert fit.converged[0]
    np.testing.assert_allclose(fit.x[0], [1, 1, 7], rtol=0, atol=100 * EPS / 0.45)


def test_dependent_unknowns_still_reach_the_least_cost(rng):
    A = rng.normal(size=(8, 2))
    b = rng.normal(size=8)
    twice = np.column_stack([A, A[:, 1]])
    fit = levenberg_marquardt(
        lambda x, index: (x @ twice.T - b, np.broadcast_to(twice, (len(x), 8, 3))), np.zeros((1, 3))
    )
    least = np.linalg.lstsq(A, b, rcond=None)[1][0]
    assert fit.converged[0]
    assert 2 * fit.cost[0] == pytest.approx(least, rel=1e-12)


def test_scale_of_residuals_does_not_matter(rng):
    _, y = noisy_decays(rng, 5)
    start = np.tile([1.0, 1.0, 0.0], (5, 1))
    base = decays(y)
    fit = levenberg_marquardt(base, start)
    for scale in (2.0**-40, 2.0**40):
        scaled = levenberg_marquardt(lambda x, i, s=scale: tuple(s * a for a in base(x, i)), start)
        np.testing.assert_allclose(scaled.x, fit.x, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(scaled.stop, fit.stop)


def test_scale_of_unknowns_does_not_matter(rng):
    """Marquardt damping goes with the diagonal: metres or millimetres give the same answer."""
    _, y = noisy_decays(rng, 5)
    start = np.tile([1.0, 1.0, 0.0], (5, 1))
    units = 2.0 ** np.array([10, -10, 5])
    base = decays(y)

    def rescaled(x, index):
        r, J = base(x * units, index)
        return r, J * units

    fit, other = levenberg_marquardt(base, start), levenberg_marquardt(rescaled, start / units)
    np.testing.assert_allclose(other.x * units, fit.x, rtol=1e-7)


def test_normalised_points_stay_normalised(rng):
    """A residual that does not depend on the length of x: directions towards targets."""
    target = rng.normal(size=(6, 3))
    target /= np.linalg.norm(target, axis=1, keepdims=True)

    def unit(x):
        return x / np.linalg.norm(x, axis=-1, keepdims=True)

    def direction(x, index):
        length = np.linalg.norm(x, axis=1)[:, None, None]
        u = unit(x)
        return u - target[index], (np.eye(3) - u[:, :, None] * u[:, None, :]) / length

    fit = levenberg_marquardt(direction, unit(target + 0.3 * rng.normal(size=(6, 3))), normalise=unit)
    assert fit.converged.all()
    np.testing.assert_allclose(np.linalg.norm(fit.x, axis=1), 1.0, rtol=8 * EPS)
    np.testing.assert_allclose(fit.x, target, rtol=0, atol=1e-9)


def test_a_singular_problem_does_not_stop_the_others():
    """Exactly dependent columns and no damping left to hide them (Cholesky or LU would raise)."""

    def problem(x, index):
        r = np.where(index[:, None] == 0, x.sum(axis=1, keepdims=True) - 1.0, x - 2.0)
        J = np.where(index[:, None, None] == 0, np.ones((1, 2, 2)), np.eye(2))
        return r, J

    fit = levenberg_marquardt(problem, np.zeros((2, 2)))
    assert fit.converged.all()
    assert fit.x[0].sum() == pytest.approx(1.0, abs=1e-10)
    np.testing.assert_allclose(fit.x[1], 2.0, rtol=1e-10)


def test_an_exactly_singular_system_still_takes_a_step():
    """e^−(x+y) has no minimiser: its damping fades away, and then the two equal columns are all there is."""

    def fading(x, index):
        r = np.exp(-x.sum(axis=1, keepdims=True))
        return r, -np.repeat(r[:, :, None], 2, axis=2)

    fit = levenberg_marquardt(fading, np.zeros((2, 2)), max_iterations=100)
    assert (fit.stop == Stop.MAX_ITERATIONS).all()
    # Every full step adds one to x + y; the first are damped by 1e-4 and less.
    np.testing.assert_allclose(fit.x.sum(axis=1), 100.0, rtol=0, atol=0.01)


def test_no_problems_no_answers():
    fit = levenberg_marquardt(rosenbrock, np.zeros((0, 2)))
    assert fit.x.shape == (0, 2)
    assert fit.converged.shape == (0,)


def test_the_start_is_not_written_to():
    start = np.array([[-1.2, 1.0]])
    levenberg_marquardt(rosenbrock, start)
    np.testing.assert_array_equal(start, [[-1.2, 1.0]])
