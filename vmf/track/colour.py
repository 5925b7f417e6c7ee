"""Targets of one colour: what mean-shift and CAMShift trackers share."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.spec.images import CamshiftTracker, MeanshiftTracker
from vmf.track.base import NOTHING, Floats, Image, Sightings, Tracker
from vmf.track.epipolar import EpipolarGate
from vmf.track.region import check_shown

Window = tuple[int, int, int, int]

_BINS, _RANGES = [32, 16], [0, 180, 0, 256]
# Below these a pixel has no colour to speak of.
_LEAST_SATURATION, _LEAST_VALUE = 50, 30
# A window is that much wider than the target, so that it still holds it when it has moved or grown.
_ROOM = 1.4
# A target is lost when less than this of its area remains, or when it is only a few pixels large.
_LEAST_SHARE, _LEAST_MASS = 0.08, 10.0
# A second place that shows this much of the colour leaves it open which one is the target.
_AMBIGUOUS = 0.6
# Blobs to begin with: their hues in steps, and their areas.
_HUES, _SMALLEST_PX, _LARGEST_SHARE = 24, 40, 0.2
# Of blobs beyond these none is conspicuous, and each is looked for in a whole image.
_MOST_BLOBS = 50


@dataclass(frozen=True)
class Colour:
    """What a target looks like.

    Attributes
    ----------
    weights : (hue, saturation) 0 to 255, how much a colour speaks for the target and against what is around.
    look : (hue, saturation) histogram of a box around the target, sum 1; the first bin counts all grey.
    """

    weights: NDArray[np.float32] = field(repr=False)
    look: NDArray[np.float32] = field(repr=False)


@dataclass(frozen=True)
class View:
    """Where one camera sees a target: a window, the middle of the target, its area in px, its likeness."""

    window: Window
    pixel: Floats
    mass: float
    similarity: float


@dataclass(frozen=True)
class _Target:
    """A target; `number` counts targets, `visit` how often it was found again after it was lost."""

    number: int
    visit: int
    colour: Colour
    mass: float
    size: tuple[int, int]
    views: tuple[View | None, View | None]

    @property
    def name(self) -> str:
        return f"{self.number}#{self.visit}" if self.visit else str(self.number)

    @property
    def code(self) -> Floats:
        unseen = np.full(2, np.nan)
        return np.concatenate([unseen if view is None else view.pixel for view in self.views])

    @property
    def seen(self) -> bool:
        return self.views != (None, None)


class ColourTracker(Tracker):
    """Follows targets by the back-projection of their first histogram, of hue and saturation."""

    colour: ClassVar[bool] = True

    def __init__(self, options: MeanshiftTracker | CamshiftTracker) -> None:
        """Follow the targets that `options` name, or the most conspicuous ones."""
        super().__init__()
        self._options = options
        self._gate = EpipolarGate(options.epipolar_px)
        self._targets: list[_Target] = []

    @abstractmethod
    def _moved(self, weights: Image, window: Window) -> Window:
        """Return the window around what the weights (h, w) show near the last window."""

    def step(self, left: Image, right: Image) -> Sightings:
        images = self._both(_hsv, (left, right))
        if not self._targets:
            self._targets = self._begun(images)
        else:
            views = self._both(self._followed, images, (0, 1))
            found = zip(self._targets, *views, strict=True)
            self._targets = self._checked([self._renewed(t, (a, b)) for t, a, b in found])
        seen = [t for t in self._targets if t.seen]
        if not seen:
            return NOTHING
        quality = [min(v.similarity for v in t.views if v is not None) for t in seen]
        return Sightings(
            tuple(t.name for t in seen), np.array([t.code for t in seen]), np.clip(quality, 0.0, 1.0)
        )

    def _begun(self, images: tuple[Image, Image]) -> list[_Target]:
        """Return the first targets, in the left image where they are and in the right one by their colour."""
        check_shown(self._options.regions, images[0])
        given = bool(self._options.regions)
        wanted = len(self._options.regions) if given else self._options.targets
        blobs = islice(_conspicuous(images[0]), wanted + _MOST_BLOBS)
        windows = map(_whole, self._options.regions) if given else blobs
        targets: list[_Target] = []
        for window in windows:
            target = self._target(images[0], window, len(targets))
            if target is None:
                continue
            right = self._found(images[1], target)
            target = replace(target, views=(target.views[0], right))
            if given or (right is not None and len(self._checked([*targets, target])) == len(targets) + 1):
                targets.append(target)
            if len(targets) == wanted:
                break
        return targets

    def _target(self, image: Image, window: Window, number: int) -> _Target | None:
        """Return a target in a window of the left image, None if it has no colour of its own."""
        colour = _colour(image, window)
        if colour is None:
            return None
        size = round(_ROOM * window[2]), round(_ROOM * window[3])
        target = _Target(number, 0, colour, 0.0, size, (None, None))
        view = self._seen(image, target, _centred(_middle(window), size))
        if view is None or view.mass < _LEAST_MASS:
            return None
        look = _histogram(image, _box(view.pixel, view.mass))
        view = replace(view, similarity=1.0)
        return replace(target, colour=replace(colour, look=look), mass=view.mass, views=(view, None))

    def _followed(self, image: Image, camera: int) -> list[View | None]:
        """Return where one camera sees each target now."""
        views = []
        for target in self._targets:
            last = target.views[camera]
            view = None if last is None else self._seen(image, target, last.window)
            if view is None or not self._alike(view, target):
                # Looked for in the whole image only once it has been lost for a frame.
                view = self._found(image, target) if last is None else None
            views.append(view)
        return views

    def _alike(self, view: View, target: _Target) -> bool:
        enough = view.mass >= max(_LEAST_MASS, _LEAST_SHARE * target.mass)
        return enough and view.similarity >= self._options.min_similarity

    def _renewed(self, target: _Target, views: tuple[View | None, View | None]) -> _Target:
        """Return a target as it is seen now, under a new name if it had been lost from both images."""
        again = not target.seen and views != (None, None) and self._options.refound == "new_id"
        return replace(target, views=views, visit=target.visit + again)

    def _checked(self, targets: list[_Target]) -> list[_Target]:
        """Return the targets without views that contradict the rig's geometry or coincide with another's."""
        if not targets:
            return []
        codes = np.array([t.code for t in targets])
        self._gate.learn(codes)
        agree = self._gate.agree(codes)
        kept = []
        for i, target in enumerate(targets):
            views = list(target.views) if agree[i] else [None, None]
            for camera, view in enumerate(views):
                others = np.delete(codes, i, axis=0)[:, 2 * camera : 2 * camera + 2]
                if view is not None and (np.linalg.norm(others - view.pixel, axis=1) < 2.0).any():
                    views[camera] = None
            kept.append(replace(target, views=(views[0], views[1])))
        return kept

    def _seen(self, image: Image, target: _Target, window: Window) -> View | None:
        """Return what is seen of a target near a window."""
        x, y, w, h = window
        reach = max(w, h, 24)
        left, top = max(x - reach, 0), max(y - reach, 0)
        part = image[top : y + h + reach, left : x + w + reach]
        if not part.size:
            return None
        weights = _weights(part, target.colour)
        found = _within(self._moved(weights, (x - left, y - top, w, h)), weights)
        if found is None:
            return None
        moments = cv2.moments(weights[found[1] : found[1] + found[3], found[0] : found[0] + found[2]])
        if moments["m00"] <= 0.0:
            return None
        middle = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        pixel = middle + np.array([found[0] + left, found[1] + top])
        mass = moments["m00"] / 255.0
        box = _box(pixel, mass)
        if _within(box, image) != box:
            return None  # its middle is not the middle of what the image still shows
        look = _histogram(image, box)
        similarity = float(np.sqrt(look * target.colour.look).sum())
        return View((found[0] + left, found[1] + top, found[2], found[3]), pixel, mass, similarity)

    def _found(self, image: Image, target: _Target) -> View | None:
        """Return where in the whole image the target is, None where nothing or no single place is like it."""
        weights = _weights(image, target.colour)
        w, h = target.size
        amount = cv2.boxFilter(weights, cv2.CV_32F, (w, h), normalize=False, borderType=cv2.BORDER_CONSTANT)
        _, most, _, at = cv2.minMaxLoc(amount)
        if most < 255.0 * _LEAST_MASS:
            return None
        view = self._seen(image, target, _centred(np.array(at, float), target.size))
        if view is None or not self._alike(view, target):
            return None
        x, y, w, h = _box(view.pixel, 2.0 * view.mass)
        weights[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)] = 0
        rest = cv2.boxFilter(
            weights, cv2.CV_32F, target.size, normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        return None if float(rest.max()) > _AMBIGUOUS * most else view


def _hsv(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2HSV), np.uint8)


def _coloured(image: Image) -> Image:
    """Return 255 where a pixel of an HSV image has a colour, 0 where it is grey."""
    low = (0, _LEAST_SATURATION, _LEAST_VALUE)
    return np.asarray(cv2.inRange(image, low, (255, 255, 255)), np.uint8)


def _weights(image: Image, colour: Colour) -> Image:
    """Return the back-projection (h, w), 0 to 255."""
    projected = cv2.calcBackProject([image], [0, 1], colour.weights, _RANGES, 1.0)
    return np.asarray(cv2.bitwise_and(projected, _coloured(image)), np.uint8)


def _histogram(image: Image, window: Window) -> NDArray[np.float32]:
    """Return the histogram of a window, sum 1, grey pixels in the first bin."""
    x, y, w, h = window
    part = np.ascontiguousarray(image[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)])
    if not part.size:
        return np.zeros(_BINS, np.float32)
    mask = _coloured(part)
    histogram = np.asarray(cv2.calcHist([part], [0, 1], mask, _BINS, _RANGES), np.float32)
    # Hue is a circle: its ends meet when noise is smoothed away.
    around = np.concatenate([histogram[-1:], histogram, histogram[:1]])
    smooth = np.asarray(cv2.GaussianBlur(around, (3, 3), 0.8), np.float32)[1:-1].copy()
    smooth[0, 0] += mask.size - cv2.countNonZero(mask)
    return smooth / max(float(smooth.sum()), 1e-12)


def _colour(image: Image, window: Window) -> Colour | None:
    """Return the colour of a target in a window, as against what surrounds it; None if all of it is grey."""
    target = _histogram(image, window)
    around = _histogram(image, _centred(_middle(window), (2 * window[2], 2 * window[3])))
    target[0, 0] = around[0, 0] = 0.0
    if target.sum() < 0.1:
        return None
    # The surroundings hold the target, a quarter of them.
    beside = np.maximum(4.0 * around - target, 0.0) / 3.0
    share = np.where(target > 0.02 * target.max(), target / np.maximum(target + beside, 1e-12), 0.0)
    return Colour((255.0 * share).astype(np.float32), target)


def _conspicuous(image: Image) -> Iterator[Window]:
    """Yield windows around blobs of one colour in an HSV image, the most conspicuous first."""
    coloured = _coloured(image)
    found: list[tuple[float, Window]] = []
    for step in range(_HUES):
        centre = (2 * step + 1) * 180 // (2 * _HUES)
        off = (image[..., 0].astype(np.int16) - centre + 90) % 180 - 90
        mask = np.where(np.abs(off) <= 180 // _HUES, coloured, 0).astype(np.uint8)
        mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
        n, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
        for k in range(1, n):
            x, y, w, h, area = stats[k].tolist()
            touches = x == 0 or y == 0 or x + w == image.shape[1] or y + h == image.shape[0]
            if touches or not _SMALLEST_PX <= area <= _LARGEST_SHARE * mask.size:
                continue
            saturation = float(image[y : y + h, x : x + w, 1][labels[y : y + h, x : x + w] == k].mean())
            # Compact blobs of strong colour; area counts little, or the background would win.
            found.append((saturation * area / (w * h) * area**0.25, (x, y, w, h)))
    taken: list[Floats] = []
    for _, window in sorted(found, reverse=True):
        middle = _middle(window)
        if all(np.linalg.norm(middle - other) > max(window[2:]) / 2 for other in taken):
            taken.append(middle)
            yield window


def _whole(region: tuple[float, float, float, float]) -> Window:
    x, y, w, h = region
    return round(x), round(y), max(round(w), 1), max(round(h), 1)


def _middle(window: Window) -> Floats:
    x, y, w, h = window
    return np.array([x + (w - 1) / 2, y + (h - 1) / 2])


def _centred(middle: Floats, size: tuple[int, int]) -> Window:
    w, h = size
    return round(float(middle[0]) - (w - 1) / 2), round(float(middle[1]) - (h - 1) / 2), w, h


def _box(pixel: Floats, mass: float) -> Window:
    """Return a square a little larger than a target of so many pixels."""
    side = max(round(_ROOM * float(np.sqrt(mass))), 3)
    return _centred(pixel, (side, side))


def _within(window: Window, image: Image) -> Window | None:
    """Return the part of a window inside an image, None if there is none."""
    x, y = max(window[0], 0), max(window[1], 0)
    w, h = min(window[0] + window[2], image.shape[1]) - x, min(window[1] + window[3], image.shape[0]) - y
    return (x, y, w, h) if w > 0 and h > 0 else None
