"""SIFT features matched between the images and over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.spec.images import SiftTracker as Options
from vmf.track.base import NOTHING, Floats, Image, Sightings, Tracker
from vmf.track.epipolar import EpipolarGate
from vmf.track.patch import Alignment, Patch, align, placed, take
from vmf.track.region import Region, starting

Ints = NDArray[np.int64]

_REACH_PX = 2.5
# Two features nearer than this show the same point.
_SAME_PX = 1.5


@dataclass(frozen=True)
class _Features:
    """Features of one image: pixels (n, 2), sizes (n,) px, directions (n,) rad, descriptors (n, 128)."""

    pixels: Floats
    sizes: Floats
    directions: Floats
    descriptors: NDArray[np.float32]

    def select(self, which: Ints) -> _Features:
        return _Features(
            self.pixels[which], self.sizes[which], self.directions[which], self.descriptors[which]
        )

    def linear(self, i: int, size: float, direction: float) -> Floats:
        """Return the turn and scale (2, 2) to feature i from one of another size and direction."""
        angle, scale = self.directions[i] - direction, self.sizes[i] / size
        return np.asarray(scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]))


@dataclass(frozen=True)
class _Track:
    """A feature: how it looked at first, and its newest descriptors and pixel.

    Attributes
    ----------
    descriptor : (256,) of both images.
    """

    name: str
    region: int
    patch: Patch
    size: float
    direction: float
    descriptor: NDArray[np.float32]
    pixel: Floats
    seen: int


class SiftTracker(Tracker):
    """Matches SIFT features (Lowe 2004) between images whose rows need not correspond.

    A stereo match is mutual, distinctive, agrees with the rig's fundamental matrix, and looks alike. Over
    time both images' descriptors together are matched in the same way, and aligned with the first look.
    """

    def __init__(self, options: Options) -> None:
        """Detect as many features as `options` say."""
        super().__init__()
        self._options = options
        self._gate = EpipolarGate(options.epipolar_px)
        self._detectors = _detector(options.features), _detector(options.features)
        self._names = count()
        self._tracks: list[_Track] = []
        self._regions: list[Region] = []
        self._frame = 0

    def step(self, left: Image, right: Image) -> Sightings:
        self._regions = self._regions or starting(self._options.regions, left)
        first, second = self._both(_features, self._detectors, (left, right))
        pairs = matches(first.descriptors, second.descriptors, self._options.ratio)
        codes = np.column_stack([first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]]])
        self._gate.learn(codes)
        pairs = _distinct(pairs[self._gate.agree(codes)], first.pixels)
        first, second = first.select(pairs[:, 0]), second.select(pairs[:, 1])
        both = np.hstack([first.descriptors, second.descriptors])
        known = np.array([t.descriptor for t in self._tracks], np.float32).reshape(-1, both.shape[1])
        again = matches(both, known, self._options.ratio)
        seen = self._again(left, right, first, second, both, again)
        fresh = np.setdiff1d(np.arange(len(both)), again[:, 0])
        seen += self._new(left, right, first, second, both, fresh)
        self._forget()
        self._frame += 1
        if not seen:
            return NOTHING
        names, pixels, quality = zip(*seen, strict=True)
        return Sightings(names, np.array(pixels), np.clip(quality, 0.0, 1.0))

    def _again(
        self,
        left: Image,
        right: Image,
        first: _Features,
        second: _Features,
        descriptors: NDArray[np.float32],
        again: Ints,
    ) -> list[tuple[str, Floats, float]]:
        """Return the known features seen again, and remember how."""
        seen = []
        moved: list[tuple[int, Floats, Floats]] = []
        for i, k in again.tolist():
            track = self._tracks[k]
            views = [
                self._aligned(track.patch, image, f.linear(i, track.size, track.direction), f.pixels[i])
                for image, f in ((left, first), (right, second))
            ]
            if views[0] is None or views[1] is None:
                continue
            code = np.concatenate([views[0].pixel, views[1].pixel])
            if not self._gate.agree(code[None])[0]:
                continue
            moved.append((track.region, track.pixel, views[0].pixel))
            self._tracks[k] = replace(
                track, descriptor=descriptors[i], pixel=views[0].pixel, seen=self._frame
            )
            seen.append((track.name, code, min(v.similarity for v in views if v is not None)))
        if self._options.regions:
            for number, region in enumerate(self._regions):
                steps = np.array([s[1:] for s in moved if s[0] == number]).reshape(-1, 2, 2)
                self._regions[number] = region.moved(steps[:, 0], steps[:, 1])
        return seen

    def _new(
        self,
        left: Image,
        right: Image,
        first: _Features,
        second: _Features,
        descriptors: NDArray[np.float32],
        fresh: Ints,
    ) -> list[tuple[str, Floats, float]]:
        """Return the features of the regions that nothing known is like, and remember them."""
        seen = []
        current = np.array([t.pixel for t in self._tracks if t.seen == self._frame]).reshape(-1, 2)
        for number, region in enumerate(self._regions):
            for i in fresh[region.contains(first.pixels[fresh])].tolist():
                pixel, size, direction = first.pixels[i], first.sizes[i], first.directions[i]
                if (np.linalg.norm(current - pixel, axis=1) < _SAME_PX).any():
                    continue
                patch = take(left, pixel)
                view = self._aligned(patch, right, second.linear(i, size, direction), second.pixels[i])
                if view is None:
                    continue
                code = np.concatenate([pixel, view.pixel])
                if not self._gate.agree(code[None])[0]:
                    continue
                name = str(next(self._names))
                track = _Track(
                    name, number, patch, float(size), float(direction), descriptors[i], pixel, self._frame
                )
                self._tracks.append(track)
                seen.append((name, code, view.similarity))
        return seen

    def _aligned(self, patch: Patch, image: Image, linear: Floats, pixel: Floats) -> Alignment | None:
        found = align(patch, image, placed(linear, pixel), _REACH_PX)
        return None if found is None or found.similarity < self._options.min_similarity else found

    def _forget(self) -> None:
        oldest = self._frame - self._options.memory_frames
        self._tracks = [t for t in self._tracks if t.seen >= oldest]


def matches(queries: NDArray[np.float32], among: NDArray[np.float32], ratio: float) -> Ints:
    """Return pairs (n, 2) of descriptors, each other's nearest by far: Lowe's ratio test, both ways."""
    if len(queries) < 2 or len(among) < 2:
        return np.zeros((0, 2), np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_L2)

    def best(a: NDArray[np.float32], b: NDArray[np.float32]) -> dict[int, int]:
        nearest = matcher.knnMatch(a, b, 2)
        return {m.queryIdx: m.trainIdx for m, n in nearest if m.distance <= ratio * n.distance}

    there, back = best(queries, among), best(among, queries)
    found = [(i, k) for i, k in there.items() if back.get(k) == i]
    return np.array(found, np.int64).reshape(-1, 2)


def _distinct(pairs: Ints, pixels: Floats) -> Ints:
    """Return the pairs without those whose left pixel another one has: SIFT may see one point twice."""
    cells = np.round(pixels[pairs[:, 0]] / _SAME_PX).astype(np.int64)
    _, keep = np.unique(cells, axis=0, return_index=True)
    return np.asarray(pairs[np.sort(keep)])


def _detector(features: int) -> cv2.SIFT:
    # Without precise upscaling OpenCV's features lie off by a quarter of a pixel.
    return cv2.SIFT.create(features, enable_precise_upscale=True)


def _features(detector: cv2.SIFT, image: Image) -> _Features:
    keys, descriptors = detector.detectAndCompute(image, None)
    return _Features(
        np.array([k.pt for k in keys], float).reshape(-1, 2),
        np.array([k.size for k in keys], float),
        np.deg2rad([k.angle for k in keys]),
        np.zeros((0, 128), np.float32) if descriptors is None else np.asarray(descriptors, np.float32),
    )
