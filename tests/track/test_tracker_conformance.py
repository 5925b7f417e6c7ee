"""What every tracker must do, whatever it looks for."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from films import RENDERED, SHOWN, compared, followed, followed_anew, shot, tracker

from vmf.spec import TRACKER_MODELS
from vmf.track import TRACKERS, Sightings

# Medians that the trackers must keep to on simulated images, in px.
WITHIN = {"klt": 0.5, "sift": 0.5, "aruco": 0.3, "meanshift": 3.0, "camshift": 3.0, "chessboard": 0.3}
# Sure of its target nine times out of ten and never far off.
MOSTLY = 2.0


def same(a: Sightings, b: Sightings) -> bool:
    return a.ids == b.ids and all(
        np.array_equal(x, y, equal_nan=True) for x, y in ((a.pixels, b.pixels), (a.quality, b.quality))
    )


def test_every_tracker_of_the_spec_is_there() -> None:
    assert list(TRACKERS) == list(TRACKER_MODELS) == list(SHOWN)


@pytest.mark.parametrize("kind", RENDERED)
def test_sightings_are_well_formed(kind: str) -> None:
    of = shot(kind)
    seen = followed(kind, of)
    height, width = of.frames[0][0].shape[:2]
    assert sum(len(s.ids) for s in seen) > 50
    for sightings in seen:
        n = len(sightings.ids)
        assert len(set(sightings.ids)) == n
        assert sightings.pixels.shape == (n, 4)
        assert sightings.quality.shape == (n,)
        assert ((sightings.quality > 0.0) & (sightings.quality <= 1.0)).all()
        left, right = sightings.pixels[:, :2], sightings.pixels[:, 2:]
        for pixels in (left, right):
            found = np.isfinite(pixels)
            assert (found.all(axis=1) | ~found.any(axis=1)).all()
            inside = (pixels >= -0.5) & (pixels <= [width - 0.5, height - 0.5])
            assert inside[found].all()
        assert (np.isfinite(left[:, 0]) | np.isfinite(right[:, 0])).all()


@pytest.mark.parametrize("kind", RENDERED)
def test_tracks_are_near_the_truth(kind: str) -> None:
    of = shot(kind)
    off = compared(kind, of, followed(kind, of)).off_px
    assert len(off) > 100
    assert np.median(off) <= WITHIN[kind]
    assert np.quantile(off, 0.9) <= MOSTLY * WITHIN[kind]


@pytest.mark.parametrize("kind", RENDERED)
def test_a_target_keeps_its_name_as_long_as_it_is_seen(kind: str) -> None:
    """Half of the targets in sight in the middle of the film were there ten frames before."""
    seen = followed(kind, shot(kind))
    kept = set(seen[15].ids) & set(seen[5].ids)
    assert len(kept) >= len(seen[15].ids) / 2


@pytest.mark.parametrize("kind", RENDERED)
def test_the_same_images_give_the_same_tracks(kind: str) -> None:
    frames = range(0, 8)
    a, b = (followed_anew(kind, shot(kind), frames=frames) for _ in range(2))
    assert all(map(same, a, b))


@pytest.mark.parametrize("kind", SHOWN)
def test_the_threads_of_a_tracker_end_with_it(kind: str) -> None:
    before = set(threading.enumerate())
    with tracker(kind) as one:
        assert one._both(abs, (-1, -2)) == (1, 2)
        assert set(threading.enumerate()) > before
    assert set(threading.enumerate()) == before


@pytest.mark.parametrize("kind", RENDERED)
def test_images_are_left_as_they_are(kind: str) -> None:
    of, one = shot(kind), tracker(kind)
    for number in range(3):
        left, right = (image.copy() for image in of.frame(number, one.colour))
        kept = left.copy(), right.copy()
        left.flags.writeable = right.flags.writeable = False
        one.step(left, right)
        np.testing.assert_array_equal(left, kept[0])
        np.testing.assert_array_equal(right, kept[1])


@pytest.mark.parametrize("kind", SHOWN)
@pytest.mark.parametrize("size", [(480, 640), (16, 16), (9, 40)])
def test_nothing_is_seen_in_even_noisy_or_tiny_images(kind: str, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    one = tracker(kind)
    shape = (*size, 3) if one.colour else size
    even = np.full(shape, 100, np.uint8)
    for left, right in ((even, even), (even, np.zeros_like(even))):
        assert one.step(left, right).ids == ()
    # Noise that differs between the images shows nothing twice.
    for _ in range(3):
        left, right = rng.integers(80, 120, (2, *shape)).astype(np.uint8)
        assert len(one.step(left, right).ids) <= 1


@pytest.mark.parametrize("kind", RENDERED)
def test_what_reaches_one_camera_alone_is_not_invented_for_the_other(kind: str) -> None:
    of, one = shot(kind), tracker(kind)
    for number in range(4):
        one.step(*of.frame(number, one.colour))
    left, right = of.frame(4, one.colour)
    seen = one.step(left, np.full_like(right, 90))
    assert np.isnan(seen.pixels[:, 2:]).all()


@pytest.mark.parametrize("kind", SHOWN)
@pytest.mark.parametrize("smaller", [0, 1])
def test_the_cameras_may_have_different_sizes(kind: str, smaller: int) -> None:
    """What both images of different sizes show is seen where it is, in neither beyond the border."""
    if kind not in RENDERED:
        one = tracker(kind)
        images = [np.full((120, 160, 3) if one.colour else (120, 160), 90, np.uint8)] * 2
        images[smaller] = images[smaller][:100, :130]
        assert one.step(*images).ids == ()
        return
    of = shot(kind)
    frames = []
    for pair in of.frames[:8]:
        images = list(pair)
        images[smaller] = images[smaller][:420, :560]
        frames.append(tuple(images))
    cut = replace(of, frames=tuple(frames))
    found = compared(kind, cut, followed(kind, cut))
    assert len(found.off_px) > 10
    assert np.median(found.off_px) <= WITHIN[kind]


@pytest.mark.parametrize("kind", RENDERED)
def test_brightness_may_change(kind: str) -> None:
    """A third less light, then a third more: most of what was seen before is still seen, where it is."""
    of = shot(kind, exposure_drift=0.06)
    off = compared(kind, of, followed(kind, of)).off_px
    assert np.median(off) <= WITHIN[kind]


@pytest.mark.parametrize("kind", RENDERED)
def test_a_lens_may_distort(kind: str) -> None:
    of = shot(kind, frames=12, distortion=(-0.2, 0.05))
    off = compared(kind, of, followed(kind, of)).off_px
    assert len(off) > 30
    assert np.median(off) <= WITHIN[kind]
