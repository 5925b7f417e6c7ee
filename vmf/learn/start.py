"""Where adjustment starts: cameras along the axes, with every target in front of them (§4)."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np

from vmf.estimate.robust import MEDIAN_OF_NORM
from vmf.geometry import inverse
from vmf.learn.adjustment import Bools, Estimate, Floats, Scene, adjust, huber, residuals, triangulated

# How many orientations are adjusted at least, and how many of the best are adjusted to all observations.
_CANDIDATES = 3
_ROUNDS = 3
# Observations that orientations are first adjusted to: of so many targets, so many each.
_FEW_TARGETS, _FEW_EACH = 32, 40
# Two orientations that end this close together have found the same optimum; one that ends further off than
# this is not the right one.
_SAME, _FAR = 1.01, 1.5
# Normalised pixels without noise.
NO_NOISE = 1e-9


def started(scene: Scene) -> Estimate | None:
    """Start from the 24 axis-aligned orientations with the focal length of one image width.

    They are ranked by median reprojection error, an observation behind its camera counting as a whole image
    off, and adjusted to some of the observations until two agree on the least error. Those that end nearly
    as well are adjusted to all observations before one is kept, since with forward motion the right one
    wins narrowly. None if nothing is in front of any.
    """
    few = _thinned(scene)
    starts = [_in_front(few, _along(few, R)) for R in _orientations()]
    starts.sort(key=lambda start: _misfit(few, start))
    ends: list[tuple[float, Estimate]] = []
    for start in starts:
        end = _adjusted(few, start)
        ends.append((_misfit(few, end), end))
        ends.sort(key=lambda pair: pair[0])
        if len(ends) >= _CANDIDATES and ends[1][0] <= _SAME * ends[0][0]:
            break
    best = [_adjusted(scene, _on_all(scene, end)) for end in _distinct(ends)]
    chosen = min(best, key=lambda end: _misfit(scene, end))
    return chosen if _misfit(scene, chosen) * MEDIAN_OF_NORM < 1.0 else None


def sizes(scene: Scene, now: Estimate) -> tuple[Floats, Bools]:
    """Return residual norms (M, 2), NaN where not seen, and which observations are in front."""
    r, depth = residuals(scene, now)
    size = np.where(scene.seen, np.linalg.norm(r, axis=-1), np.nan)
    return size, depth > 0.0


def noise_of(size: Floats) -> float:
    """Return the robust noise scale of residual norms (M, 2)."""
    return max(float(np.nanmedian(size)) / MEDIAN_OF_NORM, NO_NOISE)


def _misfit(scene: Scene, now: Estimate) -> float:
    size, front = sizes(scene, now)
    return noise_of(np.where(scene.seen & ~front, 1.0, size))


def _orientations() -> Floats:
    """The 24 rotations (24, 3, 3) that take axes to axes."""
    matrices = []
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[range(3), axes] = signs
        if np.linalg.det(R) > 0.0:
            matrices.append(R)
    return np.stack(matrices)


def _along(scene: Scene, R: Floats) -> Estimate:
    M = np.broadcast_to(np.column_stack([R, np.zeros(3)]), (2, 3, 4))
    return Estimate(M, np.zeros(2), triangulated(scene, M, np.zeros(2)))


def _adjusted(scene: Scene, start: Estimate) -> Estimate:
    """Adjust with Huber's loss; targets that end behind the cameras are put in front and adjusted again."""
    noise = _misfit(scene, start)
    now, _ = adjust(scene, start, huber, noise)
    for _ in range(_ROUNDS - 1):
        now = _in_front(scene, now)
        now, _ = adjust(scene, now, huber, noise_of(sizes(scene, now)[0]))
    return now


def _in_front(scene: Scene, now: Estimate) -> Estimate:
    """Put targets that are mostly behind the cameras onto the ray of their first observation.

    Their depth is that of the other targets. A projective camera fits such targets nearly as well, and no
    small step brings them back through infinity.
    """
    _, depth = residuals(scene, now)
    signs = np.add.reduceat(np.where(scene.seen, np.sign(depth), 0.0).sum(axis=1), scene.starts)
    behind = signs <= 0.0
    if not behind.any():
        return now
    first = scene.starts
    seen = scene.seen[first]
    camera = np.where(seen[:, 0], 0, 1)
    ahead = depth[first, camera][~behind]
    ahead = ahead[ahead > 0.0]
    far = float(np.median(ahead)) if len(ahead) else 1.0
    pixel = scene.pixels[first, camera]
    M = now.M[camera]
    projected = far * np.concatenate([pixel, np.ones((len(pixel), 1))], axis=1)
    in_S = np.linalg.solve(M[:, :, :3], (projected - M[:, :, 3])[..., None])
    back = inverse(scene.E[first])
    points = (back[:, :3, :3] @ in_S)[..., 0] + back[:, :3, 3]
    return replace(now, points=np.where(behind[:, None], points, now.points))


def _thinned(scene: Scene) -> Scene:
    """Return some observations of some targets, spread evenly over both."""
    n = len(scene.starts)
    chosen = np.unique(np.linspace(0, n - 1, min(n, _FEW_TARGETS)).round().astype(np.int64))
    bounds = np.append(scene.starts, len(scene.target))
    keep = np.zeros(len(scene.target), bool)
    for first, last in zip(bounds[chosen], bounds[chosen + 1], strict=True):
        keep[np.unique(np.linspace(first, last - 1, _FEW_EACH).round().astype(np.int64))] = True
    return scene.select(keep)


def _on_all(scene: Scene, few: Estimate) -> Estimate:
    """Return cameras learned from some observations with all targets."""
    everything = replace(few, points=triangulated(scene, few.M, few.radial))
    return _in_front(scene, everything)


def _distinct(ends: list[tuple[float, Estimate]]) -> list[Estimate]:
    """Return the best ends that differ, of ends by increasing misfit."""
    chosen: list[tuple[float, Estimate]] = []
    for misfit, end in ends:
        near = len(chosen) < _CANDIDATES and misfit <= _FAR * ends[0][0]
        if near and (not chosen or misfit > _SAME * chosen[-1][0]):
            chosen.append((misfit, end))
    return [end for _, end in chosen]
