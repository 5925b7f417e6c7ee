"""The update map against a count pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from error_tables import stereo_pixels

from vmf.report import update_counts, update_map


def brute_force(points: np.ndarray, size: tuple[int, int], tile: float, overlays: int) -> np.ndarray:
    width, height = size
    counts = np.zeros((height, width), dtype=int)
    for x, y in points:
        for k in range(overlays):
            shift = k * tile / overlays
            for v in range(height):
                for u in range(width):
                    same_column = np.floor((u - shift) / tile) == np.floor((x - shift) / tile)
                    same_row = np.floor((v - shift) / tile) == np.floor((y - shift) / tile)
                    counts[v, u] += bool(same_column and same_row)
    return counts


@pytest.mark.parametrize(("tile", "overlays"), [(4.0, 4), (5.0, 2), (6.5, 3), (1.0, 1)])
def test_counts_equal_brute_force(tile: float, overlays: int) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-8, 30, (12, 2))
    np.testing.assert_array_equal(
        update_counts(points, (20, 13), tile, overlays), brute_force(points, (20, 13), tile, overlays)
    )


def test_a_point_updates_as_many_tiles_as_there_are_overlays() -> None:
    counts = update_counts([[100.0, 60.0]], (320, 240), 32)
    assert counts[60, 100] == counts.max() == 32
    assert counts.sum() == 32 * 32 * 32
    assert counts[60 - 32, 100] == counts[60, 100 + 32] == 0


def test_both_images_share_a_scale_and_only_stereo_points_count() -> None:
    pixels = stereo_pixels(200)
    figure = update_map(pixels, (640, 480), 32)
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    left, right = figure.axes[:2]
    for ax, columns in ((left, slice(0, 2)), (right, slice(2, 4))):
        shown = np.asarray(ax.images[0].get_array())
        np.testing.assert_array_equal(shown, update_counts(seen[:, columns], (640, 480), 32))
        assert ax.get_ylim()[0] > ax.get_ylim()[1]
        assert ax.get_aspect() == 1.0
        assert "(px)" in ax.get_xlabel()
        assert "(px)" in ax.get_ylabel()
    assert left.images[0].get_clim() == right.images[0].get_clim()
    bar = right.child_axes[0]
    assert "(updates)" in bar.get_ylabel()


def test_without_stereo_points_it_says_so() -> None:
    figure = update_map(np.full((3, 4), np.nan), (64, 48), 8)
    assert "no tile was updated" in " ".join(t.get_text().replace("\n", " ") for t in figure.texts)
