"""The largest images that are accepted are tracked in bounded memory, as exactly as small ones."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from films import shot
from scipy.spatial import cKDTree

from vmf.data.images.raw import MAX_PIXELS
from vmf.track import chessboard, features
from vmf.track.base import Image
from vmf.track.blobs import conspicuous
from vmf.track.colour_histogram import to_hsv
from vmf.track.features import FeatureDetector, Features

# What OpenCV's SIFT takes for a pixel: the image doubled, eleven float images of it, three quarters more
# for smaller ones; two cameras at a time must stay far below 2 GiB.
BYTES_A_PIXEL = 4 * 4 * 11 * 4 / 3


@pytest.mark.parametrize("size", [(8192, 4096), (MAX_PIXELS, 1), (1920, 1080), (2**21, 2)])
def test_no_piece_of_an_image_takes_much_memory_and_together_they_are_all_of_it(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[tuple[int, ...]] = []

    def found(_: FeatureDetector, image: Image) -> tuple[list[object], np.ndarray]:
        shown.append(image.shape)
        return [], np.zeros((0, 128), np.float32)

    monkeypatch.setattr(FeatureDetector, "_found", found)
    width, height = size
    FeatureDetector(10)(np.zeros((height, width), np.uint8))
    assert max(h * w for h, w in shown) * BYTES_A_PIXEL * 2 < 1.2 * 2**30
    assert sum(h * w for h, w in shown) >= width * height


def placed(of: Features) -> np.ndarray:
    """Pixels and directions (n, 4): one point may be a feature in two directions."""
    return np.column_stack([of.pixels, np.cos(of.directions), np.sin(of.directions)])


def test_features_found_piece_by_piece_are_those_of_the_whole_image(monkeypatch: pytest.MonkeyPatch) -> None:
    left, _ = shot("sift").frame(0, False)
    most = 150
    whole = FeatureDetector(most)(left)
    monkeypatch.setattr(features, "_MOST_PIXELS", left.size - 1)
    monkeypatch.setattr(features, "_TILE_PX", 250)
    pieces = FeatureDetector(most)(left)
    assert len(pieces.pixels) == most
    # Octaves begin at another pixel, and large features reach beyond what is shown beside a piece.
    small = whole.sizes < 12
    off, which = cKDTree(placed(pieces)).query(placed(whole)[small])
    same = off < 0.1
    assert same.mean() > 0.95
    apart = np.linalg.norm(whole.descriptors[small][same] - pieces.descriptors[which[same]], axis=1)
    # Descriptors have the length 512.
    assert np.quantile(apart, 0.9) < 50


def test_a_board_in_a_large_image_is_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    of = shot("chessboard")
    image, _ = of.frame(0, False)
    true = np.asarray(of.film.tracks.pixels[of.film.tracks.frame == 0][:, :2])
    large = np.asarray(cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC), np.uint8)
    monkeypatch.setattr(chessboard, "_MOST_PIXELS", image.size)
    found = chessboard._detected(large, (9, 6))
    assert found is not None
    # Middles of pixels, from the large image to the small one.
    off = cKDTree((found + 0.5) / 2 - 0.5).query(true[np.isfinite(true).all(axis=1)])[0]
    assert np.median(off) <= 0.3
    assert off.max() < 1.0


def test_blobs_of_a_large_image_are_where_they_are_in_a_small_one() -> None:
    rng = np.random.default_rng(0)
    image = np.full((1080, 1920, 3), 120, np.uint8)
    places = [(200, 300), (900, 500), (1500, 800)]
    for (x, y), colour in zip(places, [(200, 30, 30), (30, 200, 30), (30, 30, 200)], strict=True):
        cv2.circle(image, (x, y), int(rng.integers(20, 40)), colour, -1)
    small = list(conspicuous(to_hsv(image)))
    large = list(conspicuous(to_hsv(cv2.resize(image, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST))))
    assert len(small) == len(places)
    assert large == [(4 * x, 4 * y, 4 * w, 4 * h) for x, y, w, h in small]
