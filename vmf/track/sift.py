"""SIFT features matched between the images and over time."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.spec.images import SiftTracker as Options
from vmf.track.base import NOTHING, Floats, Image, Odometry, Sightings, Tracker
from vmf.track.epipolar import EpipolarGate
from vmf.track.features import FeatureDetector, Features
from vmf.track.keypoint_database import KeypointDatabase, Look
from vmf.track.neighbours import NEIGHBOURS, along, around
from vmf.track.patch import Alignment, Patch, align, take
from vmf.track.region import Region, starting

Ints = NDArray[np.int64]
_Sighting = tuple[str, Floats, float]

_REACH_PX = 2.5
# Two features nearer than this show the same point.
_SAME_PX = 1.5


@dataclass(frozen=True)
class _Pair:
    """Both images and their features."""

    images: tuple[Image, Image]
    features: tuple[Features, Features]


class SiftTracker(Tracker):
    """Matches SIFT features (Lowe 2004) between images whose rows need not correspond.

    A stereo match is mutual, distinctive, agrees with the rig's fundamental matrix, and looks alike. Over
    time a feature must be matched in the left image and, by itself, in the right one, and look as at first.
    No feature begins before the fundamental matrix is known. What was seen is kept in a keypoint database.

    Attributes
    ----------
    database : the keypoints known, and those seen again in the newest pair.
    gate : the rig's fundamental matrix, as far as it is known.
    counts : features in the newest left image, and those of them with a stereo match.
    """

    def __init__(self, options: Options) -> None:
        """Detect as many features as `options` say."""
        super().__init__()
        self._options = options
        self.gate = EpipolarGate(options.epipolar_px)
        self.counts = 0, 0
        self._detectors = FeatureDetector(options.features), FeatureDetector(options.features)
        self._regions: list[Region] = []
        self._odometry: Odometry | None = None
        self.database = KeypointDatabase(options.memory_frames, options.void_after_m)

    @property
    def needs_odometry(self) -> bool:
        return self._options.void_after_m is not None

    def moved_to(self, odometry: Odometry) -> None:
        self._odometry = odometry

    def step(self, left: Image, right: Image) -> Sightings:
        self.database.begin(self._odometry)
        self._regions = self._regions or starting(self._options.regions, left)
        pair = _Pair((left, right), self._both(_detected, self._detectors, (left, right)))
        first, second = pair.features
        stereo = matches(first.descriptors, second.descriptors, self._options.ratio)
        codes = np.column_stack([first.pixels[stereo[:, 0]], second.pixels[stereo[:, 1]]])
        self.gate.learn(codes)
        self.counts = len(first), int(self.gate.agree(codes).sum())
        seen = self._again(pair)
        if self.gate.known:
            seen += self._new(pair, _distinct(stereo[self.gate.agree(codes)], first.pixels))
        if not seen:
            return NOTHING
        names, pixels, quality = zip(*seen, strict=True)
        return Sightings(names, np.array(pixels), np.clip(quality, 0.0, 1.0))

    def _again(self, pair: _Pair) -> list[_Sighting]:
        """Return the known features seen again, and remember how."""
        found = []
        for camera, features in enumerate(pair.features):
            known = self.database.descriptors(camera)
            found.append(dict(matches(known, features.descriptors, self._options.ratio).tolist()))
        seen: list[_Sighting] = []
        steps: list[tuple[int, Floats, Floats]] = []
        both = sorted(found[0].keys() & found[1].keys())
        for k in self._like_neighbours(both, pair.features[0].pixels[[found[0][k] for k in both]]):
            keypoint = self.database.keypoints[k]
            look = keypoint.look
            at = found[0][k], found[1][k]
            views = [
                self._aligned(look.patch, image, f.linear(i, look.size, look.direction), f.pixels[i])
                for image, f, i in zip(pair.images, pair.features, at, strict=True)
            ]
            if views[0] is None or views[1] is None:
                continue
            code = np.concatenate([views[0].pixel, views[1].pixel])
            if not self.gate.agree(code[None])[0]:
                continue
            newest = np.stack([f.descriptors[i] for f, i in zip(pair.features, at, strict=True)])
            if self.database.recent(k):
                steps.append((look.region, keypoint.expected, views[0].pixel))
            self.database.again(k, newest, code)
            seen.append((keypoint.name, code, min(views[0].similarity, views[1].similarity)))
        self._carry(steps)
        return seen

    def _like_neighbours(self, numbers: list[int], now: Floats) -> list[int]:
        """Return which keypoints, matched with left pixels `now` (n, 2), move like their neighbours.

        Those not seen for long are compared among themselves, from where they were seen last.
        """
        recent = np.array([self.database.recent(k) for k in numbers], bool)
        keep = np.zeros(len(numbers), bool)
        for group in (recent, ~recent):
            known = [self.database.keypoints[k] for k in np.array(numbers, int)[group]]
            before = np.array([k.expected for k in known]).reshape(-1, 2)
            keep[group] = along(before, now[group])
        return [k for k, kept in zip(numbers, keep, strict=True) if kept]

    def _carry(self, steps: list[tuple[int, Floats, Floats]]) -> None:
        """Move along with the features seen again what was not: regions, and where to expect the others."""
        if self._options.regions:
            for number, region in enumerate(self._regions):
                moved = np.array([step[1:] for step in steps if step[0] == number]).reshape(-1, 2, 2)
                self._regions[number] = region.moved(moved[:, 0], moved[:, 1])
        unseen = np.flatnonzero(~self.database.in_sight()).tolist()
        lost = [k for k in unseen if self.database.recent(k)]
        if lost and len(steps) >= NEIGHBOURS:
            moved = np.array([step[1:] for step in steps])
            pixels = np.array([self.database.keypoints[k].expected for k in lost])
            shift = around(pixels, moved[:, 0], moved[:, 1] - moved[:, 0])
            for k, pixel in zip(lost, pixels + shift, strict=True):
                self.database.expect(k, pixel)

    def _new(self, pair: _Pair, stereo: Ints) -> list[_Sighting]:
        """Return the features of the regions that nothing known is near or alike, and remember them."""
        seen: list[_Sighting] = []
        first, second = pair.features
        stereo = stereo[self.database.distinctive(first.descriptors[stereo[:, 0]])]
        in_sight = self.database.in_sight()
        taken = np.array([k.expected for k in self.database.keypoints]).reshape(-1, 2)[in_sight]
        for number, region in enumerate(self._regions):
            for i, j in stereo[region.contains(first.pixels[stereo[:, 0]])].tolist():
                pixel, size, direction = first.pixels[i], float(first.sizes[i]), float(first.directions[i])
                if (np.linalg.norm(taken - pixel, axis=1) < _SAME_PX).any():
                    continue
                patch = take(pair.images[0], pixel)
                linear = second.linear(j, size, direction)
                view = self._aligned(patch, pair.images[1], linear, second.pixels[j])
                if view is None:
                    continue
                code = np.concatenate([pixel, view.pixel])
                if not self.gate.agree(code[None])[0]:
                    continue
                both = np.stack([first.descriptors[i], second.descriptors[j]])
                name = self.database.add(Look(patch, size, direction, number), both, code)
                seen.append((name, code, view.similarity))
        return seen

    def _aligned(self, patch: Patch, image: Image, linear: Floats, pixel: Floats) -> Alignment | None:
        found = align(patch, image, linear, pixel, _REACH_PX)
        return None if found is None or found.similarity < self._options.min_similarity else found


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


def _detected(detector: FeatureDetector, image: Image) -> Features:
    return detector(image)
