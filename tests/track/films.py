"""Simulated stereo films for trackers, and how far their tracks are from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from vmf.data.render import Film, film
from vmf.data.render.surface import Surface, apply
from vmf.data.simulate import image_stream, simulate, trial_streams
from vmf.data.tracks import Tracks
from vmf.spec import TRACKER_MODELS, Spec, loads, settings
from vmf.track import Sightings, Tracker, make_tracker

Floats = NDArray[np.float64]
Images = tuple[NDArray[np.uint8], NDArray[np.uint8]]
# What each tracker is made to look at.
SHOWN = {
    "meanshift": "blob",
    "camshift": "blob",
    "klt": "texture",
    "sift": "texture",
    "aruco": "tag",
    "apriltag": "tag",
    "chessboard": "chessboard",
}
# Rendered tags are ArUco's; AprilTag's detector is tried on pictures of its own family in its tests.
RENDERED = tuple(kind for kind in SHOWN if kind != "apriltag")
SETTINGS = {"meanshift": ("targets=3",), "camshift": ("targets=3",)}


@dataclass(frozen=True, eq=False)
class Shot:
    """A film, its frames (of blobs in colour, of anything else in grey), and the spec it was made from."""

    spec: Spec
    film: Film
    frames: tuple[Images, ...]

    def frame(self, number: int, colour: bool) -> Images:
        left, right = self.frames[number]
        assert colour == (left.ndim == 3)
        return left, right


def shot(kind: str, frames: int = 30, seed: int = 4, rate_hz: float = 30.0, **images: Any) -> Shot:
    """A hand-guided rig in front of what suits a kind of tracker."""
    return _shot(SHOWN[kind], frames, seed, rate_hz, **images)


@cache
def _shot(shown: str, frames: int, seed: int, rate_hz: float, **images: Any) -> Shot:
    targets = 1 if shown == "chessboard" else 4
    look = {"targets": shown, "format": "png", **images}
    if shown == "chessboard":
        look["size_m"] = 0.5
    motion = {"motion": "hand_guided", "rate_hz": rate_hz}
    simulated = {"frames": frames, "targets": targets, **motion, "seed": seed, "images": look}
    spec = loads(yaml.safe_dump({"task": "six_dof", "data": {"simulate": simulated}})).spec
    assert spec.data.simulate is not None
    movie = film(simulate(spec, trial_streams(spec, 0)[0]), spec.data.simulate, image_stream(spec))
    pairs = movie.frames()
    seen = tuple(pairs) if shown == "blob" else tuple((grey(left), grey(right)) for left, right in pairs)
    # What has been drawn is not needed any more, and a background takes as much memory as fifty frames.
    background = replace(movie.scene.background, levels=movie.scene.background.levels[-1:])
    return Shot(spec, replace(movie, scene=replace(movie.scene, background=background)), seen)


def blank(of: Shot, colour: bool) -> Images:
    """An even picture for each camera."""
    left, right = of.frame(0, colour)
    return np.full_like(left, 100), np.full_like(right, 100)


def grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)


def tracker(kind: str, *options: str) -> Tracker:
    return make_tracker(settings(TRACKER_MODELS[kind], options))  # type: ignore[arg-type]


@cache
def followed(kind: str, of: Shot, *options: str) -> list[Sightings]:
    """What a tracker sees in the frames of a shot; asked once, for it is always the same."""
    return followed_anew(kind, of, *options)


def followed_anew(kind: str, of: Shot, *options: str, frames: Sequence[int] | None = None) -> list[Sightings]:
    """What a new tracker sees in some frames of a shot."""
    numbers = range(len(of.frames)) if frames is None else frames
    with tracker(kind, *(options or SETTINGS.get(kind, ()))) as one:
        return [one.step(*of.frame(number, one.colour)) for number in numbers]


class Truth:
    """The true pixels of what a tracker follows, whatever names it gives.

    Tags and boards have names of their own. Another target is the point that its first sighting shows: that
    of the nearest surface, or of the background, whichever the right image says.
    """

    def __init__(self, of: Shot) -> None:
        self._film = of.film
        self._world = of.film.simulation.world
        self._points: dict[str, tuple[Surface, Floats]] = {}
        t = of.film.tracks
        self._dense = np.full((t.n_frames, t.n_targets, 4), np.nan)
        self._dense[t.frame, t.target] = t.pixels
        self._number = {name: k for k, name in enumerate(t.ids)}

    def of_named(self, name: str, frame: int) -> Floats:
        return np.asarray(self._dense[frame, self._number[name.split("#")[0]]])

    def of_blob(self, name: str, frame: int, pixel: Floats) -> Floats:
        """The target that was nearest when the name was first seen."""
        if name not in self._points:
            off = np.linalg.norm(self._dense[frame, :, :2] - pixel[:2], axis=1)
            self._points[name] = self._film.scene.surfaces[int(np.nanargmin(off))], np.zeros(2)
            self._number[name] = int(np.nanargmin(off))
        return np.asarray(self._dense[frame, self._number[name]])

    def of_point(self, name: str, frame: int, pixel: Floats) -> Floats:
        if name not in self._points:
            choices = [(s, self._on(s, frame, pixel[:2])) for s in self._surfaces()]
            near = [(s, p) for s, p in choices if s.endless or self._within(s, p)]
            seen = [np.linalg.norm(self._projected(s, p, frame)[2:] - pixel[2:]) for s, p in near]
            self._points[name] = near[int(np.argmin(seen))]
        return self._projected(*self._points[name], frame)

    def _surfaces(self) -> list[Surface]:
        return [*self._film.scene.surfaces, self._film.scene.background]

    def _camera(self, surface: Surface, camera: int, frame: int) -> Floats:
        scene = self._film.scene
        M = self._world.cameras.M[camera]
        still = surface is scene.background and not scene.background_moves
        return M if still else M @ self._film.simulation.E_true[frame]

    def _on(self, surface: Surface, frame: int, pixel: Floats) -> Floats:
        """The picture pixel that a left pixel shows."""
        lens = self._film.lens
        ideal = lens.ideal(pixel[None]) if lens.k1 or lens.k2 else pixel[None]
        return apply(np.linalg.inv(self._camera(surface, 0, frame) @ surface.planes[0]), ideal)[0]

    def _within(self, surface: Surface, p: Floats) -> bool:
        """Whether a picture pixel is on the surface, or so near that a corner there may be its edge."""
        h, w = surface.levels[0].shape[:2]
        return bool((np.abs(p - surface.centre) <= 0.6 * np.array([w, h])).all())

    def _projected(self, surface: Surface, p: Floats, frame: int) -> Floats:
        both = [apply(self._camera(surface, c, frame) @ surface.planes[0], p[None])[0] for c in (0, 1)]
        return np.concatenate([self._film.lens.distorted(pixel) for pixel in both])


@dataclass(frozen=True)
class Compared:
    """Observations of a tracker, as tracks, beside the true pixels (M, 4) of what they show."""

    tracks: Tracks
    true: Floats

    @property
    def off_px(self) -> Floats:
        """Distances (n,) of all pixels seen from the truth."""
        off = np.linalg.norm((self.tracks.pixels - self.true).reshape(-1, 2, 2), axis=2).ravel()
        return off[np.isfinite(off)]

    @property
    def rms_px(self) -> float:
        """Root mean square error of a coordinate."""
        off = self.tracks.pixels - self.true
        return float(np.sqrt(np.nanmean(off**2)))


def compared(kind: str, of: Shot, seen: list[Sightings]) -> Compared:
    truth = Truth(of)
    names: dict[str, int] = {}
    rows: list[tuple[int, int]] = []
    pixels, true = [], []
    for frame, sightings in enumerate(seen):
        for name, pixel in zip(sightings.ids, sightings.pixels, strict=True):
            rows.append((names.setdefault(name, len(names)), frame))
            pixels.append(pixel)
            if kind in ("klt", "sift"):
                true.append(truth.of_point(name, frame, pixel))
            elif kind in ("meanshift", "camshift"):
                true.append(truth.of_blob(name, frame, pixel))
            else:
                true.append(truth.of_named(name, frame))
    order = sorted(range(len(rows)), key=lambda i: rows[i])
    target, frame = np.array(rows)[order].T
    base = of.film.tracks
    tracks = Tracks(
        base.times_ns, base.E_S_from_W, frame, target, np.array(pixels)[order], tuple(names), base.image_size
    )
    return Compared(tracks, np.array(true)[order])
