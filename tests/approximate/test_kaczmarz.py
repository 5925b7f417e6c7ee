"""Trainings of a CMAC against literal forms of their equations, and on equations that have a solution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.approximate import Cmac, Tiling
from vmf.approximate.kaczmarz import TRAININGS, Equations

EPS = np.finfo(float).eps
WINDOW = 4
SEED = 7


def dense_basis(tiling, codes):
    """The matrix B (N, L) of Eq. 4.4: a column for every tile that some code falls in."""
    keys = tiling.keys(codes)
    tiles, columns = np.unique(keys, return_inverse=True)
    B = np.zeros((len(codes), len(tiles)))
    B[np.arange(len(codes))[:, None], columns.reshape(keys.shape)] = 1.0
    return B


def albus(B, y, eps, w):
    for b, target, step in zip(B, y, eps, strict=True):
        w = w + step * np.outer(b, target - b @ w) / (b @ b)
    return w


def moving_average(B, y, eps, w):
    for k in range(len(B)):
        last = range(max(0, k - WINDOW + 1), k + 1)
        w = w + sum(eps[i] * np.outer(B[i], y[i] - B[i] @ w) / (B[i] @ B[i]) for i in last) / len(last)
    return w


def maximum_error(B, y, eps, w):
    for k in range(len(B)):
        w = albus(B[k : k + 1], y[k : k + 1], eps[k : k + 1], w)
        before = list(range(max(0, k - WINDOW + 1), k))
        if before:
            i = before[int(np.argmax([eps[i] * np.linalg.norm(y[i] - B[i] @ w) for i in before]))]
            w = albus(B[i : i + 1], y[i : i + 1], eps[i : i + 1], w)
    return w


def partial_gram_schmidt(B, y, eps, w):
    for k in range(len(B)):
        v, basis = B[k].copy(), []
        # Gram and Schmidt's own way, done twice for rounding.
        for b in B[max(0, k - WINDOW + 1) : k]:
            u = b.copy()
            for q in basis * 2:
                u = u - (q @ u) * q
            if u @ u > 1e-8 * (b @ b):
                basis.append(u / np.linalg.norm(u))
        for q in basis * 2:
            v = v - (q @ v) * q
        if v @ v > 1e-8 * (B[k] @ B[k]):
            w = w + eps[k] * np.outer(v, y[k] - B[k] @ w) / (v @ B[k])
    return w


def randomised(B, y, eps, w):
    squares = np.square(B).sum(axis=1)
    # The stream that `Cmac` says it uses: the seed, and the number of tile updates.
    rng = np.random.default_rng((SEED, int(squares.sum())))
    drawn = rng.choice(len(B), len(B), p=squares / squares.sum())
    order = [*drawn, *(k for k in range(len(B)) if k not in drawn)]
    return albus(B[order], y[order], eps[order], w)


LITERAL = {f.__name__: f for f in (albus, moving_average, maximum_error, partial_gram_schmidt, randomised)}


def test_all_trainings_have_a_literal_form():
    assert LITERAL.keys() == TRAININGS.keys()


@pytest.mark.parametrize("training", TRAININGS)
@given(seed=st.integers(0, 2**32 - 1), T=st.integers(1, 8), step=st.floats(0.1, 1.9), trusted=st.booleans())
def test_literal(training, seed, T, step, trusted):
    rng = np.random.default_rng(seed)
    codes, y = rng.uniform(0.0, 60.0, (16, 4)), rng.normal(size=(16, 3))
    codes[12:] = codes[:4]
    trust = rng.uniform(0.1, 1.0, 16) if trusted else np.ones(16)
    cmac = Cmac(T, 24.0, "uniform", 1 << 20, step, training=training, window=WINDOW, seed=SEED)
    cmac.partial_fit(codes, y, trust)
    assert cmac.collisions.collided == 0
    B = dense_basis(cmac.tiling, codes)
    w = LITERAL[training](B, y, step * trust, np.zeros((B.shape[1], 3)))
    # 16 corrections of weights of the size of the largest; Gram–Schmidt divides by what 1e-8 lets pass.
    loss = 1e4 if training == "partial_gram_schmidt" else 1.0
    atol = 16 * 16 * T * EPS * (1.0 + np.abs(w).max()) * loss
    np.testing.assert_allclose(cmac.predict(codes).parameters, B @ w, rtol=0, atol=atol)


def consistent(rng, n=20):
    """Codes, what some CMAC answers there, and B."""
    tiling = Tiling(6, 24.0, "uniform")
    codes = rng.uniform(0.0, 40.0, (n, 4))
    B = dense_basis(tiling, codes)
    return codes, B @ rng.normal(size=(B.shape[1], 3)), B


def cmac_for(training, **options):
    return Cmac(6, 24.0, "uniform", 1 << 20, training=training, window=WINDOW, seed=SEED, **options)


@pytest.mark.parametrize("training", TRAININGS)
def test_consistent_equations_are_solved(training, rng):
    """Drawn in random order, a pass leaves exp(−σ²/2T) of the error in the mean; the others do no worse."""
    codes, y, B = consistent(rng)
    sigma = np.linalg.svd(B, compute_uv=False)
    least = sigma[sigma > 1e-9 * sigma[0]][-1]
    passes = int(np.ceil(np.log(1e6) / (least**2 / (2 * 6))))
    cmac = cmac_for(training, epochs=min(passes, 4000))
    cmac.partial_fit(codes, y)
    assert np.abs(cmac.predict(codes).parameters - y).max() < 1e-6 * np.abs(y).max()


def test_a_window_of_all_equations_solves_them_in_one_pass(rng):
    """Gram–Schmidt: every equation stays satisfied, and one that depends on others is satisfied with them."""
    codes, y, B = consistent(rng, 12)
    sigma = np.linalg.svd(B, compute_uv=False)
    sigma = sigma[sigma > 1e-9]
    cmac = Cmac(6, 24.0, "uniform", 1 << 20, training="partial_gram_schmidt", window=12)
    cmac.partial_fit(codes, y)
    atol = 12 * 64 * EPS * (sigma[0] / sigma[-1]) ** 2 * np.abs(y).max()
    np.testing.assert_allclose(cmac.predict(codes).parameters, y, rtol=0, atol=atol)
    # Albus–Kaczmarz has satisfied no more than the last.
    other = cmac_for("albus")
    other.partial_fit(codes, y)
    error = np.abs(other.predict(codes).parameters - y).max(axis=1)
    assert error[-1] < 1e-12
    assert error[:-1].max() > 0.01


@pytest.mark.parametrize("m", [2, 5])
def test_the_last_equations_stay_satisfied(m, rng):
    codes, y, _ = consistent(rng, 12)
    cmac = Cmac(6, 24.0, "uniform", 1 << 20, training="partial_gram_schmidt", window=m)
    for k in range(12):
        cmac.partial_fit(codes[k : k + 1], y[k : k + 1])
        last = slice(max(0, k - m + 1), k + 1)
        np.testing.assert_allclose(cmac.predict(codes[last]).parameters, y[last], rtol=0, atol=1e-9)


@pytest.mark.parametrize("training", [t for t in TRAININGS if t != "partial_gram_schmidt"])
@given(seed=st.integers(0, 2**32 - 1), step=st.floats(0.05, 1.95))
def test_no_step_leads_away_from_a_solution(training, seed, step):
    """Projections, and means of them, are not expansive for 0 < ε < 2 (Kaczmarz 1937; §4.3.2)."""
    rng = np.random.default_rng(seed)
    _, y, B = consistent(rng, 10)
    solution = np.linalg.lstsq(B, y, rcond=None)[0]
    w = rng.normal(size=solution.shape)
    columns = np.argsort(-B, axis=1, kind="stable")[:, :6]
    distances = [np.linalg.norm(w - solution)]
    for k in range(1, 11):
        equations = Equations(
            columns[:k], np.ones((k, 6)), np.ones(k), np.full(k, 6.0), y[:k], np.full(k, step)
        )
        TRAININGS[training].train(w, equations, k - 1, WINDOW, rng)
        distances.append(np.linalg.norm(w - solution))
    assert (np.diff(distances) <= 64 * EPS * distances[0]).all()


def test_draws_are_as_likely_as_their_equations_are_long(rng):
    """χ² of 4000 draws over 8 equations of unequal norm: 7 ± 3.7; beyond five deviations is another law.

    Of each 8 projections or more, the first 8 are draws.
    """
    norm = np.arange(1.0, 9.0)
    seen = []

    class Counting(Equations):
        def satisfy(self, W, k):
            seen.append(int(k))

    columns = np.zeros((8, 1), np.int64)
    equations = Counting(columns, np.sqrt(norm)[:, None], np.ones(8), norm, np.zeros((8, 1)), np.ones(8))
    drawn = []
    for _ in range(500):
        seen.clear()
        TRAININGS["randomised"].train(np.zeros((1, 1)), equations, 0, 1, rng)
        assert set(seen) == set(range(8))
        drawn += seen[:8]
    expected = 4000 * norm / norm.sum()
    chi2 = (np.square(np.bincount(drawn, minlength=8) - expected) / expected).sum()
    assert chi2 < 7 + 5 * np.sqrt(14)


@pytest.mark.parametrize("training", TRAININGS)
def test_a_code_without_a_tile_of_its_own_teaches_nothing(training, rng):
    cmac = Cmac(2, 8.0, table_size=1, training=training, window=WINDOW)
    codes = rng.uniform(0.0, 100.0, (10, 4))
    with np.errstate(all="raise"):
        cmac.partial_fit(codes, np.full((10, 1), 3.0))
    assert cmac.collisions.used == 1
    answered = ~cmac.predict(codes).refused
    np.testing.assert_allclose(cmac.predict(codes).parameters[answered], 3.0, rtol=1e-12)


def test_the_window_of_one_is_albus_kaczmarz(rng):
    codes, y, _ = consistent(rng)
    answers = []
    for training in ("albus", "moving_average", "maximum_error", "partial_gram_schmidt"):
        cmac = Cmac(6, 24.0, "uniform", training=training, window=1)
        cmac.partial_fit(codes, y)
        answers.append(cmac.predict(codes).parameters)
    for other in answers[1:]:
        np.testing.assert_allclose(other, answers[0], rtol=0, atol=1e-12)
