"""What all targets share, learned from motion alone: two camera matrices, and three numbers per target (§4).

The lifted form has up to 38 unknowns per target and needs long, well-excited tracks. Decoupled (§3.3.1), a
target has three, so tracks of a few frames suffice. No intrinsics, no hand–eye and no target are given.
The motions are metric, hence so is the result. What a task cannot see (scale under pure rotation, a common
shift under pure translation, height in the plane) stays where the start put it: no solved motion depends
on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, permutations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.data.tracks import Tracks
from vmf.estimate.robust import MEDIAN_OF_NORM
from vmf.geometry import StereoCameras, inverse, triangulate
from vmf.learn.adjustment import (
    Bools,
    Estimate,
    Floats,
    Ints,
    Scene,
    adjust,
    cauchy,
    huber,
    residuals,
    triangulated,
)
from vmf.learn.base import Answer, Arrays, Learner
from vmf.tasks import Task

_LEAST_FRAMES = 3
_MOST_TARGETS = 4000
# How many of the 24 orientations are adjusted before the best is kept.
_CANDIDATES = 3
_ROUNDS = 3
# A target this many σ off in the median follows other things than the robot's motion.
_WRONG_TARGET = 4.0
# Noise above this share of the image width, or fewer targets than this share in agreement, is no noise.
_LARGEST_NOISE = 0.03
_LEAST_AGREEMENT = 0.5
# Pixels this far outside what counted as the image say that it is larger.
_GROWN = 1.1
# A warm start that fits this much worse than before has lost its way.
_LOST = 2.0
# Scalar observations per unknown before an answer is given.
_SPARE = 1.5


@dataclass(frozen=True)
class Normalisation:
    """Normalised pixels `(u − centre) / width` of both cameras."""

    width: float
    centre: Floats

    @classmethod
    def of(cls, tracks: Tracks) -> Normalisation:
        """Take the image size from the tracks, or from their largest pixels where they do not say it."""
        size = np.array(tracks.image_size or np.nanmax(tracks.pixels.reshape(-1, 2), axis=0) + 1.0, float)
        return cls(float(size[0]), (size - 1.0) / 2.0)

    def cameras(self, M: Floats) -> StereoCameras:
        """Return camera matrices for pixels from those (2, 3, 4) for normalised pixels."""
        (x, y), w = self.centre, self.width
        return StereoCameras(np.array([[w, 0.0, x], [0.0, w, y], [0.0, 0.0, 1.0]]) @ M)


class StructuredLearner(Learner):
    """Sparse robust bundle adjustment with known motions; Θ_S is then analytic at the triangulated code.

    Parameters
    ----------
    task : the task space.
    """

    def __init__(self, task: Task) -> None:
        super().__init__(task)
        self._fresh = True
        self._normalisation: Normalisation | None = None
        self._estimate: Estimate | None = None
        self._targets: Ints = np.zeros(0, np.int64)
        self._noise = np.nan
        self._losses: tuple[str, ...] = ()

    def _learn(self, block: Tracks) -> None:
        self._fresh = False

    @property
    def cameras(self) -> StereoCameras | None:
        """Both learned camera matrices (px, m), None while the data do not give them."""
        self._refresh()
        if self._estimate is None or self._normalisation is None:
            return None
        return self._normalisation.cameras(self._estimate.M)

    @property
    def noise_px(self) -> float | None:
        self._refresh()
        if self._estimate is None or self._normalisation is None:
            return None
        return self._noise * self._normalisation.width

    @property
    def losses(self) -> tuple[str, ...]:
        self._refresh()
        return self._losses

    def parameters(self, codes: ArrayLike) -> Answer:
        codes = np.asarray(codes, float)
        rows = np.full((len(codes), 2, 3, self.task.n_lift + 1), np.nan)
        support = np.zeros(len(codes))
        cameras = self.cameras
        if cameras is None:
            return Answer(rows, support)
        found = triangulate(cameras, codes)
        rows[found.ok] = self.task.parameters(cameras.M, found.points[found.ok][:, None, :])
        # Every code draws on all targets that agree.
        support[found.ok] = len(self._targets)
        return Answer(rows, support)

    def condition(self, code: ArrayLike) -> float:
        return float("nan")

    def _refresh(self) -> None:
        if self._fresh or self.tracks is None:
            return
        self._fresh = True
        if not np.isfinite(self.tracks.pixels).all(axis=1).any():
            self._losses = ("no target was seen by both cameras at once",)
            return
        normalisation = self._normalise(Normalisation.of(self.tracks))
        scene, targets = _scene(self.tracks, normalisation, self.task.closed)
        unknowns = 22 + 3 * len(targets)
        if not len(targets) or 2 * scene.seen.sum() < _SPARE * unknowns:
            self._estimate = None
            self._losses = (
                f"{2 * scene.seen.sum()} coordinates for {unknowns} unknowns of two cameras and "
                f"{len(targets)} targets are too few",
            )
            return
        self._solve(scene, targets)

    def _normalise(self, new: Normalisation) -> Normalisation:
        """Take a new image size; where it was too small until now, so was all that was learned with it."""
        old = self._normalisation
        if old is not None and new.width <= _GROWN * old.width:
            return old
        self._normalisation, self._estimate = new, None
        return new

    def _solve(self, scene: Scene, targets: Ints) -> None:
        warm = self._warm_start(scene, targets)
        start = _started(scene) if warm is None else warm
        if start is None:
            self._estimate = None
            self._losses = ("no orientation of the cameras puts the targets in front of them",)
            return
        estimate, scene, kept, noise = _settled(scene, start)
        if warm is not None and noise > _LOST * self._noise:
            self._estimate, self._noise = None, np.nan
            self._solve(scene, targets)
            return
        wrong = int((~kept).sum())
        share = noise * MEDIAN_OF_NORM
        if share > _LARGEST_NOISE or kept.mean() < _LEAST_AGREEMENT:
            self._estimate = None
            self._losses = (
                f"the motions do not explain the images: {wrong} of {len(kept)} targets disagree, the others "
                f"are off by {100 * share:.1f} % of the image width; are poses and tracks of one time?",
            )
            return
        self._estimate, self._targets, self._noise = estimate, targets[kept], noise
        self._losses = (f"{wrong} of {len(kept)} targets do not agree with the others",) if wrong else ()

    def _warm_start(self, scene: Scene, targets: Ints) -> Estimate | None:
        """Return the last estimate with new targets triangulated, None without one."""
        if self._estimate is None:
            return None
        points = triangulated(scene, self._estimate.M)
        _, old, mine = np.intersect1d(self._targets, targets, return_indices=True)
        points[mine] = self._estimate.points[old]
        return Estimate(self._estimate.M, points)

    def state(self) -> dict[str, NDArray[Any]]:
        self._refresh()
        arrays = super().state()
        if self._estimate is None or self._normalisation is None:
            return arrays
        return arrays | {
            "M": self._estimate.M,
            "points": self._estimate.points,
            "targets": self._targets,
            "noise": np.array(self._noise),
            "width": np.array(self._normalisation.width),
            "centre": self._normalisation.centre,
            "losses": np.array(self._losses, dtype=str),
        }

    def restore(self, state: Arrays) -> None:
        super().restore(state)
        if "M" not in state:
            return
        self._estimate = Estimate(np.array(state["M"], float), np.array(state["points"], float))
        self._targets = np.array(state["targets"], np.int64)
        if self._estimate.M.shape != (2, 3, 4) or self._estimate.points.shape != (len(self._targets), 3):
            raise ValueError(f"M {self._estimate.M.shape}, points {self._estimate.points.shape} do not fit")
        self._noise = float(state["noise"])
        if not (np.isfinite(self._estimate.M).all() and np.isfinite(self._noise)):
            raise ValueError("M or noise is not finite")
        self._normalisation = Normalisation(float(state["width"]), np.array(state["centre"], float))
        self._losses = tuple(str(loss) for loss in state["losses"])
        self._fresh = True


def _scene(tracks: Tracks, normalisation: Normalisation, closed: bool) -> tuple[Scene, Ints]:
    """Return the observations of the longest tracks and the targets (K,) they belong to."""
    targets, first, n = np.unique(tracks.target, return_index=True, return_counts=True)
    chosen = np.asarray(n >= _LEAST_FRAMES)
    if chosen.sum() > _MOST_TARGETS:
        longest = np.argsort(-n, kind="stable")[:_MOST_TARGETS]
        chosen[:] = False
        chosen[longest] = True
    # Only a closed task may measure poses from any other; pan-tilt poses stay absolute (C3).
    E = tracks.E_S_from_W
    reference = E[tracks.frame[first]] if closed else np.broadcast_to(np.eye(4), (len(targets), 4, 4))
    number = np.searchsorted(targets, tracks.target)
    keep = chosen[number]
    motions = E[tracks.frame[keep]] @ inverse(reference)[number[keep]]
    pixels = tracks.pixels[keep].reshape(-1, 2, 2)
    seen = np.asarray(np.isfinite(pixels).all(axis=-1))
    pixels = np.where(seen[..., None], (pixels - normalisation.centre) / normalisation.width, 0.0)
    renumbered = np.unique(number[keep], return_inverse=True)[1].astype(np.int64)
    return Scene(renumbered, motions, pixels, seen), targets[chosen]


def _orientations() -> Floats:
    """The 24 rotations (24, 3, 3) that take axes to axes."""
    matrices = []
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[range(3), axes] = signs
        if np.linalg.det(R) > 0.0:
            matrices.append(R)
    return np.stack(matrices)


def _sizes(scene: Scene, now: Estimate) -> tuple[Floats, Bools]:
    """Residual norms (M, 2), NaN where not seen, and which observations are in front."""
    r, depth = residuals(scene, now)
    size = np.where(scene.seen, np.linalg.norm(r, axis=-1), np.nan)
    return size, depth > 0.0


def _noise_of(size: Floats) -> float:
    return max(float(np.nanmedian(size)) / MEDIAN_OF_NORM, 1e-9)


def _started(scene: Scene) -> Estimate | None:
    """Start from the 24 axis-aligned orientations with the focal length of one image width.

    They are ranked by median reprojection error, an observation behind its camera counting as a whole image
    off; the best few are adjusted before one is kept, since with forward motion the right one wins narrowly.
    """
    starts = []
    for R in _orientations():
        M = np.broadcast_to(np.column_stack([R, np.zeros(3)]), (2, 3, 4))
        start = Estimate(M, triangulated(scene, M))
        size, front = _sizes(scene, start)
        starts.append((_noise_of(np.where(scene.seen & ~front, 1.0, size)), start))
    starts.sort(key=lambda pair: pair[0])
    ends = []
    for noise, candidate in starts[:_CANDIDATES]:
        now = candidate
        for _ in range(_ROUNDS):
            now, _ = adjust(scene, now, huber, noise)
            noise = _noise_of(_sizes(scene, now)[0])
        size, front = _sizes(scene, now)
        ends.append((_noise_of(np.where(scene.seen & ~front, 1.0, size)), now))
    noise, best = min(ends, key=lambda pair: pair[0])
    return best if noise * MEDIAN_OF_NORM < 1.0 else None


def _settled(scene: Scene, start: Estimate) -> tuple[Estimate, Scene, Bools, float]:
    """Leave out wrong targets, then adjust with a redescending loss.

    Returns the estimate, what is left of the scene, which targets (K,) were kept, and the noise.
    """
    size, front = _sizes(scene, start)
    noise = _noise_of(size)
    bounds = np.append(scene.starts, len(scene.target))
    median = np.array([np.nanmedian(size[a:b]) for a, b in pairwise(bounds)])
    behind = np.logical_or.reduceat((scene.seen & ~front).any(axis=1), scene.starts)
    kept = (median <= _WRONG_TARGET * noise) & ~behind
    if not kept.any():
        return start, scene, kept, noise
    scene = scene.select(kept[scene.target])
    now = Estimate(start.M, start.points[kept])
    for _ in range(_ROUNDS):
        noise = _noise_of(_sizes(scene, now)[0])
        now, _ = adjust(scene, now, cauchy, noise)
    return now, scene, kept, _noise_of(_sizes(scene, now)[0])
