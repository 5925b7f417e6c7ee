"""The engines of the pipeline against each other and against Algorithm 1 as printed (§5.1)."""

from __future__ import annotations

from collections import defaultdict

import learner_scenes as scenes
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learner_scenes import EPS, GRAM, TILING, all_tiles, assert_rows_agree, least_unsafe

from vmf.approximate import Tiling
from vmf.geometry import inverse


def partition(draw, n):
    """Block sizes that add up to n; frames may also come singly."""
    cuts = sorted(draw(st.sets(st.integers(1, n - 1), max_size=5)))
    return np.diff([0, *cuts, n]).tolist()


def gram(R):
    return np.swapaxes(R, -1, -2) @ R


def assert_factors_agree(one, other, tiles):
    A, B = gram(one._factors(tiles)), gram(other._factors(tiles))
    # A column is no smaller than one entry of a lift or one pixel: below that is rounding of both.
    size = np.maximum(np.sqrt(np.einsum("...ii->...i", B)), 1.0)
    atol = GRAM * size[..., :, None] * size[..., None, :]
    worst = np.abs(A - B) / atol
    assert worst.max() <= 1.0, worst.max()


@pytest.mark.parametrize("tiling", [TILING, None], ids=["tiles", "codes"])
@pytest.mark.parametrize("name", scenes.IDS)
@settings(max_examples=8)
@given(data=st.data())
def test_compressed_factors_are_sequential_factors(cases, name, tiling, data):
    case = cases[name]
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    frames = data.draw(st.integers(3, 16))
    scene = scenes.make_scene(
        case,
        rng,
        frames,
        data.draw(st.integers(1, 3)),
        noise=data.draw(st.sampled_from([0.0, 1.0])),
        lost=0.1,
    )
    length = data.draw(st.sampled_from([None, 1, 2, 4, 50]))
    one, other = (make(case.task, tiling, length=length) for make in (scenes.compressed, scenes.sequential))
    for block in scenes.blocks(scene.tracks, partition(data.draw, frames)):
        one.partial_fit(block)
    for block in scenes.blocks(scene.tracks, partition(data.draw, frames)):
        other.partial_fit(block)
    tiles = all_tiles(one, scene.tracks)
    assert tiles.slot.tolist() == all_tiles(other, scene.tracks).slot.tolist()
    if len(tiles):
        assert_factors_agree(one, other, tiles)


@pytest.mark.parametrize("estimator", ["qr", "tls"])
@pytest.mark.parametrize("readout", ["mean", "pooled"])
@pytest.mark.parametrize("name", scenes.IDS)
def test_compressed_parameters_are_sequential_parameters(cases, name, readout, estimator, rng):
    case = cases[name]
    scene = scenes.make_scene(case, rng, 40, 2, noise=1.0, lost=0.05)
    learners = [
        make(case.task, estimator=estimator, readout=readout)
        for make in (scenes.compressed, scenes.sequential)
    ]
    for learner, sizes in zip(learners, ([1, 20, 19], [7, 33]), strict=True):
        for block in scenes.blocks(scene.tracks, sizes):
            learner.partial_fit(block)
    codes = scenes.stereo_codes(scene.tracks)
    one, other = (learner.parameters(codes) for learner in learners)
    np.testing.assert_array_equal(one.support, other.support)
    rtol = least_unsafe(learners[1], scene.tracks)
    assert_rows_agree(one.rows, other.rows, rtol)


@pytest.mark.parametrize("name", scenes.IDS)
def test_compressed_maximum_likelihood_is_sequential(cases, name, rng):
    case = cases[name]
    scene = scenes.make_scene(case, rng, 25, 1, noise=1.0)
    learners = [make(case.task, None, estimator="ml") for make in (scenes.compressed, scenes.sequential)]
    for learner in learners:
        learner.partial_fit(scene.tracks)
    codes = scenes.stereo_codes(scene.tracks)[:4]
    one, other = (learner.parameters(codes).rows for learner in learners)
    E = scene.tracks.E_S_from_W
    x_bar = case.task.lift(E @ inverse(E[:4])[:, None])[:, :, None]
    # Ends at a relative gain of 1e-14 leave √1e-14 of the residual norm: 1 px on 100 numbers.
    np.testing.assert_allclose(
        scenes.predictions(one[:, None], x_bar), scenes.predictions(other[:, None], x_bar), rtol=0, atol=1e-5
    )


LIFTS = {
    "translation": lambda E: [E[0, 3], E[1, 3], E[2, 3]],
    "planar": lambda E: [E[0, 0], E[0, 1], E[0, 3], E[1, 3]],
    "six_dof": lambda E: [E[i, j] for j in range(4) for i in range(3)],
    "pan_tilt": lambda E: [E[i, j] for j in range(3) for i in range(3)],
    "pan_tilt_thesis": lambda E: [E[i, j] for j in range(3) for i in range(3) if (i, j) != (1, 2)],
}
UNKNOWNS = {"translation": 11, "planar": 14, "six_dof": 38, "pan_tilt": 26, "pan_tilt_thesis": 26}


def equations(lift, E_i, s_i, E_c, s_c):
    """Rows and right-hand sides of both cameras for the pair i → c (Eq. 3.46, C1)."""
    ell = np.array(lift(E_i @ np.linalg.inv(E_c)))
    x_bar, nothing = np.append(ell, 1.0), np.zeros(len(ell) + 1)
    out = []
    for camera in (slice(0, 2), slice(2, 4)):
        e_x, e_y = s_i[camera] - s_c[camera]
        A = [np.concatenate([x_bar, nothing, -e_x * ell]), np.concatenate([nothing, x_bar, -e_y * ell])]
        out.append((np.array(A), np.array([e_x, e_y])))
    return out


class Tiles:
    """Tile → all rows that UpdateParameters ever gave it, one list a camera."""

    def __init__(self, name):
        self.lift, self.unknowns = LIFTS[name], UNKNOWNS[name]
        self.rows = defaultdict(lambda: ([], []))

    def add(self, tile, E_c, E_i, s_c, s_i):
        for stack, pair in zip(self.rows[tile], equations(self.lift, E_i, s_i, E_c, s_c), strict=True):
            stack.append(pair)

    def solution(self, tile, identity):
        """Unit-depth parameters (2, 3, k+1) from NumPy's least squares, None while rank-deficient."""
        found = []
        for stack in self.rows[tile]:
            A, b = np.concatenate([A for A, _ in stack]), np.concatenate([b for _, b in stack])
            theta, _, rank, _ = np.linalg.lstsq(A, b, rcond=1e-11)
            if rank < self.unknowns:
                return None
            abc = np.append(theta, 1.0).reshape(3, -1)
            found.append(abc / (abc[2] @ identity))
        return np.array(found)


def tiles_of(code, tiling=TILING):
    """GetTiles: the T tiles of a code on diagonally displaced overlays."""
    T, w = tiling.overlays, tiling.tile_px
    return [(j, *np.floor((code + j * w / T) / w).astype(int).tolist()) for j in range(T)]


def algorithm_1(tracks, length, update):
    """The loop of Algorithm 1, one pipeline a target, with the pair of an observation with itself added."""
    pipelines = defaultdict(list)
    both = np.isfinite(tracks.pixels).all(axis=1)
    for frame in range(tracks.n_frames):
        for i in np.nonzero(both & (tracks.frame == frame))[0]:
            E, s = tracks.E_S_from_W[frame], tracks.pixels[i]
            pipeline = pipelines[tracks.target[i]]
            for E_i, s_i in pipeline:
                update(E_i, E, s_i, s)
                update(E, E_i, s, s_i)
            update(E, E, s, s)
            pipeline.append((E, s))
            if length is not None:
                del pipeline[:-length]


@pytest.mark.parametrize("length", [5, None])
@pytest.mark.parametrize("name", scenes.IDS)
def test_sequential_is_algorithm_1(cases, name, length, rng):
    case = cases[name]
    scene = scenes.make_scene(case, rng, 36, 2, noise=0.5, lost=0.02)
    tiles = Tiles(name)

    def update(E_c, E_i, s_c, s_i):
        for tile in tiles_of(s_c):
            tiles.add(tile, E_c, E_i, s_c, s_i)

    algorithm_1(scene.tracks, length, update)
    learner = scenes.sequential(case.task, length=length, min_support=0.0)
    for block in scenes.blocks(scene.tracks, [1, 2, 30, 3]):
        learner.partial_fit(block)
    assert learner.collisions.collided == 0
    codes = scenes.stereo_codes(scene.tracks)
    identity = np.append(LIFTS[name](np.eye(4)), 1.0)
    expected = np.full((len(codes), 2, 3, len(identity)), np.nan)
    for i, code in enumerate(codes):
        solved = [tiles.solution(tile, identity) for tile in tiles_of(code)]
        solved = [theta for theta in solved if theta is not None]
        if solved:
            expected[i] = np.mean(solved, axis=0)
    rtol = least_unsafe(learner, scene.tracks)
    assert_rows_agree(learner.parameters(codes).rows, expected, rtol)


@pytest.mark.parametrize("name", ["translation", "planar"])
@pytest.mark.parametrize("reach", [0.1, 0.3], ids=["few tiles", "many tiles"])
def test_kaczmarz_after_every_update(cases, name, reach, rng):
    """UpdateParameters: least squares of the tile, then Eq. 4.8 with its solution, t = 1 … T."""
    case = cases[name]
    scene = scenes.make_scene(case, rng, 14, 1, noise=0.5, reach=reach)
    step = 0.7
    tiles, W = Tiles(name), {}
    identity = np.append(LIFTS[name](np.eye(4)), 1.0)
    zero = np.zeros((2, 3, len(identity)))

    def update(E_c, E_i, s_c, s_i):
        mine = tiles_of(s_c)
        for tile in mine:
            tiles.add(tile, E_c, E_i, s_c, s_i)
            theta = tiles.solution(tile, identity)
            if theta is not None:
                correction = step * (theta - sum(W.get(t, zero) for t in mine)) / len(mine)
                for t in mine:
                    W[t] = W.get(t, zero) + correction

    algorithm_1(scene.tracks, None, update)
    learner = scenes.sequential(case.task, readout="kaczmarz", step=step)
    for block in scenes.blocks(scene.tracks, [5, 1, 8]):
        learner.partial_fit(block)
    codes = scenes.stereo_codes(scene.tracks)
    expected = np.full((len(codes), 2, 3, len(identity)), np.nan)
    for i, code in enumerate(codes):
        known = [W[t] for t in tiles_of(code) if t in W]
        if known:
            expected[i] = sum(known) * TILING.overlays / len(known)
    # The first solutions, from barely enough equations, are the worst conditioned and leave their trace.
    rtol = 1e3 * least_unsafe(learner, scene.tracks)
    assert_rows_agree(learner.parameters(codes).rows, expected, rtol)


@pytest.mark.parametrize("make", [scenes.sequential, scenes.compressed])
def test_a_bounded_pipeline_forgets(cases, rng, make):
    """Rows of a centre: itself, `length` observations before it and as many after."""
    case, length = cases["translation"], 5
    scene = scenes.make_scene(case, rng, 20, 1)
    learner = make(case.task, None, length=length)
    learner.partial_fit(scene.tracks)
    n = case.task.n_lift + 1
    R = learner._factors(all_tiles(learner, scene.tracks))[:, 0]
    # The constants' column counts pairs.
    pairs = np.square(R[:, :, n - 1]).sum(axis=1)
    i = np.arange(20)
    np.testing.assert_allclose(pairs, 1 + np.minimum(i, length) + np.minimum(19 - i, length), rtol=1000 * EPS)


def test_tiles_that_share_a_slot_share_equations_once(cases, rng):
    """With a table of one slot, it holds the pairs of the tile that came first, each counted once."""
    case = cases["translation"]
    scene = scenes.make_scene(case, rng, 10, 1, noise=0.5)
    learners = [
        make(case.task, Tiling(4, 32.0, "diagonal", 1)) for make in (scenes.compressed, scenes.sequential)
    ]
    n = case.task.n_lift + 1
    for learner in learners:
        learner.partial_fit(scene.tracks)
        (R,) = learner._factors(all_tiles(learner, scene.tracks))[:, 0]
        inside = learner.table.find(scenes.stereo_codes(scene.tracks))[1].any(axis=1).sum()
        assert 0 < inside < 10
        np.testing.assert_allclose(np.square(R[:, n - 1]).sum(), 10.0 * inside, rtol=1000 * EPS)
        # All of 40 updates but those of the tile that came first.
        assert learner.losses[0].startswith(f"{learner.collisions.collided} of 40 tile updates")
    assert_factors_agree(*learners, all_tiles(learners[0], scene.tracks))
