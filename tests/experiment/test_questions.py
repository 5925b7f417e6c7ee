"""What is asked: never about what was learned, and about all that can be asked."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.data import Tracks
from vmf.data.tracks import from_dense
from vmf.errors import InputError
from vmf.experiment import protocols
from vmf.spec import Spec


def first_view(spec, tracks):
    return protocols.first_view(tracks, protocols.least_targets(spec))


def make_spec(**evaluate: Any) -> Spec:
    return Spec.model_validate(
        {"task": "six_dof", "data": {"simulate": {"frames": 50}}, "evaluate": evaluate}
    )


def tracks_seen(seen: np.ndarray) -> Tracks:
    """Tracks whose visibility (N, K, 2) by camera is given; a pixel says frame and target."""
    n, k, _ = seen.shape
    frame, target = np.meshgrid(np.arange(n), np.arange(k), indexing="ij")
    pixels = np.stack([frame, target, frame + 0.5, target], axis=-1).astype(float)
    pixels[np.repeat(~seen, 2, axis=-1)] = np.nan
    return from_dense(np.arange(n), np.broadcast_to(np.eye(4), (n, 4, 4)), pixels)


@given(st.integers(2, 300), st.integers(2, 12))
def test_folds_are_contiguous_disjoint_and_cover_all(n: int, k: int) -> None:
    folds = protocols.folds(make_spec(folds=k), n)
    assert len(folds) == k
    np.testing.assert_array_equal(np.concatenate([fold.test for fold in folds]), np.arange(n))
    for fold in folds:
        assert (np.diff(fold.test) == 1).all()
        np.testing.assert_array_equal(np.sort(np.concatenate([fold.train, fold.test])), np.arange(n))
        assert (np.diff(fold.train) > 0).all()
    sizes = [len(fold.test) for fold in folds]
    assert max(sizes) - min(sizes) <= 1


@given(st.integers(2, 300), st.floats(0.01, 0.99))
def test_a_single_block_is_what_comes_later(n: int, fraction: float) -> None:
    (fold,) = protocols.folds(make_spec(train_fraction=fraction), n)
    assert abs(len(fold.train) - fraction * n) <= 0.5
    np.testing.assert_array_equal(np.concatenate([fold.train, fold.test]), np.arange(n))


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(1, 9), min_size=1, max_size=3, unique=True),
    st.integers(1, 4),
)
def test_held_out_pairs_are_all_those_inside_the_block_with_enough_shared(
    seed: int, gaps: list[int], least: int
) -> None:
    rng = np.random.default_rng(seed)
    seen = rng.random((24, 5, 2)) < 0.7
    tracks = tracks_seen(seen)
    first, last = sorted(rng.choice(25, 2, replace=False))
    block = np.arange(first, last)
    spec = make_spec(gaps=gaps, min_targets=least)
    found = {}
    for asked in protocols.held_out_pairs(spec, tracks, block, fold=2):
        assert asked.protocol == "held_out"
        (case,) = set(asked.case)
        gap = int(str(case).removeprefix("gap="))
        assert asked.trial == 2 * len(gaps) + gaps.index(gap)
        for q, second in enumerate(asked.frame.tolist()):
            known = np.isfinite(asked.query.initial[q]).all(axis=-1)
            shared = set(asked.query.initial[q][known, 1].astype(int).tolist())
            assert set(asked.query.initial[q][known, 0]) == {float(second - gap)}
            found[gap, second - gap] = shared
            desired = asked.query.desired[q][known]
            assert set(desired[np.isfinite(desired[:, 0]), 0]) <= {float(second)}
    expected = {}
    for gap in gaps:
        for i in range(first, last - gap):
            shared = {k for k in range(5) if seen[i, k].all() and seen[i + gap, k].any()}
            if len(shared) >= least:
                expected[gap, i] = shared
    assert found == expected


def test_no_question_leaves_the_block_that_was_held_out() -> None:
    tracks = tracks_seen(np.ones((40, 4, 2), bool))
    spec = make_spec(folds=4, gaps=[3])
    for number, fold in enumerate(protocols.folds(spec, 40)):
        (asked,) = protocols.held_out_pairs(spec, tracks, fold.test, number)
        assert len(asked.query) == 10 - 3
        touched = np.concatenate([asked.query.initial[:, 0, 0], asked.query.desired[:, 0, 0]])
        assert not np.isin(touched, fold.train).any()


def test_checkpoints_are_the_specs_or_the_last_frame() -> None:
    assert protocols.checkpoints(make_spec(), 50) == (50,)
    assert protocols.checkpoints(make_spec(checkpoints=[50, 2, 7, 7]), 50) == (2, 7, 50)
    for bad in (1, 51):
        with pytest.raises(InputError, match=rf"evaluate\.checkpoints: found {bad}, .* from 2 to 50"):
            protocols.checkpoints(make_spec(checkpoints=[10, bad]), 50)


@given(st.integers(2, 3000), st.integers(0, 60))
def test_curves_rise_from_2_to_the_end_through_every_checkpoint(n: int, points: int) -> None:
    spec = make_spec(curve_points=points, checkpoints=[n, 2])
    counts = protocols.curve_frames(spec, n)
    assert (np.diff(counts) > 0).all()
    assert counts[0] == 2
    assert counts[-1] == n
    assert min(points, n - 1) <= len(counts) <= points + 2


@given(st.integers(1, 300), st.integers(0, 60), st.sets(st.integers(2, 300), max_size=3))
def test_who_is_asked_less_is_asked_evenly_and_at_checkpoints(n: int, points: int, chosen: set[int]) -> None:
    frames = np.arange(2, 2 + n)
    which = protocols.thinned(frames, points, tuple(chosen))
    assert (np.diff(which) > 0).all()
    assert set(frames[which]) >= chosen & set(frames)
    assert min(points, n) <= len(which) <= min(points, n) + len(chosen)
    assert frames[-1] in frames[protocols.thinned(frames, points, None)]
    if points > 1:
        # No gap is longer than an even one, rounded up.
        assert np.diff(which).max(initial=0) <= -(-(n - 1) // (points - 1))


@given(st.integers(2, 3000), st.integers(0, 60), st.integers(0, 100), st.sampled_from(["geometric", "even"]))
def test_the_last_frames_are_asked_beside_an_unchanged_curve(
    n: int, points: int, last: int, how: str
) -> None:
    without, with_last = (
        protocols.curve_frames(make_spec(curve_points=points, curve_spacing=how, curve_last=k), n)
        for k in (0, last)
    )
    np.testing.assert_array_equal(with_last, np.union1d(without, np.arange(max(2, n - last + 1), n + 1)))


@given(st.integers(1, 300), st.integers(0, 60), st.integers(1, 100))
def test_who_is_asked_less_is_asked_after_the_last_frames_too(n: int, points: int, last: int) -> None:
    frames = np.arange(2, 2 + n)
    chosen = set(frames[protocols.thinned(frames, points, None, last)].tolist())
    dense = set(frames[max(0, n - last) :].tolist())
    assert dense <= chosen
    assert len(chosen - dense) == min(points, n - len(dense))


def test_as_many_curve_points_as_frames_are_every_frame() -> None:
    counts = protocols.curve_frames(make_spec(curve_points=30, checkpoints=[30]), 30)
    np.testing.assert_array_equal(counts, np.arange(2, 31))


def test_the_first_view_is_the_first_that_shows_enough_in_both_cameras() -> None:
    seen = np.zeros((5, 6, 2), bool)
    seen[0, :, 0] = True
    seen[1, :3] = True
    seen[2, [1, 3, 4, 5]] = True
    seen[3] = True
    view = first_view(make_spec(), tracks_seen(seen))
    assert view is not None
    assert view.frame == 2
    np.testing.assert_array_equal(view.targets, [1, 3, 4, 5])
    np.testing.assert_array_equal(view.codes[:, 0], [2.0] * 4)
    np.testing.assert_array_equal(view.codes[:, 1], [1, 3, 4, 5])
    np.testing.assert_array_equal(np.isnan(view.pixels), np.repeat(~seen[:, [1, 3, 4, 5]], 2, axis=-1))
    assert first_view(make_spec(min_targets=7), tracks_seen(seen)) is None
    relaxed = first_view(make_spec(min_targets=3), tracks_seen(seen))
    assert relaxed is not None
    assert relaxed.frame == 1


def test_trained_code_asks_from_the_first_view_to_the_newest() -> None:
    tracks = tracks_seen(np.ones((9, 4, 2), bool))
    view = first_view(make_spec(), tracks)
    assert view is not None
    counts = protocols.askable(make_spec(), view, np.arange(1, 10))
    np.testing.assert_array_equal(counts, np.arange(2, 10))
    E = np.tile(np.eye(4), (9, 1, 1))
    E[:, 0, 3] = np.arange(9)
    asked = protocols.trained_code_questions(view, counts, E)
    np.testing.assert_array_equal(asked.query.initial[:, 0, 0], np.zeros(8))
    np.testing.assert_array_equal(asked.query.desired[:, 0, 0], np.arange(1, 9))
    np.testing.assert_array_equal(asked.query.truth[:, 0, 3], np.arange(1, 9))
    assert list(asked.case) == [f"frame={count}" for count in range(2, 10)]


def test_a_newest_view_that_lost_its_targets_is_not_asked_about() -> None:
    seen = np.ones((6, 4, 2), bool)
    seen[3, 0] = False
    tracks = tracks_seen(seen)
    view = first_view(make_spec(), tracks)
    assert view is not None
    np.testing.assert_array_equal(protocols.askable(make_spec(), view, np.arange(2, 7)), [2, 3, 5, 6])
