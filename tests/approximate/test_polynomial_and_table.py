"""Polynomials against NumPy's least squares and the analytic parameters; tables against themselves."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.approximate import Lookup, Polynomial
from vmf.geometry import stereo_code

EPS = np.finfo(float).eps
RIDGE = 1e-6


def design(codes, degree):
    """All monomials of the codes, in numbers near one."""
    q = (np.asarray(codes) - 256.0) / 256.0
    powers = [c for d in range(degree + 1) for c in combinations_with_replacement(range(4), d)]
    return np.stack([np.prod([q[:, i] for i in c], axis=0) * np.ones(len(q)) for c in powers], axis=1)


def codes_in_view(rng, n):
    x_L, y_L, y_R = rng.uniform(60.0, 500.0, (3, n))
    return np.stack([x_L, y_L, x_L - rng.uniform(10.0, 90.0, n), y_R], axis=1)


def bound(X, size):
    """What a ridge (squared, over the least singular value squared) and rounding may change."""
    s = np.linalg.svd(X, compute_uv=False)
    return size * X.shape[1] * (RIDGE**2 / s[-1] ** 2 + 16 * EPS * (s[0] / s[-1]) ** 2)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_exact_on_polynomials_of_its_degree(degree, rng):
    codes, others = codes_in_view(rng, 200), codes_in_view(rng, 50)
    X = design(codes, degree)
    coefficients = rng.normal(size=(X.shape[1], 5))
    polynomial = Polynomial(degree)
    polynomial.partial_fit(codes, X @ coefficients)
    prediction = polynomial.predict(others)
    answered = ~prediction.refused
    assert answered.sum() > 40
    np.testing.assert_allclose(
        prediction.parameters[answered],
        (design(others, degree) @ coefficients)[answered],
        rtol=0,
        atol=bound(X, np.abs(coefficients).sum(axis=0).max()),
    )


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_weighted_least_squares(degree, rng):
    codes, w = codes_in_view(rng, 150), rng.uniform(0.01, 1.0, 150)
    theta = rng.normal(size=(150, 4))
    polynomial = Polynomial(degree)
    for part in np.array_split(np.arange(150), 4):
        polynomial.partial_fit(codes[part], theta[part], w[part])
    X, trust = design(codes, degree), np.sqrt(w)[:, None]
    expected = X @ np.linalg.lstsq(trust * X, trust * theta, rcond=None)[0]
    found = polynomial.predict(codes)
    answered = ~found.refused
    assert answered.sum() > 100
    size = np.abs(np.linalg.lstsq(trust * X, trust * theta, rcond=None)[0]).sum(axis=0).max()
    np.testing.assert_allclose(
        found.parameters[answered], expected[answered], rtol=0, atol=bound(trust * X, size)
    )


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(30, 120))
def test_supports_add_up(seed, n):
    """Leverages of the training codes sum to the number of monomials (the trace of the hat matrix)."""
    codes = codes_in_view(np.random.default_rng(seed), n)
    polynomial = Polynomial(2)
    polynomial.partial_fit(codes, np.zeros((n, 1)))
    X = design(codes, 2)
    np.testing.assert_allclose((1.0 / polynomial.predict(codes).support).sum(), 15, rtol=0, atol=bound(X, 15))


def test_it_knows_where_it_extrapolates(rng):
    """Away from the data along any line, support falls without end; inside it is plenty."""
    codes = codes_in_view(rng, 400)
    polynomial = Polynomial(2)
    polynomial.partial_fit(codes, np.ones((400, 1)))
    middle = codes.mean(axis=0)
    assert polynomial.predict(middle[None]).support[0] > 400 / 15
    for direction in rng.normal(size=(10, 4)):
        line = middle + np.array([300.0, 1000.0, 5000.0, 20000.0])[:, None] * direction
        prediction = polynomial.predict(line)
        assert (np.diff(prediction.support) < 0.0).all()
        assert prediction.refused[-1]


@pytest.mark.parametrize("n", [1, 5, 14])
def test_fewer_codes_than_monomials_answer_only_themselves(n, rng):
    codes = codes_in_view(rng, 60)
    polynomial = Polynomial(2)
    polynomial.partial_fit(codes[:n], np.ones((n, 1)))
    assert polynomial.predict(codes[n:]).refused.all()


@pytest.mark.parametrize("name", ["translation", "planar", "six_dof", "pan_tilt"])
def test_analytic_parameters_of_a_parallel_rig(cases, name, rng):
    """Of degree 2 in (x_L, y_L, disparity) in unit depth: learned at 300 codes, asked at 200 others."""
    case = cases[name]
    P = case.points(rng, 500)
    codes, _ = stereo_code(case.cameras, P)
    rows = case.task.parameters(case.cameras.M, P[:, None])
    polynomial = Polynomial(2)
    polynomial.partial_fit(codes[:300], rows[:300].reshape(300, -1))
    prediction = polynomial.predict(codes[300:])
    inside = prediction.support > 2.0
    assert inside.sum() > 150
    error = prediction.parameters.reshape(-1, *rows.shape[1:]) - rows[300:]
    relative = np.linalg.norm(error, axis=-1) / np.linalg.norm(rows[300:], axis=-1)
    assert relative[inside].max() < 1e-6


def test_last_parameters_win_and_visits_are_counted(rng):
    codes, theta = codes_in_view(rng, 10), rng.normal(size=(3, 10, 6))
    table = Lookup()
    table.partial_fit(np.tile(codes[:6], (2, 1)), np.concatenate([theta[0, :6], theta[1, :6]]))
    table.partial_fit(codes[4:], theta[2, 4:])
    prediction = table.predict(codes)
    np.testing.assert_array_equal(prediction.parameters[:4], theta[1, :4])
    np.testing.assert_array_equal(prediction.parameters[4:], theta[2, 4:])
    np.testing.assert_array_equal(prediction.support, [2, 2, 2, 2, 3, 3, 1, 1, 1, 1])


def test_a_table_refuses_the_nearest_number_to_a_visited_code(rng):
    codes = codes_in_view(rng, 5)
    table = Lookup()
    table.partial_fit(codes, np.ones((5, 2)))
    other = codes.copy()
    other[:, 2] = np.nextafter(other[:, 2], np.inf)
    assert table.predict(other).refused.all()
    np.testing.assert_array_equal(table.predict(other).support, 0.0)
