"""What every learner promises, whatever its engine, estimator, read-out and tiles."""

from __future__ import annotations

import io

import learner_scenes as scenes
import numpy as np
import pytest
from learner_scenes import EPS

from vmf.approximate import APPROXIMATORS, Polynomial
from vmf.learn import CompressedPipeline, SequentialPipeline, TransportLearner

MAKERS = {
    **{f"transport {e}": lambda task, e=e: scenes.transport(task, estimator=e) for e in ("qr", "tls", "ml")},
    "transport own codes": lambda task: TransportLearner(task, Polynomial, own_codes=True),
    **{
        f"transport {kind}": lambda task, new=new: TransportLearner(task, new)
        for kind, new in APPROXIMATORS.items()
        if kind != "none"
    },
    **{
        f"{engine.__name__} {e} codes": lambda task, engine=engine, e=e: engine(task, None, estimator=e)
        for engine in (scenes.compressed, scenes.sequential)
        for e in ("qr", "tls", "ml")
    },
    **{
        f"{engine.__name__} {e} {readout}": lambda task, engine=engine, e=e, readout=readout: engine(
            task, estimator=e, readout=readout
        )
        for engine in (scenes.compressed, scenes.sequential)
        for e in ("qr", "tls")
        for readout in ("mean", "pooled")
    },
    "compressed ml mean": lambda task: scenes.compressed(task, estimator="ml"),
    "compressed bounded": lambda task: scenes.compressed(task, length=12),
    "compressed bounded pooled": lambda task: scenes.compressed(task, length=12, readout="pooled"),
    "compressed bounded polynomial": lambda task: CompressedPipeline(task, None, Polynomial, length=12),
    "compressed polynomial": lambda task: CompressedPipeline(task, None, Polynomial),
    "sequential polynomial": lambda task: SequentialPipeline(task, None, Polynomial, length=30),
    "sequential bounded": lambda task: scenes.sequential(task, length=12, readout="mean"),
    "sequential kaczmarz": lambda task: scenes.sequential(task, readout="kaczmarz", length=6),
}
# Maximum likelihood ends where the relative gain is 1e-14: √1e-14 of the residuals, here of the parameters.
ROUNDING = 1e-7


@pytest.fixture(params=MAKERS)
def new(request, cases):
    """Makes an untaught learner of planar motions, always of the same kind."""
    make = MAKERS[request.param]
    return lambda: make(cases["planar"].task)


@pytest.fixture
def scene(cases, rng):
    return scenes.make_scene(cases["planar"], rng, 26, 2, noise=0.2, lost=0.02)


def assert_rows_close(one, other, rtol):
    np.testing.assert_array_equal(np.isnan(one), np.isnan(other))
    known = np.isfinite(other).all(axis=(1, 2, 3))
    assert known.any()
    size = np.linalg.norm(other[known], axis=-1, keepdims=True)
    assert (np.abs(one[known] - other[known]) / size).max() <= rtol


def test_before_any_data_everything_is_refused(new, scene):
    learner = new()
    codes = scenes.stereo_codes(scene.tracks)
    answer = learner.parameters(codes)
    assert answer.rows.shape == (len(codes), 2, 3, 5)
    assert np.isnan(answer.rows).all()
    np.testing.assert_array_equal(answer.support, 0.0)
    assert np.isnan(learner.condition(codes[0]))
    assert learner.noise is None
    assert learner.losses == ()


def test_after_one_frame_nothing_is_known(new, scene):
    learner = new()
    learner.partial_fit(scene.tracks.select_frames(0, 1))
    answer = learner.parameters(scenes.stereo_codes(scene.tracks))
    assert np.isnan(answer.rows).all()
    assert not answer.support.any()


def test_blocks_teach_what_all_at_once_does(new, scene):
    at_once, in_blocks = new(), new()
    at_once.partial_fit(scene.tracks)
    codes = scenes.stereo_codes(scene.tracks)
    for block in scenes.blocks(scene.tracks, [1, 4, 12, 9]):
        in_blocks.partial_fit(block)
        in_blocks.parameters(codes[:3])
    one, other = in_blocks.parameters(codes), at_once.parameters(codes)
    np.testing.assert_allclose(one.support, other.support, rtol=1e6 * EPS)
    assert_rows_close(one.rows, other.rows, ROUNDING)
    assert in_blocks.losses == at_once.losses


def test_asking_changes_nothing(new, scene):
    learner = new()
    learner.partial_fit(scene.tracks)
    codes = scenes.stereo_codes(scene.tracks)
    first = learner.parameters(codes)
    kept = first.rows.copy()
    first.rows[...] = first.support[...] = 0.0
    np.testing.assert_array_equal(learner.parameters(codes).rows, kept)


def test_a_saved_learner_answers_the_same(new, scene):
    learner, restored = new(), new()
    for block in scenes.blocks(scene.tracks, [10, 16]):
        learner.partial_fit(block)
    file = io.BytesIO()
    np.savez(file, **learner.state())
    file.seek(0)
    with np.load(file, allow_pickle=False) as state:
        restored.restore(dict(state))
    codes = scenes.stereo_codes(scene.tracks)
    one, other = restored.parameters(codes), learner.parameters(codes)
    np.testing.assert_allclose(one.support, other.support, rtol=1e6 * EPS)
    assert_rows_close(one.rows, other.rows, ROUNDING)
    assert restored.noise == learner.noise


def test_a_saved_learner_tells_its_condition_and_losses(new, scene, request):
    tracks = scene.tracks
    learner, restored = new(), new()
    learner.partial_fit(tracks)
    restored.restore(learner.state())
    code = scenes.stereo_codes(tracks)[0]
    assert np.isfinite(learner.condition(code))
    np.testing.assert_allclose(restored.condition(code), learner.condition(code), rtol=1e-6)
    assert restored.losses == learner.losses


def test_a_saved_learner_learns_on(new, scene):
    learner, restored = new(), new()
    first, then = scenes.blocks(scene.tracks, [16, 10])
    learner.partial_fit(first)
    restored.restore(learner.state())
    for each in (learner, restored):
        each.partial_fit(then)
    codes = scenes.stereo_codes(scene.tracks)
    assert_rows_close(restored.parameters(codes).rows, learner.parameters(codes).rows, ROUNDING)


def test_an_untaught_learner_can_be_saved(new, scene, request):
    restored = new()
    restored.restore(new().state())
    assert np.isnan(restored.parameters(scenes.stereo_codes(scene.tracks)).rows).all()


def test_far_codes_are_refused(new, scene):
    learner = new()
    learner.partial_fit(scene.tracks)
    answer = learner.parameters(scenes.stereo_codes(scene.tracks) + 1e5)
    assert np.isnan(answer.rows).all()


def test_no_codes_no_answers(new, scene):
    learner = new()
    learner.partial_fit(scene.tracks)
    assert learner.parameters(np.zeros((0, 4))).rows.shape == (0, 2, 3, 5)


def test_the_tracks_are_not_changed(new, scene):
    kept = [np.array(a) for a in (scene.tracks.pixels, scene.tracks.E_S_from_W, scene.tracks.frame)]
    learner = new()
    learner.partial_fit(scene.tracks)
    learner.parameters(scenes.stereo_codes(scene.tracks))
    for before, after in zip(
        kept, (scene.tracks.pixels, scene.tracks.E_S_from_W, scene.tracks.frame), strict=True
    ):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("readout", ["kaczmarz", "pooled"])
def test_maximum_likelihood_has_no_factors_to_read_out(readout, cases):
    with pytest.raises(ValueError, match="readout"):
        scenes.sequential(cases["planar"].task, readout=readout, estimator="ml")
