"""Counting of stereo codes against points thrown into the plane, tiles against all pixels (§4.1, §5.1)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vmf.approximate import Tiling
from vmf.spec.studies import ImageSize, LineCamera, LineRig, StereoCodesStudy
from vmf.study import carry_out
from vmf.study.stereo_codes import (
    line_pixels,
    parallel_codes,
    visible_codes,
    visible_region,
)

SETTINGS = StereoCodesStudy()


def pixel_of(
    camera: LineCamera, points: NDArray[np.float64], settings: StereoCodesStudy
) -> NDArray[np.int64]:
    """Pixels (n,) of points by projection, −1 out of view: written apart from the wedges."""
    heading = np.radians(camera.heading_deg)
    ahead = np.array([np.cos(heading), np.sin(heading)])
    right = np.array([np.sin(heading), -np.cos(heading)])
    d = points - [camera.x_m, camera.z_m]
    depth = d @ ahead
    half = np.tan(np.radians(settings.field_of_view_deg) / 2)
    place = (d @ right / np.where(depth > 0, depth, np.nan) / half + 1) / 2 * settings.pixels
    return np.where((place > 0) & (place < settings.pixels), np.floor(place), -1).astype(int)


def thrown(rig: LineRig, settings: StereoCodesStudy, n: int) -> NDArray[np.bool_]:
    """Codes that random points have, near and far."""
    rng = np.random.default_rng(5)
    angle, distance = rng.uniform(0, 2 * np.pi, n), 10 ** rng.uniform(-3, 4, n)
    points = distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    left, right = (pixel_of(camera, points, settings) for camera in (rig.left, rig.right))
    seen = np.zeros((settings.pixels,) * 2, bool)
    both = (left >= 0) & (right >= 0)
    seen[left[both], right[both]] = True
    return seen


@pytest.mark.parametrize(("place", "count"), [(0, 4), (1, 10), (2, 16)], ids=["4.1", "4.2", "4.3"])
def test_the_rigs_of_the_thesis_see_as_many_codes_as_it_says(place: int, count: int) -> None:
    rig = SETTINGS.rigs[place]
    codes = visible_codes(*line_pixels(rig, SETTINGS))
    assert codes.sum() == count
    np.testing.assert_array_equal(codes, thrown(rig, SETTINGS, 400_000))


cameras = st.builds(LineCamera, x_m=st.floats(-1, 1), z_m=st.floats(-1, 1), heading_deg=st.floats(-170, 180))


@given(cameras, cameras, st.integers(1, 5), st.floats(10, 170))
def test_no_point_ever_has_a_code_that_is_said_to_be_invisible(
    left: LineCamera, right: LineCamera, pixels: int, angle: float
) -> None:
    settings = StereoCodesStudy(pixels=pixels, field_of_view_deg=angle)
    rig = LineRig(name="any", left=left, right=right)
    codes = visible_codes(*line_pixels(rig, settings))
    assert not (thrown(rig, settings, 20_000) & ~codes).any()


@pytest.mark.parametrize("rig", SETTINGS.rigs, ids=lambda rig: rig.name)
def test_drawn_regions_are_seen_by_their_pixels_and_cover_what_both_cameras_see(rig: LineRig) -> None:
    pixels = line_pixels(rig, SETTINGS)
    codes = visible_codes(*pixels)
    view = np.array([[-50.0, -1.0], [50.0, -1.0], [50.0, 100.0], [-50.0, 100.0]])
    for i, j in np.ndindex(codes.shape):
        corners = visible_region(*pixels, i, j, view)
        if not codes[i, j]:
            # At most a line that two pixels share.
            x, y = corners.T
            assert abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) < 1e-6
            continue
        middle = corners.mean(axis=0)[None]
        found = [int(pixel_of(c, middle, SETTINGS)[0]) for c in (rig.left, rig.right)]
        assert found == [i, j]


@pytest.mark.parametrize("pixels", [1, 2, 5, 8])
def test_a_translated_camera_sees_the_codes_of_a_parallel_rig(pixels: int) -> None:
    settings = StereoCodesStudy(pixels=pixels)
    codes = visible_codes(*line_pixels(SETTINGS.rigs[1], settings))
    # Pixel i of the left row meets the pixels 0…i of the right one.
    np.testing.assert_array_equal(codes, np.tri(pixels, dtype=bool))
    assert codes.sum() == parallel_codes(pixels)


@pytest.mark.parametrize("size", [(40, 24), (33, 17), (7, 5)])
def test_displaced_tiles_are_those_that_some_pixel_touches(size: tuple[int, int]) -> None:
    image = ImageSize(width_px=size[0], height_px=size[1], overlays=8, tile_px=8.0)
    x, y = np.meshgrid(*map(np.arange, size))
    codes = np.stack([x.ravel(), y.ravel(), x.ravel(), y.ravel()], axis=-1).astype(float)
    cells = Tiling(8, 8.0, "diagonal").cells(codes)[..., :2]
    touched = {(k, *cell) for row in cells.tolist() for k, cell in enumerate(row)}
    result = carry_out(StereoCodesStudy(pixels=1, images=(image,)))
    found = {q.quantity: q.value for q in result.quantities}
    assert found["tiles_per_image_displaced"] == len(touched)
    combinations = {tuple(map(tuple, row)) for row in cells.tolist()}
    assert found["tile_combinations"] == len(combinations) == size[0] * size[1]


def test_the_numbers_of_the_thesis() -> None:
    found = {(q.quantity, q.case): q.value for q in carry_out(SETTINGS).quantities}
    assert [found["visible_codes", name] for name in ("identical", "translated", "verged")] == [4, 10, 16]
    assert [found["unused_share", name] for name in ("identical", "translated")] == [0.75, 0.375]
    assert found["codes_bound", "320x240"] == 30_720_000
    assert round(found["codes_bound_share", "320x240"], 2) == 0.52
    assert found["codes_bound_registered", "320x240"] == 24_576_000
    assert found["tiles_per_image", "320x240"] == 2560
    assert found["tiles_per_image", "640x480"] == 9600
    assert found["tile_combinations", "320x240"] == found["image_points", "320x240"] == 76_800
    assert found["tile_combinations", "640x480"] == found["image_points", "640x480"] == 307_200
    assert [found[name, "20x20"] for name in ("image_points", "tiles_per_overlay", "tiles_per_image")] == [
        400,
        25,
        100,
    ]
