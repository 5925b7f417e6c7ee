"""Nearest neighbours and locally weighted regression against scikit-learn and NumPy, and their memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.linear_model import LinearRegression
from sklearn.neighbors import KNeighborsRegressor, NearestNeighbors

from vmf.approximate import LocallyWeightedRegression, NearestNeighbours, Prediction
from vmf.approximate.visited import Visited

EPS = np.finfo(float).eps
FAR = 1e4


def codes_in_view(rng, n):
    x_L, y_L, y_R = rng.uniform(60.0, 500.0, (3, n))
    return np.stack([x_L, y_L, x_L - rng.uniform(10.0, 90.0, n), y_R], axis=1)


def draw(rng, n=120, d=3):
    return codes_in_view(rng, n), rng.normal(size=(n, d))


@pytest.mark.parametrize(("averaging", "theirs"), [("inverse_distance", "distance"), ("uniform", "uniform")])
@pytest.mark.parametrize("k", [1, 4, 30])
def test_scikit_learns_k_nearest_neighbours(averaging, theirs, k, rng):
    codes, theta = draw(rng)
    asked = np.concatenate([codes[:20], codes_in_view(rng, 60)])
    ours = NearestNeighbours(k, averaging, radius_px=FAR)
    ours.partial_fit(codes, theta)
    expected = KNeighborsRegressor(k, weights=theirs).fit(codes, theta).predict(asked)
    found = ours.predict(asked)
    np.testing.assert_allclose(found.parameters, expected, rtol=0, atol=64 * k * EPS * np.abs(theta).max())
    if averaging == "uniform":
        np.testing.assert_allclose(found.support, k, rtol=64 * EPS)
    else:
        assert (found.support[:20] == 1.0).all()
        assert (found.support <= k * (1 + 64 * EPS)).all()


@given(seed=st.integers(0, 2**32 - 1), radius=st.floats(1.0, 300.0))
def test_only_codes_within_the_radius_count(seed, radius):
    rng = np.random.default_rng(seed)
    codes, theta = draw(rng, 60)
    asked = codes_in_view(rng, 40)
    knn = NearestNeighbours(60, "uniform", radius)
    knn.partial_fit(codes, theta)
    found = knn.predict(asked)
    near = np.linalg.norm(asked[:, None] - codes, axis=-1) < radius
    np.testing.assert_array_equal(found.refused, ~near.any(axis=1))
    np.testing.assert_allclose(found.support, near.sum(axis=1), rtol=1e-12)
    for row, which, refused in zip(found.parameters, near, found.refused, strict=True):
        if not refused:
            np.testing.assert_allclose(row, theta[which].mean(axis=0), rtol=0, atol=1e-12)


def test_trust_weighs_neighbours(rng):
    codes, theta = draw(rng, 3)
    trust = np.array([1.0, 0.5, 0.1])
    knn = NearestNeighbours(3, "uniform", FAR)
    knn.partial_fit(codes, theta, trust)
    expected = trust @ theta / trust.sum()
    found = knn.predict(codes)
    np.testing.assert_allclose(found.parameters, np.tile(expected, (3, 1)), rtol=1e-12)
    np.testing.assert_allclose(found.support, trust.sum() ** 2 / (trust @ trust), rtol=1e-12)


@pytest.mark.parametrize("kind", [NearestNeighbours, LocallyWeightedRegression])
def test_trust_is_relative(kind, rng):
    codes, theta = draw(rng)
    trust, asked = rng.uniform(0.1, 1.0, 120), codes_in_view(rng, 50)
    answers = []
    for scale in (1.0, 2.0**-20):
        approximator = kind(radius_px=FAR)
        approximator.partial_fit(codes, theta, scale * trust)
        answers.append(approximator.predict(asked))
    np.testing.assert_array_equal(answers[0].parameters, answers[1].parameters)
    np.testing.assert_array_equal(answers[0].support, answers[1].support)


@given(
    seed=st.integers(0, 2**32 - 1),
    k=st.integers(8, 60),
    bandwidth=st.floats(30.0, 300.0),
)
def test_weighted_least_squares_through_the_neighbours(seed, k, bandwidth):
    """A fit for every code, by scikit-learn; a ridge of 0.01 px decides nothing where codes are spread."""
    rng = np.random.default_rng(seed)
    codes, theta = draw(rng, 80)
    trust, asked = rng.uniform(0.2, 1.0, 80), codes_in_view(rng, 20)
    lwr = LocallyWeightedRegression(k, bandwidth, FAR, ridge_px=0.01)
    lwr.partial_fit(codes, theta, trust)
    found = lwr.predict(asked)
    distance, near = NearestNeighbors(n_neighbors=k).fit(codes).kneighbors(asked)
    for row, d, which, code in zip(found.parameters, distance, near, asked, strict=True):
        w = trust[which] * np.exp(-0.5 * (np.square(d) - d.min() ** 2) / bandwidth**2)
        X = codes[which] - code
        fit = LinearRegression().fit(X, theta[which], sample_weight=w)
        A = np.column_stack([np.ones(k), X / bandwidth]) * np.sqrt(w / w.sum())[:, None]
        s = np.linalg.svd(A, compute_uv=False)
        # Slopes are damped by λ/σ²; the equations are solved in their normal form.
        bound = (0.01 / bandwidth / s[-1]) ** 2 + 64 * EPS * (s[0] / s[-1]) ** 2
        if np.isfinite(row).all():
            size = np.abs(theta).max() + np.abs(fit.coef_).max() * bandwidth + np.abs(fit.intercept_).max()
            np.testing.assert_allclose(row, fit.intercept_, rtol=0, atol=5 * bound * size)


@given(seed=st.integers(0, 2**32 - 1), noise_free=st.booleans())
def test_affine_functions_are_answered_exactly(seed, noise_free):
    """But for the ridge, that is wherever codes spread; without noise they do not in y_L − y_R."""
    rng = np.random.default_rng(seed)
    codes, asked = codes_in_view(rng, 300), codes_in_view(rng, 40)
    if noise_free:
        codes[:, 3], asked[:, 3] = codes[:, 1], asked[:, 1]
    slope, constant = rng.normal(size=(4, 2)) / 100.0, rng.normal(size=2)
    lwr = LocallyWeightedRegression(40, 100.0, FAR, ridge_px=0.01)
    lwr.partial_fit(codes, codes @ slope + constant)
    found = lwr.predict(asked)
    assert (~found.refused).sum() > 25
    error = (found.parameters - asked @ slope - constant)[~found.refused]
    # (0.01 px)² against the spread of 40 neighbours: (10 px)² or more in each direction seen.
    assert np.abs(error).max() < 1e-3


def test_support_is_what_noise_averages_to(rng):
    """The variance of 4000 answers from pure noise is the pairs' over the support: 1 ± 5·√(2/4000)."""
    codes, asked = codes_in_view(rng, 200), codes_in_view(rng, 30)
    for approximator in (NearestNeighbours(9, radius_px=FAR), LocallyWeightedRegression(radius_px=FAR)):
        approximator.partial_fit(codes, rng.normal(size=(200, 4000)))
        found = approximator.predict(asked)
        known = ~found.refused
        assert known.sum() > 15
        variance = np.square(found.parameters[known]).mean(axis=1) * found.support[known]
        assert np.abs(variance - 1.0).max() < 5 * np.sqrt(2 / 4000)


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_extrapolation_is_refused(axis, side, rng):
    """A fit through neighbours on one side amplifies their noise: 100 px outside a box of 100 px."""
    codes = 300.0 + rng.uniform(-50.0, 50.0, (400, 4))
    lwr = LocallyWeightedRegression(60, 60.0, FAR)
    lwr.partial_fit(codes, rng.normal(size=(400, 2)))
    outwards = 300.0 + np.array([0.0, 70.0, 100.0, 130.0, 150.0])[:, None] * side * np.eye(4)[axis]
    found = lwr.predict(outwards)
    assert found.support[0] > 20.0
    assert (np.diff(found.support) < 0.0).all()
    np.testing.assert_array_equal(found.refused[[0, 4]], [False, True])


def test_a_single_pair_answers_nearby(rng):
    code, theta = codes_in_view(rng, 1), rng.normal(size=(1, 3))
    for kind in (NearestNeighbours, LocallyWeightedRegression):
        approximator = kind(radius_px=50.0)
        approximator.partial_fit(code, theta)
        found = approximator.predict(code + np.outer([0.0, 30.0, 60.0], np.eye(4)[0]))
        np.testing.assert_allclose(found.parameters[0], theta[0], rtol=1e-12)
        assert found.refused[2]
        np.testing.assert_allclose(found.support[0], 1.0, rtol=1e-9)


def summed(visited):
    means = visited.means()
    order = np.lexsort(visited.state()["cells"].T)
    return visited.level, means.codes[order], means.parameters[order], means.trust[order], means.pairs[order]


@given(seed=st.integers(0, 2**32 - 1), capacity=st.integers(16, 100))
def test_memory_is_bounded_and_does_not_depend_on_the_order(seed, capacity):
    rng = np.random.default_rng(seed)
    codes, theta = rng.uniform(-100.0, 600.0, (300, 4)), rng.normal(size=(300, 2))
    trust = rng.uniform(0.1, 1.0, 300)
    found = []
    for order in (np.arange(300), rng.permutation(300)):
        visited = Visited(capacity)
        for part in np.split(order, [1, 50, 51, 200]):
            visited.add(codes[part], theta[part], trust[part])
            assert len(visited) <= capacity
        found.append(summed(visited))
    assert found[0][0] == found[1][0]
    for one, other in zip(found[0][1:], found[1][1:], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=300 * 16 * EPS * 600.0)
    level, mean_codes, means, total, pairs = found[0]
    assert pairs.sum() == 300
    np.testing.assert_allclose(total @ mean_codes, trust @ codes, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(total @ means, trust @ theta, rtol=1e-12, atol=1e-9)
    # The finest cells that fit: means lie in them, and cells half as wide would be too many.
    assert len(np.unique(np.floor(mean_codes / 2.0**level + 1e-9), axis=0)) == len(mean_codes)
    assert len(np.unique(np.floor(codes / 2.0 ** (level - 1)), axis=0)) > capacity


def test_memory_within_bounds_keeps_every_pixel_apart(rng):
    codes, theta = draw(rng, 200)
    visited = Visited(200)
    visited.add(codes, theta, None)
    assert (visited.level, len(visited)) == (0, 200)
    means = visited.means()
    np.testing.assert_array_equal(means.codes, codes)
    np.testing.assert_array_equal(means.parameters, theta)


def test_a_memory_too_small_for_any_cells_is_refused():
    with pytest.raises(ValueError, match="at least 16"):
        Visited(15)


BAD = {
    "cells": lambda a: a[:, :3],
    "sums": lambda a: a[:-1],
    "sums ": lambda a: a[:, :5],
    "sums  ": lambda a: np.where(np.arange(len(a))[:, None] == 1, np.nan, a),
    "sums   ": lambda a: 0.0 * a,
    "cells ": lambda a: np.zeros_like(a),
}


@pytest.mark.parametrize("name", BAD)
def test_a_state_that_cannot_be_is_refused(name, rng):
    knn = NearestNeighbours()
    knn.partial_fit(*draw(rng))
    state = knn.state()
    state[name.strip()] = BAD[name](state[name.strip()])
    with pytest.raises(ValueError, match="cells"):
        NearestNeighbours().restore(state)


def test_many_codes_are_answered_as_few(rng):
    """More than are answered at once."""
    codes, theta = draw(rng)
    knn = NearestNeighbours(radius_px=FAR)
    knn.partial_fit(codes, theta)
    asked = codes_in_view(rng, 1000)
    whole = knn.predict(asked)
    parts = [knn.predict(part) for part in np.array_split(asked, 7)]
    assert isinstance(whole, Prediction)
    np.testing.assert_array_equal(whole.parameters, np.concatenate([p.parameters for p in parts]))
    np.testing.assert_array_equal(whole.support, np.concatenate([p.support for p in parts]))
