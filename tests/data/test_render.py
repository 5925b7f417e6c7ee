"""Simulated images show what the simulation says, to a small fraction of a pixel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from vmf.data.render import Film, film
from vmf.data.simulate import image_stream, simulate, trial_streams
from vmf.errors import InputError
from vmf.geometry import inverse
from vmf.spec import Spec, loads

CLEAN: dict[str, object] = {"blur_px": 0.0, "noise": 0.0}
# An image pixel is drawn two pixels wide, and the place of an edge is uncertain by a quarter of one.
SUBPIXEL = 1 / 8
# OpenCV's own corners are off by as much in images without any blur, however finely they are drawn.
SOFT: dict[str, object] = {"blur_px": 1.0, "noise": 0.0}


def shot(task: str = "six_dof", images: dict[str, object] | None = None, **simulated: Any) -> Film:
    source = {"frames": 6, "targets": 3, "motion": "hand_guided", "rate_hz": 4.0, "seed": 2, **simulated}
    document = {"task": task, "data": {"simulate": {**source, "images": images or {}}}}
    if "mounting" in source:
        document["mounting"] = source.pop("mounting")
        document["data"] = {"simulate": {**source, "images": images or {}}}
    import yaml

    spec: Spec = loads(yaml.safe_dump(document)).spec
    assert spec.data.simulate is not None
    return film(simulate(spec, trial_streams(spec, 0)[0]), spec.data.simulate, image_stream(spec))


def observations(movie: Film) -> list[tuple[int, str, np.ndarray]]:
    t = movie.tracks
    return [(f, t.ids[k], p) for f, k, p in zip(t.frame.tolist(), t.target.tolist(), t.pixels, strict=True)]


def grey(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def corner_errors(movie: Film, clear_px: float = 8.0) -> np.ndarray:
    """How far OpenCV's sub-pixel corners (n, 2) are from the true pixels of a chessboard's."""
    frames = list(movie.frames())
    off = []
    for frame, _, pixels in observations(movie):
        for camera in (0, 1):
            true = pixels[2 * camera : 2 * camera + 2]
            image = grey(frames[frame][camera])
            if not np.isfinite(true).all() or (np.abs(true - np.array(image.shape[::-1]) / 2) > 220).any():
                continue
            start = true.astype(np.float32).reshape(1, 1, 2).copy()
            window = (int(clear_px) // 2, int(clear_px) // 2)
            found = cv2.cornerSubPix(image, start, window, (-1, -1), (3, 50, 1e-4))
            off.append(found[0, 0] - true)
    return np.array(off)


@pytest.mark.parametrize("task", ["six_dof", "translation"])
def test_corners_are_where_the_truth_says(task: str) -> None:
    movie = shot(task, {"targets": "chessboard", "size_m": 0.6, "background": "plain", **SOFT}, targets=1)
    off = corner_errors(movie)
    assert len(off) > 200
    assert np.quantile(np.abs(off), 0.95) < SUBPIXEL
    assert np.median(np.abs(off)) < SUBPIXEL / 2
    # No part of a pixel is lost anywhere: half a pixel's shift would show here.
    assert np.abs(np.median(off, axis=0)).max() < SUBPIXEL / 8


@pytest.mark.parametrize("distortion", [(-0.25, 0.08), (0.15, 0.0)])
def test_corners_are_where_the_lens_puts_them(distortion: tuple[float, float]) -> None:
    images = {"targets": "chessboard", "size_m": 0.6, "background": "plain", "distortion": list(distortion)}
    movie = shot("six_dof", {**images, **CLEAN}, targets=1)
    off = corner_errors(movie)
    assert np.median(np.abs(off)) < SUBPIXEL / 2
    straight = shot("six_dof", {**images, **CLEAN, "distortion": [0.0, 0.0]}, targets=1)
    ideal = {(f, i): p for f, i, p in observations(straight)}
    moved = [p - ideal[f, i] for f, i, p in observations(movie) if (f, i) in ideal]
    assert np.nanmax(np.abs(moved)) > 1.0, "the lens does nothing"
    # Brown's radial model, as OpenCV projects it.
    K, (k1, k2) = movie.lens.K, distortion
    for frame, name, pixels in observations(movie)[::17]:
        xy = (ideal[frame, name][:2] - K[:2, 2]) / np.diag(K)[:2]
        expected, _ = cv2.projectPoints(
            np.append(xy, 1.0)[None], np.zeros(3), np.zeros(3), K, np.array([k1, k2, 0.0, 0.0])
        )
        np.testing.assert_allclose(pixels[:2], expected[0, 0], atol=1e-9)


@pytest.mark.parametrize("distortion", [(-0.25, 0.08), (0.15, 0.0), (-0.1, 0.0)])
def test_a_lens_and_its_inverse_cancel(distortion: tuple[float, float]) -> None:
    movie = shot("six_dof", {"distortion": list(distortion)})
    pixels = np.random.default_rng(0).uniform(0, [640, 480], (200, 2))
    np.testing.assert_allclose(movie.lens.distorted(movie.lens.ideal(pixels)), pixels, atol=1e-6)


def test_a_lens_that_folds_the_image_is_refused() -> None:
    movie = shot("six_dof", {"distortion": [-2.0, 0.0]})
    with pytest.raises(InputError, match=r"data.simulate.images.distortion: found -2, 0; .* are accepted"):
        next(movie.frames())


@pytest.mark.parametrize(
    ("task", "mounting"),
    [
        ("six_dof", "eye_in_hand"),
        ("pan_tilt", "eye_in_hand"),
        ("planar", "eye_in_hand"),
        ("six_dof", "eye_to_hand"),
    ],
)
def test_blobs_are_where_the_truth_says_in_every_task(task: str, mounting: str) -> None:
    images = {"targets": "blob", "background": "plain", "size_m": 0.05, **CLEAN}
    movie = shot(task, images, targets=1, mounting=mounting)
    frames = list(movie.frames())
    seen = 0
    for frame, _, pixels in observations(movie):
        for camera in (0, 1):
            true = pixels[2 * camera : 2 * camera + 2]
            image = frames[frame][camera].astype(float)
            if not np.isfinite(true).all():
                continue
            colour = image.max(axis=2) - image.min(axis=2)
            v, u = np.mgrid[: image.shape[0], : image.shape[1]]
            middle = np.array([(u * colour).sum(), (v * colour).sum()]) / colour.sum()
            # The middle of a disc's image is not the image of its middle, but for so small a disc nearly.
            np.testing.assert_allclose(middle, true, atol=0.15)
            seen += 1
    assert seen >= 8


def test_a_target_behind_another_is_not_seen() -> None:
    movie = shot("six_dof", {"targets": "blob", "size_m": 0.5, **CLEAN}, targets=5, frames=10)
    frames = list(movie.frames())
    dense = np.full((10, 5, 4), np.nan)
    t = movie.tracks
    dense[t.frame, t.target] = t.pixels
    hidden = np.isnan(dense).any(axis=2)
    assert 3 <= hidden.sum() <= 45
    for frame, target in np.argwhere(~hidden):
        hue = cv2.cvtColor(frames[frame][0], cv2.COLOR_RGB2HSV)
        x, y = np.rint(dense[frame, target, :2]).astype(int)
        expected = round(179 * target / 5)
        assert abs((int(hue[y, x, 0]) - expected + 90) % 180 - 90) <= 2, (frame, target)


def test_the_background_stays_behind_when_the_tool_moves_and_not_when_the_cameras_do() -> None:
    corner = np.s_[:60, :60]
    for mounting, still in (("eye_to_hand", True), ("eye_in_hand", False)):
        movie = shot("six_dof", CLEAN, mounting=mounting)
        frames = [grey(left)[corner].astype(int) for left, _ in movie.frames()]
        moved = max(np.abs(frame - frames[0]).max() for frame in frames)
        assert (moved == 0) == still, mounting


def test_the_same_spec_gives_the_same_pixels_and_another_seed_others() -> None:
    images = {"noise": 3.0, "exposure_drift": 0.1}
    a, b = (np.stack([np.stack(pair) for pair in shot(images=images).frames()]) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    other = np.stack([np.stack(pair) for pair in shot(images=images, seed=3).frames()])
    assert (other != a).mean() > 0.5


def test_noise_has_the_size_it_was_given() -> None:
    quiet, loud = (
        np.stack([left for left, _ in shot(images={"background": "plain", **CLEAN, "noise": n}).frames()])
        for n in (0.0, 4.0)
    )
    difference = (loud.astype(float) - quiet)[:, :100, :100]
    # Rounding to whole grey levels adds a variance of 1/12.
    assert difference.std() == pytest.approx(np.sqrt(16 + 1 / 12), rel=0.02)
    assert abs(difference.mean()) < 0.05


def test_exposure_multiplies_and_saturates() -> None:
    plain = {"background": "plain", **CLEAN}
    one, two = (next(shot(images={**plain, "exposure": e}).frames())[0] for e in (1.0, 1.5))
    expected = np.clip(np.rint(one * 1.5), 0, 255)
    # Halves of a grey level may be rounded either way before the exposure.
    assert np.abs(two - expected).max() <= 1.0
    assert (two == 255).any()
    n, drift = 400, 0.02
    drifting = shot(images={**plain, "exposure_drift": drift}, frames=n)
    assert drifting.gain[0] == 1.0
    # Four standard errors of a standard deviation.
    assert np.diff(np.log(drifting.gain)).std() == pytest.approx(drift, rel=4 / np.sqrt(2 * n))


def test_blur_spreads_an_edge_as_wide_as_it_was_given() -> None:
    """The derivative of an edge blurred by σ has the variance σ² more than the sharp one's."""
    widths = []
    for blur in (0.0, 2.0):
        movie = shot(images={**CLEAN, "targets": "chessboard", "blur_px": blur, "size_m": 1.2}, targets=1)
        image = grey(next(movie.frames())[0]).astype(float)
        pixels = {i: p for f, i, p in observations(movie) if f == 0}
        x = round(float(pixels["2/4"][0]))
        y = round(float((pixels["2/4"][1] + pixels["3/4"][1]) / 2))
        slope = np.abs(np.diff(image[y, x - 12 : x + 12]))
        at = np.arange(len(slope))
        mean = (slope * at).sum() / slope.sum()
        widths.append((slope * (at - mean) ** 2).sum() / slope.sum())
    assert widths[1] - widths[0] == pytest.approx(4.0, rel=0.2)


def test_too_many_tags_or_boards_are_refused() -> None:
    with pytest.raises(InputError, match="with a chessboard 1 is accepted"):
        shot(images={"targets": "chessboard"}, targets=2)
    movie = shot(targets=2)
    many = replace(movie.simulation, targets_W=np.zeros((51, 3)))
    from vmf.data.render.scene import make_scene
    from vmf.spec import RenderedImages

    with pytest.raises(InputError, match="at most 50 are accepted"):
        make_scene(np.random.default_rng(0), many, RenderedImages(targets="tag"))


def test_targets_face_the_cameras_at_the_start() -> None:
    for mounting in ("eye_in_hand", "eye_to_hand"):
        movie = shot("six_dof", mounting=mounting)
        start = movie.simulation.world.region.start
        for surface in movie.scene.surfaces:
            a, b, c, _ = surface.points(surface.outline)
            normal = np.cross(b - a, c - b) @ start[:3, :3].T
            assert normal[2] / np.linalg.norm(normal) > np.cos(0.4)
        assert inverse(start).shape == (4, 4)


def test_images_too_large_to_be_drawn_are_refused() -> None:
    rig = {"width_px": 8192, "height_px": 4096, "cx_px": 4096.0, "cy_px": 2048.0}
    with pytest.raises(InputError, match="found images of 8192x4096; up to 4194304 pixels are drawn"):
        shot(rig=rig)


@pytest.mark.parametrize(
    ("key", "value"),
    [("blur_px", 1e5), ("noise", 1e308), ("exposure", 1e308), ("exposure_drift", 1e308), ("size_m", 1e12)],
)
def test_pictures_of_nothing_are_refused(key: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"data\.simulate\.images\.{key}: found"):
        shot(images={key: value})
