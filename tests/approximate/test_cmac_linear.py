"""A CMAC of affine cells: exact on affine functions, and Kaczmarz's steps on its wider basis."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.approximate import Cmac, CmacLinear, Tiling

EPS = np.finfo(float).eps
# Offsets of −½ to ½ of a tile are scaled to unit variance.
SLOPE = np.sqrt(12.0)


def literal_tiles(code, T, w):
    """Key, and offsets from the middle in widths, of the T tiles of a code, displaced as `uniform`."""
    for j in range(T):
        position = [(x + (j * step % T) * w / T) / w for x, step in zip(code, (1, 3, 5, 7), strict=True)]
        cell = [int(np.floor(p)) for p in position]
        yield (j, *cell), np.array([p - c - 0.5 for p, c in zip(position, cell, strict=True)])


def basis(code, T, w):
    return {key: np.concatenate([[1.0], SLOPE * offset]) for key, offset in literal_tiles(code, T, w)}


def literal_training(codes, thetas, T, w, steps, epochs):
    """W ← w + ε e b/‖b‖² over a dictionary of cells, each of which starts as the constant θ/T."""
    W = {}
    for _ in range(epochs):
        for code, theta, step in zip(codes, thetas, steps, strict=True):
            b = basis(code, T, w)
            for key in b:
                W.setdefault(key, np.concatenate([[theta / T], np.zeros((4, len(theta)))]))
            e = theta - sum(b[key] @ W[key] for key in b)
            square = sum(phi @ phi for phi in b.values())
            for key, phi in b.items():
                W[key] = W[key] + step * np.outer(phi, e) / square
    return W


@given(
    seed=st.integers(0, 2**32 - 1), T=st.integers(1, 7), step=st.floats(0.1, 1.9), epochs=st.integers(1, 3)
)
def test_literal(seed, T, step, epochs):
    rng = np.random.default_rng(seed)
    codes, theta = rng.uniform(0.0, 80.0, (20, 4)), rng.normal(size=(20, 3))
    trust = rng.uniform(0.1, 1.0, 20)
    cmac = CmacLinear(T, 30.0, "uniform", 1 << 20, step, epochs, min_support=0.0)
    cmac.partial_fit(codes, theta, trust)
    W = literal_training(codes, theta, T, 30.0, step * trust, epochs)
    asked = np.concatenate([codes, rng.uniform(0.0, 80.0, (20, 4))])
    # 60 updates of some roundings each, over 5 T numbers of the size of the largest.
    atol = 60 * 8 * 5 * T * EPS * max(np.abs(v).max() for v in W.values())
    prediction = cmac.predict(asked)
    for code, answer, support in zip(asked, prediction.parameters, prediction.support, strict=True):
        known = {key: phi for key, phi in basis(code, T, 30.0).items() if key in W}
        assert support == len(known) / T
        if known:
            expected = sum(phi @ W[key] for key, phi in known.items()) * T / len(known)
            np.testing.assert_allclose(answer, expected, rtol=0, atol=T * atol)


def affine(rng, d=3):
    """An affine function of codes, of the size of one over an image."""
    slope, constant = rng.normal(size=(4, d)) / 300.0, rng.normal(size=d)
    return lambda codes: np.asarray(codes) @ slope + constant, slope, constant


def cells_of(cmac, codes, slope, constant):
    """The weights of each row of `state()["weights"]` whose sum over T tiles is the affine function."""
    tiling = cmac.tiling
    slots = np.nonzero(cmac.table.used)[0]
    middle = defaultdict(list)
    offsets = tiling.offsets(codes) * tiling.tile_px
    found, own = cmac.table.find(codes)
    for slot, at in zip(found[own], (np.asarray(codes)[:, None] - offsets)[own], strict=True):
        middle[slot].append(at)
    T, w = tiling.overlays, tiling.tile_px
    rows = []
    for slot in slots:
        spread = np.ptp(middle[slot], axis=0).max()
        assert spread < 1e-9
        value = middle[slot][0] @ slope + constant
        rows.append(np.concatenate([value[None], slope * w / SLOPE]) / T)
    return np.array(rows).reshape(len(slots), -1)


@pytest.mark.parametrize("displacement", ["diagonal", "uniform"])
@given(seed=st.integers(0, 2**32 - 1), step=st.floats(0.1, 1.9))
def test_an_affine_function_is_a_fixed_point(displacement, seed, step):
    """No bias to first order: cells that hold it answer it everywhere in them, and training keeps them."""
    rng = np.random.default_rng(seed)
    function, slope, constant = affine(rng)
    codes = rng.uniform(0.0, 200.0, (60, 4))
    cmac = CmacLinear(8, 64.0, displacement, 1 << 20, step, epochs=2)
    cmac.partial_fit(codes, function(codes))
    state = cmac.state()
    state["weights"] = cells_of(cmac, codes, slope, constant)
    cmac.restore(state)
    asked = np.concatenate([codes, rng.uniform(0.0, 200.0, (200, 4))])
    # Sums of T = 8 tiles and 5 weights each.
    atol = 64 * EPS * np.abs(function(asked)).max()
    for _ in range(2):
        prediction = cmac.predict(asked)
        answered = ~prediction.refused & (prediction.support == 1.0)
        assert answered[:60].sum() > 50
        np.testing.assert_allclose(
            prediction.parameters[answered], function(asked[answered]), rtol=0, atol=60 * atol
        )
        cmac.partial_fit(codes, function(codes))


def test_a_cmac_of_constant_cells_has_that_bias(rng):
    """Half a tile of the slope, about, where the affine one has none: what the linear cells are for."""
    function, _, _ = affine(rng)
    codes, asked = rng.uniform(0.0, 100.0, (800, 4)), rng.uniform(20.0, 80.0, (300, 4))
    errors = {}
    for kind in (Cmac, CmacLinear):
        cmac = kind(4, 100.0, "uniform", 1 << 20, step=0.5, epochs=25)
        cmac.partial_fit(codes, function(codes))
        answer = cmac.predict(asked)
        known = answer.support == 1.0
        assert known.sum() > 250
        errors[kind] = np.sqrt(np.square(answer.parameters - function(asked))[known].mean())
    # What is left of the one is what 25 passes have not yet corrected; of the other, its bias.
    assert errors[CmacLinear] < 0.1 * errors[Cmac]


@given(seed=st.integers(0, 2**32 - 1), step=st.floats(0.05, 1.95))
def test_no_pair_leads_away_from_an_affine_function(seed, step):
    """Weights that hold the function are a solution, which Kaczmarz's projections only come nearer to."""
    rng = np.random.default_rng(seed)
    function, slope, constant = affine(rng)
    codes = rng.uniform(0.0, 100.0, (15, 4))
    cmac = CmacLinear(4, 50.0, "uniform", 1 << 20, step, epochs=1)
    cmac.partial_fit(codes, function(codes))
    solution = cells_of(cmac, codes, slope, constant)
    distances = []
    for code in np.tile(codes, (3, 1)):
        cmac.partial_fit(code[None], function(code[None]))
        distances.append(np.linalg.norm(cmac.state()["weights"] - solution))
    assert (np.diff(distances) <= 64 * EPS * (distances[0] + np.abs(solution).max())).all()


@given(code=st.tuples(*[st.floats(-100.0, 1000.0, width=32)] * 4), w=st.sampled_from([4.0, 16.0, 32.0]))
def test_offsets_count_from_the_middle_of_the_cells(code, w):
    tiling = Tiling(5, w, "uniform")
    offsets = tiling.offsets([code])
    assert offsets.shape == (1, 5, 4)
    expected = [offset for _, offset in literal_tiles(code, 5, w)]
    np.testing.assert_allclose(offsets[0], expected, rtol=0, atol=8 * EPS * 1000.0)
    assert np.abs(offsets).max() <= 0.5
