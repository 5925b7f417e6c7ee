"""Tracks: selecting and joining frames, and batches of targets."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.data.growing import Growing
from vmf.data.track_log import TrackLog
from vmf.data.tracks import Tracks, from_dense, target_batches

SIZES = st.tuples(st.integers(1, 12), st.integers(0, 6), st.integers(0, 2**32 - 1))


def draw(sizes):
    """Tracks of K targets over N frames and the pixels (N, K, 4) they were made of, a third of them lost."""
    n, k, seed = sizes
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0.0, 640.0, (n, k, 4))
    pixels.reshape(n, k, 2, 2)[rng.random((n, k, 2)) < 0.4] = np.nan
    E = np.tile(np.eye(4), (n, 1, 1))
    E[:, 0, 3] = np.arange(n)
    return from_dense(np.arange(n) * 1_000_000, E, pixels, image_size=(640, 480)), pixels


def spread(tracks):
    """Pixels (N, K, 4) of tracks."""
    pixels = np.full((tracks.n_frames, tracks.n_targets, 4), np.nan)
    pixels[tracks.frame, tracks.target] = tracks.pixels
    return pixels


def assert_equal(one, other):
    for f in fields(Tracks):
        np.testing.assert_array_equal(getattr(one, f.name), getattr(other, f.name), err_msg=f.name)


def assert_sorted(tracks):
    order = np.lexsort((tracks.frame, tracks.target))
    np.testing.assert_array_equal(order, np.arange(len(order)))


@given(sizes=SIZES)
def test_dense_pixels_come_back(sizes):
    tracks, pixels = draw(sizes)
    np.testing.assert_array_equal(spread(tracks), pixels)
    assert_sorted(tracks)
    # A target that neither camera saw is no observation.
    assert len(tracks.frame) == np.isfinite(pixels).any(axis=-1).sum()
    assert tracks.ids == tuple(str(i) for i in range(sizes[1]))


@given(sizes=SIZES, data=st.data())
def test_selected_frames_are_those_frames(sizes, data):
    tracks, pixels = draw(sizes)
    frames = np.array(sorted(data.draw(st.sets(st.integers(0, sizes[0] - 1)))), np.int64)
    part = tracks.select(frames)
    np.testing.assert_array_equal(spread(part), pixels[frames])
    np.testing.assert_array_equal(part.times_ns, tracks.times_ns[frames])
    np.testing.assert_array_equal(part.E_S_from_W, tracks.E_S_from_W[frames])
    assert (part.ids, part.image_size) == (tracks.ids, tracks.image_size)
    assert_sorted(part)


@given(sizes=SIZES, data=st.data())
def test_a_log_of_blocks_is_the_tracks_again(sizes, data):
    tracks, _ = draw(sizes)
    log = TrackLog()
    assert log.tracks is None
    cuts = sorted(data.draw(st.lists(st.integers(0, sizes[0]), max_size=5)))
    for begin, end in pairwise([0, *cuts, sizes[0]]):
        log.append(tracks.select_frames(begin, end))
        kept = log.tracks
        assert_equal(kept, tracks.select_frames(0, end))
        # What was read is the reader's own.
        kept.pixels[...] = 0.0
        log.append(tracks.select_frames(0, 0))
    assert_equal(log.tracks, tracks)


@given(sizes=SIZES)
def test_a_log_is_in_the_order_of_frames(sizes):
    tracks, _ = draw(sizes)
    log = TrackLog()
    for frame in range(sizes[0]):
        places = log.append(tracks.select_frames(frame, frame + 1))
        assert (log.frame.rows[places] == frame).all()
    order = np.lexsort((log.target.rows, log.frame.rows))
    np.testing.assert_array_equal(order, np.arange(len(log.frame)))


@given(rows=st.lists(st.lists(st.integers(-5, 5), max_size=40), max_size=8))
def test_growing_arrays_hold_what_they_were_given(rows):
    growing = Growing((2,), np.int64)
    for block in rows:
        growing.append(np.array([[x, -x] for x in block], np.int64).reshape(-1, 2))
    expected = [x for block in rows for x in block]
    assert len(growing) == len(expected)
    np.testing.assert_array_equal(growing.rows, np.array([[x, -x] for x in expected]).reshape(-1, 2))


def test_frames_beyond_the_last_are_none():
    tracks, _ = draw((5, 2, 1))
    assert_equal(tracks.select_frames(2, 99), tracks.select_frames(2, 5))
    assert tracks.select_frames(5, 9).n_frames == 0


@given(sizes=SIZES, most=st.sampled_from([1, 3, 8, 100]))
def test_batches_hold_every_observation_once(sizes, most):
    tracks, pixels = draw(sizes)
    found = np.full(pixels.shape, np.nan)
    count = np.zeros(pixels.shape[:2], int)
    for batch in target_batches(tracks, most):
        seen = batch.frame >= 0
        assert np.isnan(batch.pixels[~seen]).all()
        # Observations first, in the order of their frames, then the padding; no column of padding alone.
        length = seen.sum(axis=1)
        np.testing.assert_array_equal(seen, np.arange(seen.shape[1]) < length[:, None])
        assert seen.any(axis=0).all()
        assert (np.diff(batch.frame, axis=1)[seen[:, 1:]] > 0).all()
        # Similar lengths: padding at most doubles a track.
        assert length.max() <= 2 * length.min()
        assert len(length) == 1 or batch.frame.size <= most
        which, column = np.nonzero(seen)
        index = batch.frame[which, column], batch.target[which]
        np.add.at(count, index, 1)
        found[index] = batch.pixels[which, column]
    np.testing.assert_array_equal(count, np.isfinite(pixels).any(axis=-1))
    np.testing.assert_array_equal(found, pixels)


def test_tracks_cannot_be_reassigned():
    tracks, _ = draw((3, 2, 0))
    with pytest.raises(AttributeError):
        tracks.pixels = np.zeros((0, 4))
