"""What `engine: compressed` promises: the sequential engine's parameters at a cost that does not grow."""

from __future__ import annotations

import tracemalloc

import learner_scenes as scenes
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learner_scenes import TILING, assert_rows_agree, least_unsafe

import vmf.estimate.stereo as stereo
from vmf.estimate import condition_number
from vmf.learn import history

# Pan-tilt needs wide turns before its equations are conditioned to six digits.
REACH = {"pan_tilt": 0.6, "pan_tilt_thesis": 0.6}


def relative_difference(one, other):
    """Of parameters (S, 2, 3, k+1), per tile and camera: norm of the difference by norm."""
    gap = np.linalg.norm((one - other).reshape(*one.shape[:2], -1), axis=-1)
    return gap / np.linalg.norm(other.reshape(*other.shape[:2], -1), axis=-1)


@pytest.mark.parametrize("name", scenes.IDS)
@settings(max_examples=4)
@given(
    seed=st.integers(0, 2**32 - 1),
    length=st.sampled_from([None, 3, 20, 60]),
    noise=st.sampled_from([0.0, 1.0, 5.0]),
    cut=st.integers(1, 69),
)
def test_nine_digits_at_condition_numbers_to_a_million(cases, name, seed, length, noise, cut):
    case = cases[name]
    rng = np.random.default_rng(seed)
    scene = scenes.make_scene(case, rng, 70, 3, noise=noise, lost=0.05, reach=REACH.get(name, 0.2))
    one, other = (make(case.task, length=length) for make in (scenes.compressed, scenes.sequential))
    for block in scenes.blocks(scene.tracks, [cut, 70 - cut]):
        one.partial_fit(block)
    other.partial_fit(scene.tracks)
    tiles = one.tiles(scenes.stereo_codes(scene.tracks))
    (rows, good), (expected, well) = one._solve(tiles), other._solve(tiles)
    np.testing.assert_array_equal(good, well)
    checked = good & (condition_number(other._factors(tiles)) <= 1e6).all(axis=1)
    assert (relative_difference(rows, expected)[checked] <= 1e-9).all()


def test_the_million_is_reached(cases, rng):
    """The test above would say nothing if all conditions were good, or all too bad to count."""
    for name in scenes.IDS:
        case = cases[name]
        scene = scenes.make_scene(case, rng, 70, 3, noise=1.0, reach=REACH.get(name, 0.2))
        learner = scenes.compressed(case.task)
        learner.partial_fit(scene.tracks)
        tiles = learner.tiles(scenes.stereo_codes(scene.tracks))
        condition = condition_number(learner._factors(tiles)).max(axis=1)
        assert (condition <= 1e6).sum() >= 10, name


@pytest.mark.parametrize("readout", ["mean", "pooled"])
@pytest.mark.parametrize("length", [None, 4])
@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), sizes=st.lists(st.integers(1, 9), min_size=4, max_size=6))
def test_asking_on_the_way_changes_no_answer(cases, readout, length, seed, sizes):
    """Solutions are kept where no further observation can change them, and only there."""
    case = cases["planar"]
    rng = np.random.default_rng(seed)
    scene = scenes.make_scene(case, rng, sum(sizes) + 20, 2, noise=0.3, lost=0.1)
    codes = scenes.stereo_codes(scene.tracks)
    asked = scenes.compressed(case.task, readout=readout, length=length)
    fresh = scenes.compressed(case.task, readout=readout, length=length)
    for block in scenes.blocks(scene.tracks, [20, *sizes]):
        asked.partial_fit(block)
        asked.parameters(codes)
        fresh.partial_fit(block)
    rtol = least_unsafe(fresh, scene.tracks)
    assert_rows_agree(asked.parameters(codes).rows, fresh.parameters(codes).rows, rtol)


@pytest.mark.parametrize("readout", ["mean", "pooled"])
@pytest.mark.parametrize("make", [scenes.compressed, scenes.sequential])
def test_one_camera_is_told_what_both_are(cases, rng, make, readout):
    case = cases["planar"]
    scene = scenes.make_scene(case, rng, 40, 2, noise=0.3)
    learner = make(case.task, readout=readout)
    learner.partial_fit(scene.tracks)
    codes = scenes.stereo_codes(scene.tracks)
    rtol, both = least_unsafe(learner, scene.tracks), learner.parameters(codes).rows
    for camera, i in (("left", 0), ("right", 1)):
        one = learner.parameters(codes, camera).rows
        assert np.isnan(one[:, 1 - i]).all()
        answered = np.isfinite(both[:, i]).all(axis=(1, 2))
        assert answered.sum() >= len(codes) / 2
        assert_rows_agree(one[answered, i : i + 1], both[answered, i : i + 1], rtol)


class Work:
    """Counts the numbers that go into QR decompositions."""

    def __init__(self, monkeypatch):
        self.total = 0
        plain = stereo.triangle

        def counted(A):
            self.total += A.size
            return plain(A)

        monkeypatch.setattr(stereo, "triangle", counted)

    def of(self, action):
        before = self.total
        action()
        return self.total - before


@pytest.mark.parametrize("length", [None, 8])
def test_a_frame_costs_the_same_however_many_came_before(cases, rng, monkeypatch, length):
    case = cases["six_dof"]
    scene = scenes.make_scene(case, rng, 400, 3)
    learner, work = scenes.compressed(case.task, length=length), Work(monkeypatch)
    frames = [scene.tracks.select_frames(i, i + 1) for i in range(400)]
    costs = [work.of(lambda block=block: learner.partial_fit(block)) for block in frames]
    assert len(set(costs)) == 1


@pytest.mark.parametrize("length", [None, 8])
def test_a_tile_costs_what_its_own_centres_cost(cases, rng, monkeypatch, length):
    """The same tile, before and after 300 observations that all lie elsewhere."""
    case = cases["translation"]
    scene = scenes.make_scene(case, rng, 20, 1)
    # Far from the first 20 in pixels, whatever that means for the world: only the cost is looked at.
    elsewhere = scenes.make_scene(case, rng, 300, 1)
    elsewhere.tracks.pixels[...] += 3 * TILING.tile_px
    learner, work = scenes.compressed(case.task, length=length), Work(monkeypatch)
    learner.partial_fit(scene.tracks)
    code = scenes.stereo_codes(scene.tracks)[:1]
    before = work.of(lambda: learner.parameters(code))
    learner.partial_fit(elsewhere.tracks)
    for solved in learner._solved.values():
        solved.clear()
    after = work.of(lambda: learner.parameters(code))
    if length is None:
        assert after == before
    else:
        # Windows that were cut at the end of the first 20 are now whole.
        assert before <= after <= before + 8 * 20 * 5 * (case.task.n_lift + 1) * 2


def test_windows_in_common_are_not_formed_anew(cases, rng, monkeypatch):
    """A tile with all of 200 centres, each paired with the 40 around it: far fewer rows than 200 · 41."""
    case, length = cases["translation"], 20
    scene = scenes.make_scene(case, rng, 200, 1, reach=0.01)
    learner = scenes.compressed(case.task, length=length)
    learner.partial_fit(scene.tracks)
    rows = 0
    plain = history.StereoEquations.of

    def counted(x_bar, u):
        nonlocal rows
        rows += len(x_bar)
        return plain(x_bar, u)

    monkeypatch.setattr(history.StereoEquations, "of", staticmethod(counted))
    everyone = np.arange(200)
    learner._history.pairs(everyone)
    # Each row once to the left and once to the right of a place where windows are halved.
    assert 200 <= rows <= 2 * 200


def test_only_poses_and_codes_are_kept_of_an_observation(cases, rng):
    """Per observation: pose (16 numbers), code (4), time, frame, target, and where it is found (3)."""
    case = cases["six_dof"]
    scene = scenes.make_scene(case, rng, 4000, 1)
    blocks = scenes.blocks(scene.tracks, [100] * 40)
    learner = scenes.compressed(case.task)
    for block in blocks[:20]:
        learner.partial_fit(block)
    tracemalloc.start()
    try:
        for block in blocks[20:]:
            learner.partial_fit(block)
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    kept = 8 * (16 + 4 + 6)
    # Arrays have up to half of their size as room to grow; a bucket of its own is a key and a small array.
    bucket = 500
    assert grown / 2000 <= 1.5 * 2 * kept + bucket
