"""Corners followed through both images by Lucas and Kanade's method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.spec.images import KltTracker as Options
from vmf.track.base import NOTHING, Bools, Floats, Image, Sightings, Tracker, inside
from vmf.track.epipolar import EpipolarGate
from vmf.track.neighbours import NEIGHBOURS, around
from vmf.track.patch import RADIUS, Alignment, Patch, align, take
from vmf.track.region import Region, starting

Singles = NDArray[np.float32]

_WINDOW, _LEVELS = (21, 21), 4
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.01)
# Corners this much weaker than the strongest are no corners.
_WEAKEST = 0.01
# How far the first look may be from where Lucas and Kanade's method, which adds up errors, has come.
_REACH_PX = 3.0
_REFILL_BELOW = 0.85
# The first matches are looked for in images this much smaller, by squares of so many pixels to each side.
_COARSE, _COARSE_RADIUS, _COARSE_LEVELS = 4, 6, 1
_UNTURNED = np.eye(2)


@dataclass(frozen=True)
class _Track:
    """A corner: its first look, and where each camera sees it, None where it does not."""

    name: str
    region: int
    patch: Patch
    left: Alignment | None
    right: Alignment | None

    @property
    def views(self) -> tuple[Alignment | None, Alignment | None]:
        return self.left, self.right

    @property
    def code(self) -> Floats:
        unseen = np.full(2, np.nan)
        return np.concatenate([unseen if view is None else view.pixel for view in self.views])


class KltTracker(Tracker):
    """Follows corners (Shi and Tomasi 1994) from frame to frame and from the left image to the right.

    Every step must come back to where it began, the corner must look as it did at first, and both images
    must agree with the rig's epipolar geometry. A corner that leaves both images is gone: found again it has
    another name.
    """

    def __init__(self, options: Options) -> None:
        """Follow as many corners as `options` say."""
        super().__init__()
        self._options = options
        self._gate = EpipolarGate(options.epipolar_px)
        self._names = count()
        self._tracks: list[_Track] = []
        self._before: tuple[Image, Image] | None = None
        self._regions: list[Region] = []

    def step(self, left: Image, right: Image) -> Sightings:
        images = left, right
        if self._before is None:
            self._regions = starting(self._options.regions, left)
        else:
            self._follow(images, self._before)
            self._find_other(images)
        if len(self._tracks) < _REFILL_BELOW * self._options.corners:
            self._find_new(images)
        self._before = images
        if not self._tracks:
            return NOTHING
        quality = [min(view.similarity for view in t.views if view is not None) for t in self._tracks]
        return Sightings(
            tuple(t.name for t in self._tracks),
            np.array([t.code for t in self._tracks]),
            np.clip(quality, 0.0, 1.0),
        )

    def _follow(self, images: tuple[Image, Image], before: tuple[Image, Image]) -> None:
        views = [t.left for t in self._tracks], [t.right for t in self._tracks]
        left, right = self._both(self._followed, images, before, views)
        moved = [replace(t, left=a, right=b) for t, a, b in zip(self._tracks, left, right, strict=True)]
        if self._options.regions:
            self._move_regions(moved)
        self._tracks = self._agreeing([t for t in moved if t.left is not None or t.right is not None])

    def _move_regions(self, moved: list[_Track]) -> None:
        for number, region in enumerate(self._regions):
            pairs = [
                (old.left.pixel, new.left.pixel)
                for old, new in zip(self._tracks, moved, strict=True)
                if new.region == number and old.left is not None and new.left is not None
            ]
            before, now = np.array(pairs).reshape(-1, 2, 2).swapaxes(0, 1)
            self._regions[number] = region.moved(before, now)

    def _followed(self, image: Image, before: Image, views: list[Alignment | None]) -> list[Alignment | None]:
        """Return where one camera sees each track now, given where it saw it before."""
        seen = [i for i, view in enumerate(views) if view is not None]
        result: list[Alignment | None] = [None] * len(views)
        if not seen:
            return result
        known = [view for view in views if view is not None]
        start = np.array([view.pixel for view in known])
        pixels, steady = _flow(before, image, start, start, self._options.round_trip_px)
        for i, view, pixel, good in zip(seen, known, pixels, steady, strict=True):
            if good:
                result[i] = self._aligned(self._tracks[i].patch, image, view.linear, pixel)
        return result

    def _aligned(self, patch: Patch, image: Image, linear: Floats, pixel: Floats) -> Alignment | None:
        found = align(patch, image, linear, pixel, _REACH_PX)
        if found is None or found.similarity < self._options.min_similarity:
            return None
        x, y = found.pixel.tolist()
        height, width = image.shape[:2]
        return found if 0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0 else None

    def _agreeing(self, tracks: list[_Track]) -> list[_Track]:
        """Return the tracks that the rig's geometry does not contradict: of the others one view is wrong."""
        if not tracks:
            return []
        codes = np.array([t.code for t in tracks])
        self._gate.learn(codes)
        return [t for t, good in zip(tracks, self._gate.agree(codes), strict=True) if good]

    def _find_other(self, images: tuple[Image, Image]) -> None:
        """Look in the other image for corners that one camera alone sees."""
        for here in (0, 1):
            there = 1 - here
            lone = [i for i, t in enumerate(self._tracks) if t.views[there] is None]
            views = [view for i in lone if (view := self._tracks[i].views[here]) is not None]
            if not views:
                continue
            start = np.array([view.pixel for view in views])
            guess = start + self._shift(start, here)
            pixels, steady = _flow(images[here], images[there], start, guess, self._options.round_trip_px)
            for i, view, pixel, good in zip(lone, views, pixels, steady, strict=True):
                track = self._tracks[i]
                found = None
                if good:
                    found = self._aligned(track.patch, images[there], view.linear, pixel)
                whole = replace(track, right=found) if there else replace(track, left=found)
                if found is not None and self._gate.agree(whole.code[None])[0]:
                    self._tracks[i] = whole

    @property
    def _knows_shift(self) -> bool:
        return sum(t.left is not None and t.right is not None for t in self._tracks) >= NEIGHBOURS

    def _shift(self, pixels: Floats, here: int) -> Floats:
        """Return how far (n, 2) the other image shows what is near pixels (n, 2) of this one."""
        codes = np.array([t.code for t in self._tracks if t.left is not None and t.right is not None])
        if len(codes) < NEIGHBOURS:
            return np.zeros((len(pixels), 2))
        mine, other = codes.reshape(-1, 2, 2)[:, here], codes.reshape(-1, 2, 2)[:, 1 - here]
        return around(pixels, mine, other - mine)

    def _find_new(self, images: tuple[Image, Image]) -> None:
        """Look for corners in the left image that the right one shows too."""
        share = -(-self._options.corners // len(self._regions))
        for number, region in enumerate(self._regions):
            corners = self._corners(images[0], region, share - sum(t.region == number for t in self._tracks))
            if not len(corners):
                continue
            guess, levels = corners + self._shift(corners, 0), _LEVELS
            if not self._knows_shift:
                # Coarse images show small targets as part of what is behind them.
                guess, levels = _looked_for(*images, corners), _COARSE_LEVELS
            pixels, steady = _flow(*images, corners, guess, self._options.round_trip_px, levels)
            fresh = []
            for corner, pixel in zip(corners[steady], pixels[steady], strict=True):
                patch = take(images[0], corner)
                right = self._aligned(patch, images[1], _UNTURNED, pixel)
                if right is not None:
                    fresh.append(_Track("", number, patch, Alignment(corner, _UNTURNED, 1.0), right))
            self._tracks += [replace(t, name=str(next(self._names))) for t in self._agreeing(fresh)]

    def _corners(self, image: Image, region: Region, n: int) -> Floats:
        """Return at most n new corners (m, 2) in a region of the left image, apart from those followed."""
        if n <= 0:
            return np.zeros((0, 2))
        mask = region.mask(image)
        for border in (mask[:RADIUS], mask[-RADIUS:], mask[:, :RADIUS], mask[:, -RADIUS:]):
            border[:] = 0
        for t in self._tracks:
            if t.left is not None:
                at = np.rint(t.left.pixel).astype(int).tolist()
                cv2.circle(mask, at, round(self._options.spacing_px), (0,), -1)
        found = cv2.goodFeaturesToTrack(image, n, _WEAKEST, self._options.spacing_px, mask=mask)
        return np.zeros((0, 2)) if found is None else np.asarray(found, float).reshape(-1, 2)


def _looked_for(left: Image, right: Image, pixels: Floats) -> Floats:
    """Return where (n, 2) the right image looks most like the left one around pixels (n, 2)."""
    side = 2 * _COARSE_RADIUS + 1
    small = [_smaller(image) for image in (left, right)]
    most = np.array(small[0].shape[1::-1]) - side
    if min(*small[0].shape, *small[1].shape) < side:
        return pixels
    found = np.empty_like(pixels)
    for i, pixel in enumerate(pixels):
        x, y = np.clip(np.rint((pixel + 0.5) / _COARSE - 0.5).astype(int) - _COARSE_RADIUS, 0, most).tolist()
        alike = cv2.matchTemplate(small[1], small[0][y : y + side, x : x + side], cv2.TM_CCOEFF_NORMED)
        found[i] = pixel + _COARSE * (np.array(cv2.minMaxLoc(alike)[3]) - (x, y))
    return found


def _extended(image: Image, height: int, width: int) -> Image:
    """Return an image with its last row and column repeated to a size."""
    below, beside = height - image.shape[0], width - image.shape[1]
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, beside, cv2.BORDER_REPLICATE), np.uint8)


def _smaller(image: Image) -> Image:
    scale = 1 / _COARSE
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _flow(
    before: Image, now: Image, start: Floats, guess: Floats, round_trip_px: float, levels: int = _LEVELS
) -> tuple[Floats, Bools]:
    """Return where points (n, 2) are now, and which come back to where they began (`round_trip_px`)."""
    first, near = (np.ascontiguousarray(p[:, None], np.float32) for p in (start, guess))
    there, found = _one_way(before, now, first, near, levels)
    back, returned = _one_way(now, before, there, there + (first - near), levels)
    off = np.linalg.norm((back - first)[:, 0], axis=1)
    good = (found[:, 0] == 1) & (returned[:, 0] == 1) & (off <= round_trip_px)
    pixels = np.asarray(there[:, 0], float)
    return pixels, good & inside(pixels, now)


def _one_way(before: Image, now: Image, start: Singles, guess: Singles, levels: int) -> tuple[Singles, Image]:
    if before.shape != now.shape:
        # The cameras differ. OpenCV wants one size; what is added shows nothing, and nothing there is kept.
        size = np.maximum(before.shape, now.shape)
        before, now = (_extended(image, *size.tolist()) for image in (before, now))
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before,
        now,
        start,
        guess.copy(),
        winSize=_WINDOW,
        maxLevel=levels,
        criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(there, np.float32), np.asarray(found, np.uint8)
