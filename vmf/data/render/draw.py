"""Stereo images of a simulated scene, and the true pixels of its tracked points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.data import workspace
from vmf.data.images import Image
from vmf.data.recording.messages import MAX_SIDE_PX
from vmf.data.render.lens import Lens
from vmf.data.render.scene import Scene, make_scene
from vmf.data.render.surface import Surface, apply, shows_front
from vmf.data.simulate import Simulation, rig, simulated_rig
from vmf.data.tracks import Tracks, from_dense
from vmf.errors import InputError
from vmf.geometry import in_view
from vmf.spec.images import RenderedImages
from vmf.spec.model import Simulate

Floats = NDArray[np.float64]

# The image is drawn finer by this factor and averaged, as the area of a real pixel averages.
_FINER = 2
# Finely drawn, in float and with what the lens needs around it, a pixel takes some 250 bytes.
_MOST_PIXELS = 2**22


@dataclass(frozen=True)
class Film:
    """A simulated recording as cameras see it.

    Attributes
    ----------
    tracks : the true pixels of the tracked points, at the poses as recorded, where nothing hides them.
    """

    simulation: Simulation
    scene: Scene = field(repr=False)
    images: RenderedImages
    lens: Lens
    gain: Floats = field(repr=False)
    rng: np.random.Generator = field(repr=False)
    tracks: Tracks = field(repr=False)

    def frames(self) -> Iterator[tuple[Image, Image]]:
        """Yield the left and the right image (height, width, 3) of every frame, once."""
        for E, gain in zip(self.simulation.E_true, self.gain, strict=True):
            yield self.pair(E, gain)

    def pair(self, E: Floats, gain: float = 1.0) -> tuple[Image, Image]:
        """Return the left and the right image (height, width, 3) at a pose `E_S_from_W` (4, 4)."""
        left, right = (
            self._exposed(self._camera.picture(_drawn(self.scene, M, E, self._camera)), gain)
            for M in self.simulation.world.cameras.M
        )
        return left, right

    @cached_property
    def _camera(self) -> _Sensor:
        return _Sensor(self.lens, self.simulation.world.image_size)

    def _exposed(self, light: NDArray[np.float32], gain: float) -> Image:
        if self.images.blur_px:
            light = np.asarray(cv2.GaussianBlur(light, (0, 0), self.images.blur_px), np.float32)
        light = light * np.float32(gain)
        if self.images.noise:
            light = light + self.images.noise * self.rng.standard_normal(light.shape, np.float32)
        return np.clip(np.rint(light), 0, 255).astype(np.uint8)


def grey(image: Image) -> Image:
    """Return a drawn image (height, width, 3) without its colours (height, width)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)


def film(simulation: Simulation, simulate: Simulate, rng: np.random.Generator) -> Film:
    """Return the film of a simulation.

    Raises
    ------
    InputError : the images cannot be drawn as the spec says.
    """
    images = simulate.images
    K, size = rig(simulated_rig(simulate))
    if size[0] * size[1] > _MOST_PIXELS or max(size) > MAX_SIDE_PX:
        raise InputError(
            f"data.simulate.rig: found images of {size[0]}x{size[1]}; "
            f"up to {_MOST_PIXELS} pixels are drawn, as 2048x2048"
        )
    scene = make_scene(rng, simulation, images)
    lens = Lens(K, *images.distortion)
    steps = images.exposure_drift * rng.standard_normal(len(simulation.E_true))
    steps[0] = 0.0
    gain = images.exposure * np.exp(np.cumsum(steps))
    pixels = _true_pixels(scene, simulation, lens)
    seen = simulation.tracks
    tracks = from_dense(seen.times_ns, seen.E_S_from_W, pixels, scene.ids, size)
    return Film(simulation, scene, images, lens, gain, rng, tracks)


class _Sensor:
    """Turns a finely drawn ideal image into what comes through the lens."""

    def __init__(self, lens: Lens, size: tuple[int, int]) -> None:
        self.size = size
        self.margin = lens.margin_px(size) if lens.k1 or lens.k2 else 0
        # Pixels of the fine image from those of the ideal camera; centres of squares meet centres.
        offset = _FINER * self.margin + (_FINER - 1) / 2
        self.finer = np.array([[_FINER, 0.0, offset], [0.0, _FINER, offset], [0.0, 0.0, 1.0]])
        w, h = (_FINER * (side + 2 * self.margin) for side in size)
        self.shape = (h, w, 3)
        self._map = self._through(lens) if self.margin else None

    def picture(self, fine: Image) -> NDArray[np.float32]:
        if self._map is not None:
            fine = np.asarray(cv2.remap(fine, *self._map, cv2.INTER_LINEAR), np.uint8)
        whole = fine.astype(np.float32)
        return np.asarray(cv2.resize(whole, self.size, interpolation=cv2.INTER_AREA), np.float32)

    def _through(self, lens: Lens) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        w, h = (_FINER * side for side in self.size)
        u, v = np.meshgrid(np.arange(w), np.arange(h))
        real = (np.column_stack([u.ravel(), v.ravel()]) - (_FINER - 1) / 2) / _FINER
        at = apply(self.finer, lens.ideal(real)).astype(np.float32)
        return at[:, 0].reshape(h, w), at[:, 1].reshape(h, w)


def _drawn(scene: Scene, M: Floats, E: Floats, camera: _Sensor) -> Image:
    """Return the ideal image: the background, then the targets from far to near."""
    canvas = np.zeros(camera.shape, np.uint8)
    fine = camera.finer @ M
    scene.background.draw(canvas, fine @ E if scene.background_moves else fine)
    for surface in _far_to_near(scene.surfaces, M @ E):
        surface.draw(canvas, fine @ E)
    return canvas


def _far_to_near(surfaces: tuple[Surface, ...], M: Floats) -> list[Surface]:
    shown = [s for s in surfaces if shows_front(M, s)]
    return sorted(shown, key=lambda s: -_depth(s, M))


def _depth(surface: Surface, M: Floats) -> float:
    return float(M[2] @ np.append(surface.points(surface.centre[None])[0], 1.0))


def _true_pixels(scene: Scene, simulation: Simulation, lens: Lens) -> Floats:
    """Return pixels (N, n, 4), NaN in a camera that does not see the point."""
    world = simulation.world
    ideal, depth = workspace.codes(world.cameras, simulation.E_true, scene.points)
    pixels = lens.distorted(ideal.reshape(*ideal.shape[:-1], 2, 2)).reshape(ideal.shape)
    left_and_right = [slice(0, 2), slice(2, 4)]
    for camera, M in enumerate(world.cameras.M):
        both = np.tile(pixels[..., left_and_right[camera]], 2)
        inside = in_view(both, depth[..., camera : camera + 1], world.image_size)
        for frame, E in enumerate(simulation.E_true):
            at = ideal[frame, :, left_and_right[camera]]
            hidden = ~inside[frame] | _hidden(scene, M @ E, at)
            pixels[frame, hidden, left_and_right[camera]] = np.nan
    return pixels


def _hidden(scene: Scene, M: Floats, at: Floats) -> NDArray[np.bool_]:
    """Tell which of the points at ideal pixels (n, 2) another surface covers, or face away."""
    order = _far_to_near(scene.surfaces, M)
    rank = np.full(len(scene.surfaces), -1)
    for i, surface in enumerate(order):
        rank[next(k for k, s in enumerate(scene.surfaces) if s is surface)] = i
    hidden = rank[scene.on] < 0
    for i, surface in enumerate(order):
        corners = apply(M @ surface.planes[0], surface.outline)
        side = np.roll(corners, -1, axis=0) - corners
        to = at[:, None] - corners
        within = (side[:, 0] * to[..., 1] - side[:, 1] * to[..., 0] > 0.0).all(axis=1)
        hidden |= within & (rank[scene.on] < i)
    return hidden
