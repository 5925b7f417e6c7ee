"""Targets of one colour: what mean-shift and CAMShift trackers share."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from itertools import islice
from typing import ClassVar

import cv2
import numpy as np

from vmf.spec.images import CamshiftTracker, MeanshiftTracker
from vmf.track.base import NOTHING, Floats, Image, Sightings, Tracker
from vmf.track.blobs import conspicuous
from vmf.track.colour_histogram import Colour, back_projection, colour_in, histogram, to_hsv
from vmf.track.epipolar import EpipolarGate
from vmf.track.region import check_shown
from vmf.track.window import Window, centred, middle, whole, within

# A window is that much wider than the target, so that it still holds it when it has moved or grown.
_ROOM = 1.4
# A target is lost when less than this of its area remains, or when it is only a few pixels large.
_LEAST_SHARE, _LEAST_MASS = 0.08, 10.0
# A second place that shows this much of the colour leaves it open which one is the target.
_AMBIGUOUS = 0.6
# Of blobs beyond these none is conspicuous, and each is looked for in a whole image.
_MOST_BLOBS = 50


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
        images = self._both(to_hsv, (left, right))
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
        blobs = islice(conspicuous(images[0]), wanted + _MOST_BLOBS)
        windows = map(whole, self._options.regions) if given else blobs
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
        colour = colour_in(image, window)
        if colour is None:
            return None
        size = round(_ROOM * window[2]), round(_ROOM * window[3])
        target = _Target(number, 0, colour, 0.0, size, (None, None))
        view = self._seen(image, target, centred(middle(window), size))
        if view is None or view.mass < _LEAST_MASS:
            return None
        look = histogram(image, _box(view.pixel, view.mass))
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
        weights = back_projection(part, target.colour)
        found = within(self._moved(weights, (x - left, y - top, w, h)), weights)
        if found is None:
            return None
        moments = cv2.moments(weights[found[1] : found[1] + found[3], found[0] : found[0] + found[2]])
        if moments["m00"] <= 0.0:
            return None
        middle = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        pixel = middle + np.array([found[0] + left, found[1] + top])
        mass = moments["m00"] / 255.0
        box = _box(pixel, mass)
        if within(box, image) != box:
            return None  # its middle is not the middle of what the image still shows
        look = histogram(image, box)
        similarity = float(np.sqrt(look * target.colour.look).sum())
        return View((found[0] + left, found[1] + top, found[2], found[3]), pixel, mass, similarity)

    def _found(self, image: Image, target: _Target) -> View | None:
        """Return where in the whole image the target is, None where nothing or no single place is like it."""
        weights = back_projection(image, target.colour)
        w, h = target.size
        amount = cv2.boxFilter(weights, cv2.CV_32F, (w, h), normalize=False, borderType=cv2.BORDER_CONSTANT)
        _, most, _, at = cv2.minMaxLoc(amount)
        if most < 255.0 * _LEAST_MASS:
            return None
        view = self._seen(image, target, centred(np.array(at, float), target.size))
        if view is None or not self._alike(view, target):
            return None
        x, y, w, h = _box(view.pixel, 2.0 * view.mass)
        weights[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)] = 0
        rest = cv2.boxFilter(
            weights, cv2.CV_32F, target.size, normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        return None if float(rest.max()) > _AMBIGUOUS * most else view


def _box(pixel: Floats, mass: float) -> Window:
    """Return a square a little larger than a target of so many pixels."""
    side = max(round(_ROOM * float(np.sqrt(mass))), 3)
    return centred(pixel, (side, side))
