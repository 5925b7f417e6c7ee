"""What every approximator promises: one suite over the whole registry."""

from __future__ import annotations

import io

import numpy as np
import pytest

from vmf.approximate import APPROXIMATORS, make_approximator
from vmf.approximate.kaczmarz import TRAININGS

EPS = np.finfo(float).eps
WIDTH = 7
# Variants worth a run of their own; a newly registered approximator is tested with its defaults.
VARIANTS = {
    "cmac": [{}, {"overlays": 5, "tile_px": 40.0, "displacement": "uniform", "step": 0.7, "epochs": 3}],
    "cmac_linear": [{}, {"overlays": 5, "tile_px": 90.0, "displacement": "diagonal", "epochs": 1}],
    "cmac_multires": [{}, {"tiles_px": (200.0, 40.0), "min_visits": 1.0, "min_trained": 0.1, "overlays": 5}],
    "knn": [{}, {"neighbours": 200, "averaging": "uniform", "radius_px": 200.0}],
    "lwr": [{}, {"neighbours": 10, "bandwidth_px": 30.0, "ridge_px": 1.0}],
    "rbf": [{}, {"width_px": 50.0, "smoothing": 0.1}],
    "polynomial": [{}, {"degree": 1}, {"degree": 3}],
}
VARIANTS["cmac"] += [{"new_tiles": "first_visit"}]
VARIANTS["cmac"] += [{"training": training, "window": 3} for training in TRAININGS if training != "albus"]
SUITE = [(kind, options) for kind in APPROXIMATORS for options in VARIANTS.get(kind, [{}])]
SUMS_ROWS = 100 * EPS


@pytest.fixture(params=SUITE, ids=[f"{kind}-{'-'.join(map(str, o.values()))}" for kind, o in SUITE])
def new(request):
    """Makes an empty approximator, always of the same kind and options."""
    kind, options = request.param
    return lambda: make_approximator(kind, **options)


@pytest.fixture(params=[kind for kind in APPROXIMATORS if kind != "none"])
def trusting(request):
    """Makes an empty approximator that heeds weights, as all but the table do."""
    return lambda: make_approximator(request.param)


def draw(rng, n=80):
    """Stereo codes (n, 4) of a 640 × 480 rig with noise, and parameters (n, 7) that change with the code."""
    x_L, y = rng.uniform((60.0, 0.0), (639.0, 479.0), (n, 2)).T
    codes = np.stack([x_L, y, x_L - rng.uniform(20.0, 60.0, n), y], axis=1) + rng.normal(size=(n, 4))
    return codes, np.sin(codes @ rng.normal(size=(4, WIDTH)) / 300.0) + rng.normal(size=WIDTH)


def assert_same(one, other):
    np.testing.assert_array_equal(one.parameters, other.parameters)
    np.testing.assert_array_equal(one.support, other.support)


def assert_close(one, other):
    """Equal but for the order in which at most a few hundred products were summed."""
    np.testing.assert_array_equal(one.refused, other.refused)
    size = np.nanmax(np.abs(other.parameters))
    np.testing.assert_allclose(one.parameters, other.parameters, rtol=0, atol=1e4 * SUMS_ROWS * size)
    np.testing.assert_allclose(one.support, other.support, rtol=1e4 * SUMS_ROWS)


def test_before_learning_everything_is_refused(new, rng):
    codes, _ = draw(rng)
    prediction = new().predict(codes)
    assert prediction.refused.all()
    np.testing.assert_array_equal(prediction.support, 0.0)


def test_no_pairs_teach_nothing(new, rng):
    codes, theta = draw(rng)
    approximator, taught = new(), new()
    approximator.partial_fit(codes[:0], theta[:0])
    assert approximator.predict(codes).refused.all()
    taught.partial_fit(codes, theta)
    approximator.partial_fit(codes, theta)
    assert_same(approximator.predict(codes), taught.predict(codes))


def test_visited_codes_are_answered(new, rng):
    codes, theta = draw(rng)
    approximator = new()
    approximator.partial_fit(codes, theta)
    prediction = approximator.predict(codes)
    assert prediction.parameters.shape == theta.shape
    assert not prediction.refused.any()
    assert (prediction.support > 0.0).all()


def test_codes_far_from_all_data_are_refused_not_zero(new, rng):
    codes, theta = draw(rng)
    approximator = new()
    approximator.partial_fit(codes, theta)
    for far in (codes + 1e5, codes - 1e5, codes * [1.0, 1.0, 1.0, -50.0]):
        assert np.isnan(approximator.predict(far).parameters).all()


def test_inputs_are_neither_kept_nor_changed(new, rng):
    codes, theta = draw(rng)
    approximator, reference = new(), new()
    reference.partial_fit(codes, theta)
    mine = codes.copy(), theta.copy(), np.ones(len(codes))
    approximator.partial_fit(*mine)
    np.testing.assert_array_equal(mine[0], codes)
    np.testing.assert_array_equal(mine[1], theta)
    np.testing.assert_array_equal(mine[2], 1.0)
    for array in mine:
        array[...] = -7.0
    assert_same(approximator.predict(codes), reference.predict(codes))


def test_answers_and_states_are_the_callers_to_change(new, rng):
    codes, theta = draw(rng)
    approximator, reference, restored = new(), new(), new()
    for a in (approximator, reference):
        a.partial_fit(codes, theta)
    answer = approximator.predict(codes)
    answer.parameters[...] = answer.support[...] = 0.0
    state = approximator.state()
    restored.restore(state)
    for array in state.values():
        array[...] = 0
    assert_same(approximator.predict(codes), reference.predict(codes))
    assert_same(restored.predict(codes), reference.predict(codes))


def test_a_saved_approximator_answers_and_learns_on_bit_by_bit(new, rng):
    codes, theta = draw(rng, 120)
    original, restored = new(), new()
    original.partial_fit(codes[:80], theta[:80])
    file = io.BytesIO()
    np.savez(file, **original.state())
    file.seek(0)
    with np.load(file, allow_pickle=False) as state:
        restored.restore(dict(state))
    assert_same(restored.predict(codes), original.predict(codes))
    for a in (original, restored):
        a.partial_fit(codes[60:], theta[60:], np.linspace(0.2, 1.0, 60))
    assert_same(restored.predict(codes), original.predict(codes))
    assert {k: v.tolist() for k, v in original.state().items()} == {
        k: v.tolist() for k, v in restored.state().items()
    }


def test_an_untaught_approximator_can_be_saved(new, rng, request):
    codes, theta = draw(rng)
    restored, fresh = new(), new()
    restored.restore(new().state())
    assert restored.predict(codes).refused.all()
    for a in (restored, fresh):
        a.partial_fit(codes, theta)
    assert_same(restored.predict(codes), fresh.predict(codes))


def test_a_batch_is_answered_as_one_code_at_a_time(new, rng):
    codes, theta = draw(rng)
    approximator = new()
    approximator.partial_fit(codes[:60], theta[:60])
    batch = approximator.predict(codes)
    for i, code in enumerate(codes):
        one = approximator.predict(code[None])
        assert one.refused[0] == batch.refused[i]
        size = np.nanmax(np.abs(batch.parameters))
        if not one.refused[0]:
            np.testing.assert_allclose(
                one.parameters[0], batch.parameters[i], rtol=0, atol=1e4 * SUMS_ROWS * size
            )
        np.testing.assert_allclose(one.support[0], batch.support[i], rtol=1e4 * SUMS_ROWS)


def test_no_code_asked_no_answer_given(new, rng):
    codes, theta = draw(rng)
    approximator = new()
    approximator.partial_fit(codes, theta)
    assert approximator.predict(codes[:0]).parameters.shape == (0, WIDTH)


def test_no_weights_are_weights_of_one(new, rng):
    codes, theta = draw(rng)
    plain, weighted = new(), new()
    plain.partial_fit(codes, theta)
    weighted.partial_fit(codes, theta, np.ones(len(codes)))
    assert_same(plain.predict(codes), weighted.predict(codes))


# Passes are over the pairs of a block, and so are draws: promised of one pass in order alone.
IN_BLOCKS = [(kind, {"epochs": 1} if kind.startswith("cmac") else {}) for kind in APPROXIMATORS]
IN_BLOCKS += [("cmac", {"training": training}) for training, t in TRAININGS.items() if t.remembers]


@pytest.mark.parametrize("options", IN_BLOCKS, ids=lambda o: "-".join([o[0], *map(str, o[1].values())]))
@pytest.mark.parametrize("sizes", [[80], [1] * 80, [3, 40, 0, 37]], ids=["once", "singly", "blocks"])
def test_learning_in_blocks_is_learning_at_once(options, sizes, rng):
    """To the bit, but for least squares, which sum in another order."""
    kind, more = options
    codes, theta = draw(rng)
    weights = rng.uniform(0.1, 1.0, len(codes))
    at_once, in_blocks = make_approximator(kind, **more), make_approximator(kind, **more)
    at_once.partial_fit(codes, theta, weights)
    ends = np.cumsum(sizes)
    for begin, end in zip(ends - sizes, ends, strict=True):
        in_blocks.partial_fit(codes[begin:end], theta[begin:end], weights[begin:end])
    rounds = kind == "polynomial" or more.get("training") == "partial_gram_schmidt"
    same = assert_close if rounds else assert_same
    same(in_blocks.predict(codes + 0.25), at_once.predict(codes + 0.25))
    same(in_blocks.predict(codes), at_once.predict(codes))


def test_a_pair_of_no_weight_was_never_seen(trusting, rng):
    codes, theta = draw(rng)
    codes[40:] += 5000.0
    approximator = trusting()
    approximator.partial_fit(codes, theta, np.repeat([1.0, 0.0], 40))
    assert not approximator.predict(codes[:40]).refused.any()
    assert approximator.predict(codes[40:]).refused.all()


def test_a_smaller_weight_moves_an_answer_less(trusting, rng):
    """A pair that contradicts 80 others changes the answer at its code the more, the more it is trusted."""
    codes, theta = draw(rng)
    moved = []
    for weight in (0.01, 0.1, 1.0):
        approximator = trusting()
        approximator.partial_fit(codes, theta)
        before = approximator.predict(codes[:1]).parameters
        approximator.partial_fit(codes[:1], theta[:1] + 10.0, np.array([weight]))
        moved.append(np.linalg.norm(approximator.predict(codes[:1]).parameters - before))
    assert 0.0 < moved[0] < moved[1] < moved[2]
