"""CMAC against a literal Eq. 4.8, its tiles, its bounded table and its convergence (§4.2.4, §4.3)."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vmf.approximate import Cmac, SlotTable, Tiling
from vmf.approximate.kaczmarz import TRAININGS

EPS = np.finfo(float).eps


def literal_tiles(code, T, w, displacement):
    """The T tiles of a code: overlay, then the whole number of widths from the shifted origin."""
    steps = (1, 1, 1, 1) if displacement == "diagonal" else (1, 3, 5, 7)
    return [
        (j, *(int(np.floor((x + (j * step % T) * w / T) / w)) for x, step in zip(code, steps, strict=True)))
        for j in range(T)
    ]


def albus_kaczmarz(codes, thetas, T, w, displacement, step, epochs):
    """Eq. 4.8 over a dictionary of tiles, one pair after the other."""
    W = defaultdict(lambda: np.zeros(thetas.shape[1]))
    for _, (code, theta) in product(range(epochs), list(zip(codes, thetas, strict=True))):
        tiles = literal_tiles(code, T, w, displacement)
        answer = sum(W[tile] for tile in tiles)
        for tile in tiles:
            W[tile] = W[tile] + step * (theta - answer) / T
    return W


@given(
    seed=st.integers(0, 2**32 - 1),
    T=st.integers(1, 9),
    w=st.sampled_from([1.0, 8.0, 12.5, 64.0]),
    displacement=st.sampled_from(["diagonal", "uniform"]),
    step=st.floats(0.05, 1.95),
    epochs=st.integers(1, 3),
)
def test_literal_albus_kaczmarz(seed, T, w, displacement, step, epochs):
    rng = np.random.default_rng(seed)
    codes, theta = rng.uniform(0.0, 60.0, (20, 4)), rng.normal(size=(20, 3))
    codes[10:] = np.round(codes[10:])
    cmac = Cmac(T, w, displacement, 1 << 18, step, epochs, min_support=0.0)
    cmac.partial_fit(codes, theta)
    assume(cmac.collisions.collided == 0)
    W = albus_kaczmarz(codes, theta, T, w, displacement, step, epochs)
    others = rng.uniform(0.0, 60.0, (30, 4))
    prediction = cmac.predict(np.concatenate([codes, others]))
    # Each of 60 updates adds a few roundings of numbers of the size of the largest weight, over T tiles.
    atol = 60 * 8 * T * EPS * max(np.abs(v).max() for v in W.values())
    for code, answer, support in zip(
        [*codes, *others], prediction.parameters, prediction.support, strict=True
    ):
        tiles = [tile for tile in literal_tiles(code, T, w, displacement) if tile in W]
        assert support == len(tiles) / T
        if not tiles:
            assert np.isnan(answer).all()
            continue
        np.testing.assert_allclose(answer, sum(W[t] for t in tiles) * T / len(tiles), rtol=0, atol=T * atol)


@pytest.mark.parametrize("displacement", ["diagonal", "uniform"])
@given(
    code=st.tuples(*[st.floats(-100.0, 1000.0, width=32)] * 4),
    T=st.integers(1, 40),
    w=st.sampled_from([4.0, 16.0, 32.0]),
)
def test_every_code_has_one_tile_on_each_overlay(displacement, code, T, w):
    tiling = Tiling(T, w, displacement)
    cells = tiling.cells([code])
    assert cells.shape == (1, T, 4)
    assert [(j, *cell) for j, cell in enumerate(cells[0].tolist())] == literal_tiles(code, T, w, displacement)
    assert len(set(tiling.keys([code])[0].tolist())) == T


def test_diagonal_overlays_tell_every_pixel_apart():
    """Fig. 5.1: four overlays of 4 × 4 px tiles, each one px further along the diagonal, on 20 × 20 px."""
    pixels = np.array(list(product(range(20), range(20))), float)
    cells = Tiling(4, 4.0, "diagonal").cells(np.column_stack([pixels, np.zeros((400, 2))]))
    assert len({row.tobytes() for row in cells}) == 400
    # One overlay alone cannot: 5 × 5 tiles.
    assert len({row.tobytes() for row in cells[:, :1]}) == 25


def test_uniform_displacement_spreads_overlays_off_the_diagonal():
    """Along the diagonal, shifts are the same on all axes; uniform shifts differ wherever T allows it."""
    T, w = 8, 8.0
    code = np.zeros((1, 4))

    def shifts(displacement):
        # The shift on an axis is what a coordinate lacks to the next tile.
        found = np.zeros((T, 4))
        for axis, px in product(range(4), range(1, 8)):
            moved = code.copy()
            moved[0, axis] = px
            tiling = Tiling(T, w, displacement)
            same = (tiling.cells(moved) == tiling.cells(code))[0, :, axis]
            found[:, axis] = np.where(same, found[:, axis], np.maximum(found[:, axis], w - px))
        return found

    j = np.arange(T)
    np.testing.assert_array_equal(shifts("diagonal"), np.stack([j] * 4, axis=1))
    np.testing.assert_array_equal(shifts("uniform"), np.stack([j * s % T for s in (1, 3, 5, 7)], axis=1))


def test_neighbours_share_tiles_in_proportion_to_their_nearness():
    """On one axis, codes d px apart share T (1 − d/w) of T tiles when d is a whole number of shifts."""
    T, w = 16, 32.0
    keys = Tiling(T, w).keys([[100.0 + 2 * d, 50.0, 80.0, 50.0] for d in range(17)])
    shared = [len(np.intersect1d(keys[0], row)) for row in keys]
    assert shared == list(range(16, -1, -1))


@pytest.mark.parametrize("table_size", [5, 64, 300])
def test_collisions_are_counted(table_size, rng):
    codes = rng.uniform(0.0, 500.0, (40, 4))
    tiling = Tiling(8, 32.0, "diagonal", table_size)
    owner, collided = {}, 0
    keys = tiling.keys(codes)
    for key, slot in zip(keys.ravel().tolist(), tiling.slots(keys).ravel().tolist(), strict=True):
        assert 0 <= slot < table_size
        collided += owner.setdefault(slot, key) != key
    table = SlotTable(tiling)
    for begin in range(0, 40, 7):
        table.visit(codes[begin : begin + 7])
    found = table.collisions
    assert (found.slots, found.used, found.updates, found.collided) == (
        table_size,
        len(owner),
        320,
        collided,
    )
    assert collided > 0


def test_hash_is_even():
    """χ² of 10⁴ neighbouring tiles over 1024 slots: 1023 ± 45; beyond five deviations is no hash."""
    tiling = Tiling(4, 1.0, "diagonal", 1024)
    grid = np.array(list(product(range(10), range(10), range(5), range(5))), float)
    slots = np.unique(tiling.keys(grid))
    counts = np.bincount(tiling.slots(slots), minlength=1024)
    expected = counts.sum() / 1024
    assert abs(np.square(counts - expected).sum() / expected - 1023) < 5 * np.sqrt(2 * 1023)


def test_memory_is_bounded_by_the_table(rng):
    cmac = Cmac(overlays=4, tile_px=8.0, table_size=50, step=0.1)
    codes = rng.uniform(0.0, 1e4, (500, 4))
    for block in np.split(codes, 5):
        cmac.partial_fit(block, rng.normal(size=(100, 3)))
        state = cmac.state()
        assert len(state["weights"]) == len(state["slots"]) == cmac.collisions.used <= 50
    assert cmac.collisions.collided > 0
    prediction = cmac.predict(codes)
    assert not prediction.refused.all()
    assert np.isfinite(prediction.parameters[~prediction.refused]).all()


@given(step=st.floats(0.05, 1.95), T=st.integers(1, 32), n=st.integers(1, 40))
def test_repeated_training_of_one_code_contracts_by_one_minus_step(step, T, n):
    """The error of Eq. 4.8 at its own code is (1 − ε)ⁿ of the first: zero in the limit for 0 < ε < 2."""
    code, theta = np.array([[100.0, 200.0, 60.0, 200.0]]), np.array([[3.0, -500.0, 0.01]])
    cmac = Cmac(overlays=T, step=step)
    for _ in range(n):
        cmac.partial_fit(code, theta)
    assume(cmac.collisions.used == T)
    error = cmac.predict(code).parameters - theta
    np.testing.assert_allclose(error, -((1.0 - step) ** n) * theta, rtol=0, atol=500.0 * 8 * T * n * EPS)


@pytest.mark.parametrize("step", [1.0, 1.9])
def test_shared_slots_do_not_destroy_convergence(step):
    """Kaczmarz divides by ‖b‖², which is T only while the tiles of a code have their own slots."""
    code, theta = np.array([[100.0, 200.0, 60.0, 200.0]]), np.array([[3.0, -500.0, 0.01]])
    cmac = Cmac(overlays=8, table_size=2, step=step)
    for _ in range(200):
        cmac.partial_fit(code, theta)
    np.testing.assert_allclose(cmac.predict(code).parameters, theta, rtol=1e-8)


@pytest.mark.parametrize("displacement", ["diagonal", "uniform"])
def test_cyclic_training_reaches_a_table_it_can_represent(displacement, rng):
    """Data that some CMAC produced have a CMAC solution, which Kaczmarz's cycles approach."""
    codes = rng.uniform(0.0, 30.0, (25, 4))
    teacher = Cmac(overlays=4, tile_px=16.0, displacement=displacement)
    teacher.partial_fit(codes, rng.normal(size=(25, 2)))
    theta = teacher.predict(codes).parameters
    pupil = Cmac(overlays=4, tile_px=16.0, displacement=displacement)
    errors = []
    for _ in range(6):
        pupil.partial_fit(np.tile(codes, (30, 1)), np.tile(theta, (30, 1)))
        errors.append(np.abs(pupil.predict(codes).parameters - theta).max())
    assert all(after <= before for before, after in pairwise(errors))
    assert errors[-1] < 0.05 * np.abs(theta).max()


def test_too_few_trained_tiles_refuse(rng):
    """One axis, 16 tiles: a neighbour (16 − d) tiles near is answered down to the least support."""
    cmac = Cmac(overlays=16, tile_px=32.0, min_support=0.5)
    cmac.partial_fit([[100.0, 50.0, 80.0, 50.0]], [[1.0, 2.0]])
    prediction = cmac.predict([[100.0 + 2 * d, 50.0, 80.0, 50.0] for d in range(17)])
    np.testing.assert_array_equal(prediction.support, (16 - np.arange(17)) / 16)
    np.testing.assert_array_equal(prediction.refused, np.arange(17) > 8)
    # What the trained tiles hold stands for all T: a constant stays one.
    np.testing.assert_allclose(prediction.parameters[:9], np.tile([1.0, 2.0], (9, 1)), rtol=64 * EPS)


def test_a_filled_table_still_refuses_what_was_never_visited(rng):
    """4000 codes (10 targets × 400 frames) in the default table, asked 10⁴ px away from all of them."""
    cmac = Cmac()
    cmac.partial_fit(rng.uniform(0.0, 640.0, (4000, 4)), np.ones((4000, 1)))
    assert cmac.predict(rng.uniform(1e4, 2e4, (100, 4))).refused.all()


@given(seed=st.integers(0, 2**32 - 1), step=st.floats(0.05, 1.95), training=st.sampled_from(list(TRAININGS)))
def test_tiles_that_start_from_their_first_visit_are_not_pulled_to_zero(seed, step, training):
    """A constant is learned at once, wherever it is answered, however little the pairs are trusted."""
    rng = np.random.default_rng(seed)
    codes, constant = rng.uniform(0.0, 200.0, (40, 4)), rng.normal(size=3)
    trust, asked = rng.uniform(0.01, 1.0, 40), np.concatenate([codes, rng.uniform(0.0, 200.0, (40, 4))])
    pulled, held = (
        Cmac(8, 50.0, "uniform", 1 << 18, step, training=training, new_tiles=start)
        for start in ("zero", "first_visit")
    )
    for cmac in (pulled, held):
        cmac.partial_fit(codes, np.tile(constant, (40, 1)), trust)
    answer = held.predict(asked)
    known = ~answer.refused
    assert known[:40].all()
    atol = 40 * 64 * EPS * np.abs(constant).max()
    np.testing.assert_allclose(answer.parameters[known] - constant, 0.0, rtol=0, atol=atol)
    assert np.abs(pulled.predict(asked).parameters[known] - constant).max() > 0.01 * np.abs(constant).max()
