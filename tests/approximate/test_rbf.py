"""Radial basis functions against scikit-learn's Gaussian process, and what their support promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

from vmf.approximate import RadialBasis

EPS = np.finfo(float).eps


def codes_in_view(rng, n):
    x_L, y_L, y_R = rng.uniform(60.0, 500.0, (3, n))
    return np.stack([x_L, y_L, x_L - rng.uniform(10.0, 90.0, n), y_R], axis=1)


def kernel(a, b, width):
    return np.exp(-0.5 * np.square(np.linalg.norm(a[:, None] - b, axis=-1) / width))


@pytest.mark.parametrize(("width", "smoothing"), [(60.0, 1e-2), (150.0, 1e-3), (400.0, 1e-1)])
def test_scikit_learns_gaussian_process(width, smoothing, rng):
    codes, theta, asked = codes_in_view(rng, 100), rng.normal(size=(100, 3)), codes_in_view(rng, 60)
    trust = rng.uniform(0.2, 1.0, 100)
    rbf = RadialBasis(width, smoothing)
    rbf.partial_fit(codes, theta, trust)
    found = rbf.predict(asked)
    mean = trust @ theta / trust.sum()
    noise = smoothing * trust.mean() / trust
    theirs = GaussianProcessRegressor(RBF(width), alpha=noise, optimizer=None).fit(codes, theta - mean)
    known = ~found.refused
    # A solution of equations whose condition is 100 kernels' sum over the smoothing.
    atol = 1e3 * EPS * 100.0 / smoothing * np.abs(theta).max()
    expected = theirs.predict(asked) + mean
    np.testing.assert_allclose(found.parameters[known], expected[known], rtol=0, atol=atol)
    # Their variance for pairs that are all trusted alike is what the support is the inverse of.
    alike = GaussianProcessRegressor(RBF(width), alpha=smoothing, optimizer=None).fit(codes, theta)
    _, deviation = alike.predict(asked, return_std=True)
    np.testing.assert_allclose(smoothing / found.support, deviation[:, 0] ** 2, rtol=1e-6, atol=100 * atol)
    np.testing.assert_array_equal(known, found.support >= 1.0)


@given(seed=st.integers(0, 2**32 - 1), width=st.floats(150.0, 400.0))
def test_the_error_is_within_what_the_support_says(seed, width):
    """|f − f̂| ≤ ‖f‖ σ for a function of the kernel's space, seen without noise; σ² = smoothing/support."""
    rng = np.random.default_rng(seed)
    smoothing = 1e-2
    codes, asked, places = codes_in_view(rng, 150), codes_in_view(rng, 80), codes_in_view(rng, 20)
    heights = rng.normal(size=20)
    # Without a mean over the codes, so that w0 = 0.
    sums = kernel(codes, places, width).sum(axis=0)
    heights -= sums * (sums @ heights) / (sums @ sums)
    rbf = RadialBasis(width, smoothing)
    rbf.partial_fit(codes, kernel(codes, places, width) @ heights[:, None])
    found = rbf.predict(asked)
    norm = np.sqrt(heights @ kernel(places, places, width) @ heights)
    error = np.abs(found.parameters[:, 0] - kernel(asked, places, width) @ heights)
    known = ~found.refused
    assert known.any()
    assert (error[known] <= norm * np.sqrt(smoothing / found.support[known]) * (1 + 1e-6)).all()


def test_support_falls_on_every_way_out_of_the_data(rng):
    codes = codes_in_view(rng, 400)
    rbf = RadialBasis()
    rbf.partial_fit(codes, rng.normal(size=(400, 1)))
    middle = codes.mean(axis=0)
    assert rbf.predict(middle[None]).support[0] > 10.0
    for direction in rng.normal(size=(10, 4)):
        line = middle + np.array([0.0, 400.0, 800.0, 1600.0])[:, None] * direction / np.linalg.norm(direction)
        found = rbf.predict(line)
        assert (np.diff(found.support) < 0.0).all()
        assert found.refused[-1]


@given(n=st.integers(1, 30), smoothing=st.floats(1e-6, 0.5))
def test_n_visits_of_a_code_are_worth_n_pairs(n, smoothing):
    """The variance is λ/(n + λ) there, for noise of variance λ."""
    rbf = RadialBasis(smoothing=smoothing)
    code = np.array([[200.0, 100.0, 150.0, 100.0]])
    rbf.partial_fit(np.tile(code, (n, 1)), np.full((n, 2), 3.0))
    found = rbf.predict(code)
    np.testing.assert_allclose(found.support, n + smoothing, rtol=64 * EPS * n / smoothing)
    np.testing.assert_allclose(found.parameters, 3.0, rtol=1e-12)


def test_trust_is_relative_and_hides_no_visited_code(rng):
    codes, theta, asked = codes_in_view(rng, 80), rng.normal(size=(80, 2)), codes_in_view(rng, 40)
    trust = 10.0 ** rng.uniform(-12.0, 0.0, 80)
    answers = []
    for scale in (1.0, 2.0**-10):
        rbf = RadialBasis(100.0, 1e-4)
        rbf.partial_fit(codes, theta, scale * trust)
        answers.append(rbf.predict(np.concatenate([codes, asked])))
    assert not answers[0].refused[:80].any()
    np.testing.assert_array_equal(answers[0].support, answers[1].support)
    np.testing.assert_allclose(answers[0].parameters, answers[1].parameters, rtol=1e-6, atol=1e-9)


def test_kernels_are_bounded(rng):
    rbf = RadialBasis(max_centres=50, smoothing=0.01)
    codes = codes_in_view(rng, 2000)
    slope = rng.normal(size=(4, 2)) / 300.0
    rbf.partial_fit(codes, codes @ slope)
    assert len(rbf.state()["cells"]) <= 50
    # And still say what the 2000 pairs said, to some hundredths of a function of the size of one.
    found = rbf.predict(codes)
    known = ~found.refused
    assert known.any()
    error = (found.parameters - codes @ slope)[known]
    assert np.sqrt(np.square(error).mean()) < 0.1 * np.std(codes @ slope)
