"""What all targets share, learned from motion alone: two camera matrices, and three numbers per target (§4).

The lifted form has up to 38 unknowns per target and needs long, well-excited tracks. Decoupled (§3.3.1), a
target has three, so tracks of a few frames suffice. No intrinsics, no hand–eye and no target are given.
The motions are metric, hence so is the result. What a task cannot see (scale under pure rotation, a common
shift under pure translation, height in the plane) stays where the start put it: no solved motion depends
on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.data.tracks import Tracks
from vmf.estimate import Cameras
from vmf.estimate.noise import BEST_TRACKER_PX, Noise
from vmf.estimate.robust import MEDIAN_OF_NORM
from vmf.geometry import StereoCameras, inverse, stereo_code, triangulate
from vmf.learn.adjustment import (
    Bools,
    Estimate,
    Floats,
    Ints,
    Scene,
    System,
    adjust,
    cauchy,
    linearised,
    normalised,
    pinhole,
    triangulated,
)
from vmf.learn.base import Answer, Arrays, Learner
from vmf.learn.excitation import excitation
from vmf.learn.renewal import Renewal
from vmf.learn.start import NO_NOISE, noise_of, sizes, started
from vmf.tasks import Task

# Free numbers of two camera matrices.
_CAMERAS = 22
_LEAST_FRAMES = 3
_MOST_TARGETS = 4000
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
_SPARE = 3.0
# Pixels further from the image centre than this many image widths are none of that image.
_OUTSIDE = 2.0
# Once there are this many times as many observations as when all was last adjusted, all is adjusted again.
_MORE = 1.25
# While all observations are this few, adjusting all of them is no long delay.
_FEW = 1000
# A pixel with less than this share of its weight is an outlier; so many of them are worth a word.
_LEAST_WEIGHT = 0.25
_WORTH_SAYING = 0.01
_LEAST_DAMPING = 1e-12
# Target and pose of a code that was never visited.
_NEVER = -1, np.eye(4)


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

    def of_pixels(self, pixels: Floats) -> tuple[Floats, Bools]:
        """Return normalised pixels (M, 2, 2) of pixels (M, 4), zero where not seen, and which are seen."""
        normalised = (pixels.reshape(-1, 2, 2) - self.centre) / self.width
        seen = np.asarray((np.abs(normalised) < _OUTSIDE).all(axis=-1))
        return np.where(seen[..., None], normalised, 0.0), seen

    def cameras(self, M: Floats) -> StereoCameras:
        """Return camera matrices for pixels from those (2, 3, 4) for normalised pixels."""
        (x, y), w = self.centre, self.width
        return StereoCameras(np.array([[w, 0.0, x], [0.0, w, y], [0.0, 0.0, 1.0]]) @ M)


@dataclass(frozen=True)
class Settled:
    """What all observations so far have agreed on.

    Attributes
    ----------
    normalisation : of the pixels.
    estimate : cameras, lenses and the targets that agree.
    targets : (K,) which targets these are.
    E_ref : (K, 4, 4) poses in whose frame S the targets are given.
    noise : how pixels scatter.
    scale : noise scale of one camera's normalised pixels, which the adjustment's loss goes by.
    system : normal equations about `about`, None after a restart.
    about : the estimate they are about.
    n_observations : how many observations there were at the last adjustment of all.
    mean_cost : robust cost of a pixel then.
    """

    normalisation: Normalisation
    estimate: Estimate
    targets: Ints
    E_ref: Floats
    noise: Noise
    scale: float
    system: System | None
    about: Estimate
    n_observations: int
    mean_cost: float


class StructuredLearner(Learner):
    """Sparse robust bundle adjustment with known motions; Θ_S is then analytic at the triangulated code.

    While observations are few, all are adjusted again whenever their number has grown by a quarter. In
    between, each new one enters the normal equations about the last adjustment, and later on these are
    renewed bit by bit, at a cost that does not grow. All are adjusted again where a fifth of them belong to
    targets that came later, or where the fit is lost. Where many have been refused, they are tried again
    with a quarter more.

    Parameters
    ----------
    task : the task space.
    distortion : whether a radial distortion of each lens is learned too.
    """

    def __init__(self, task: Task, distortion: bool = False) -> None:
        super().__init__(task)
        self.distortion = distortion
        self._new: list[Tracks] = []
        self._settled: Settled | None = None
        self._renewal: Renewal | None = None
        # Observations in the equations, and those since the last adjustment that have no target there.
        self._taken, self._strange = 0, 0
        self._visited: dict[bytes, tuple[int, Floats]] = {}
        self._losses: tuple[str, ...] = ()

    def _learn(self, block: Tracks) -> None:
        self._new.append(block)
        both = np.isfinite(block.pixels).all(axis=1)
        poses = block.E_S_from_W[block.frame[both]]
        for code, target, E in zip(block.pixels[both], block.target[both].tolist(), poses, strict=True):
            self._visited[code.tobytes()] = target, E

    @property
    def cameras(self) -> StereoCameras | None:
        """Both learned camera matrices (px, m), None while the data do not give them."""
        self._refresh()
        now = self._settled
        return None if now is None else now.normalisation.cameras(now.estimate.M)

    @property
    def noise(self) -> Noise | None:
        self._refresh()
        return None if self._settled is None else self._settled.noise

    @property
    def refused(self) -> str | None:
        self._refresh()
        return "; ".join(self._losses) if self._settled is None and self._losses else None

    @property
    def losses(self) -> tuple[str, ...]:
        self._refresh()
        return self._losses

    def rectified(self, pixels: Floats) -> Floats:
        self._refresh()
        now = self._settled
        if now is None or not now.estimate.radial.any():
            return pixels
        width, centre = now.normalisation.width, now.normalisation.centre
        normalised = (pixels.reshape(*pixels.shape[:-1], 2, 2) - centre) / width
        return (pinhole(normalised, now.estimate.radial) * width + centre).reshape(pixels.shape)

    def parameters(self, codes: ArrayLike, cameras: Cameras = "both") -> Answer:
        codes = np.asarray(codes, float)
        rows = np.full((len(codes), 2, 3, self.task.n_lift + 1), np.nan)
        support = np.zeros(len(codes))
        rig, now = self.cameras, self._settled
        if rig is None or now is None:
            return Answer.approximated(rows, support)
        points, own = self._visited_points(codes, now)
        ok = own.copy()
        if not own.all():
            found = triangulate(rig, codes[~own])
            points[~own], ok[~own] = found.points, found.ok
        rows[ok] = self.task.parameters(rig.M, points[ok][:, None, :])
        # Errors are measured from the code as it was observed, not from where the target truly was (§3).
        offset = (stereo_code(rig, points[own])[0] - codes[own]).reshape(-1, 2, 2)
        rows[own, :, :2] += offset[..., None] * rows[own][:, :, 2:]
        # Every code draws on all targets that agree.
        support[ok] = len(now.targets)
        return Answer(rows, support, own)

    def visited(self, codes: Floats) -> Bools:
        """Return which of the codes (M, 4) are those of targets that agree, as they were observed."""
        self._refresh()
        now = self._settled
        return np.zeros(len(codes), bool) if now is None else self._visited_points(codes, now)[1]

    def _visited_points(self, codes: Floats, now: Settled) -> tuple[Floats, Bools]:
        """Return the targets (M, 3) at codes where they were when they were seen there, and which were."""
        # Bent pixels change with the lens, and so does what was visited.
        visited = {} if self.distortion else self._visited
        seen = [visited.get(code.tobytes(), _NEVER) for code in codes]
        target = np.array([target for target, _ in seen], np.int64)
        k = np.minimum(np.searchsorted(now.targets, target), len(now.targets) - 1)
        own = now.targets[k] == target
        points = np.full((len(codes), 3), np.nan)
        if own.any():
            E = np.stack([E for _, E in seen])[own] @ inverse(now.E_ref[k[own]])
            P = now.estimate.points[k[own], :, None]
            points[own] = (E[:, :3, :3] @ P)[..., 0] + E[:, :3, 3]
        return points, own

    def condition(self, code: ArrayLike) -> float:
        return float("nan")

    def _refresh(self) -> None:
        if not self._new:
            return
        new, self._new = self._new, []
        if self._spread(new) or self._hopeless():
            return
        self._renewal, self._taken, self._strange = None, self.n_observations, 0
        tracks = self.tracks
        assert tracks is not None
        if not np.isfinite(tracks.pixels).all(axis=1).any():
            self._losses = ("no target was seen by both cameras at once",)
            return
        self._adjust_all(tracks)

    def _hopeless(self) -> bool:
        """Whether many observations have just been refused, and hardly any have come since."""
        refused = self._settled is None and bool(self._losses)
        return refused and self.n_observations > _FEW and self.n_observations < _MORE * self._taken

    def _spread(self, new: Sequence[Tracks]) -> bool:
        """Take in blocks at a bounded cost, and return whether that will do."""
        now = self._settled
        if now is None or now.system is None:
            return False
        few = now.n_observations < _FEW
        at_last = now.n_observations if few else self._taken - self._strange
        unsettled = self.n_observations - at_last
        if unsettled >= (_MORE - 1.0) * at_last or any(_larger(block, now.normalisation) for block in new):
            return False
        for block in new:
            end = self._taken + len(block.frame)
            system = self._with_logged(now, now.system, now.about, self._taken, end)
            known = int(np.isin(block.target, now.targets).sum())
            self._strange += len(block.frame) - known
            self._taken = end
            now = replace(now, system=system)
            if not few:
                renewed = self._renewed(now, len(block.frame))
                if renewed is None:
                    return False
                now = renewed
        assert now.system is not None
        self._settled = replace(now, estimate=now.about.moved(*now.system.step(_LEAST_DAMPING)))
        return True

    def _renewed(self, now: Settled, new: int) -> Settled | None:
        """Renew the equations a little after new observations; None where these show that the fit is lost."""
        renewal = self._renewal
        if renewal is None:
            assert now.system is not None
            estimate = now.about.moved(*now.system.step(_LEAST_DAMPING))
            renewal = Renewal.of(normalised(estimate))

        def equations(system: System, about: Estimate, begin: int, end: int) -> System:
            return self._with_logged(now, system, about, begin, end)

        renewal = renewal.went_on(new, self._taken, equations)
        if renewal.done < self._taken:
            self._renewal = renewal
            return now
        self._renewal = None
        system = renewal.system
        each = system.cost / np.maximum(system.seen, 1)
        mean = float(system.cost.sum() / system.seen.sum())
        wrong = float(cauchy(np.array(_WRONG_TARGET**2))[0])
        if mean > _LOST * now.mean_cost or (each > wrong).any():
            return None
        return replace(now, system=system, about=renewal.about)

    def _with_logged(self, now: Settled, system: System, about: Estimate, begin: int, end: int) -> System:
        """Return equations with those of some observations of the log, about the same estimate."""
        target, frame = self._log.target.rows[begin:end], self._log.frame.rows[begin:end]
        k = np.minimum(np.searchsorted(now.targets, target), len(now.targets) - 1)
        some = np.nonzero(now.targets[k] == target)[0]
        if not len(some):
            return system
        some = some[np.argsort(k[some], kind="stable")]
        motions = self._log.E.rows[frame[some]] @ inverse(now.E_ref[k[some]])
        pixels, seen = now.normalisation.of_pixels(self._log.pixels.rows[begin:end][some])
        present, number = np.unique(k[some], return_inverse=True)
        scene = Scene(number.astype(np.int64), motions, pixels, seen, self.distortion)
        # About one estimate all equations leave the same directions free: what no task can see stays unseen.
        more = linearised(scene, replace(about, points=about.points[present]), cauchy, now.scale)
        return system.with_more(more, present)

    def _adjust_all(self, tracks: Tracks) -> None:
        normalisation = Normalisation.of(tracks)
        old = self._settled
        if old is not None:
            # Where the image was taken for too small until now, so was all that was learned with it.
            grown = normalisation.width > _GROWN * old.normalisation.width
            old, normalisation = (None, normalisation) if grown else (old, old.normalisation)
        scene, targets, E_ref = _scene(tracks, normalisation, self.task.closed, self.distortion)
        unknowns = _CAMERAS + 3 * len(targets)
        if not len(targets) or 2 * scene.seen.sum() < _SPARE * unknowns:
            self._refuse(
                f"{2 * scene.seen.sum()} coordinates for {unknowns} unknowns of two cameras and "
                f"{len(targets)} targets are too few"
            )
            return
        warm = None if old is None else _warm_start(scene, targets, old)
        start = started(scene) if warm is None else warm
        if start is None:
            self._refuse("no orientation of the cameras puts the targets in front of them")
            return
        fit = _settled(scene, start, BEST_TRACKER_PX / normalisation.width)
        if old is not None and warm is not None and fit.noise > _LOST * old.scale:
            # Begin again from the orientations.
            self._settled = None
            self._adjust_all(tracks)
            return
        objection = self._objection(tracks, fit)
        if objection is not None:
            self._refuse(objection)
            return
        size, _ = sizes(fit.scene, fit.estimate)
        both = fit.scene.seen.all(axis=1)
        square = np.square(size[both] * normalisation.width).sum(axis=1)
        in_stereo = Noise.of(square * _fitted_away(fit.scene)[both], 4)
        enough = in_stereo.scale_px > NO_NOISE * normalisation.width
        self._settled = Settled(
            normalisation,
            fit.estimate,
            targets[fit.kept],
            E_ref[fit.kept],
            in_stereo if enough else Noise(fit.noise * normalisation.width),
            fit.noise,
            fit.system,
            fit.estimate,
            self.n_observations,
            float(fit.system.cost.sum() / fit.system.seen.sum()),
        )
        finite = np.isfinite(tracks.pixels.reshape(-1, 2, 2)).all(axis=-1)
        outside = int((finite & ~normalisation.of_pixels(tracks.pixels)[1]).sum())
        far = (f"{outside} pixels far outside the image were left out",) if outside else ()
        self._losses = far + _outliers(fit, size)

    def _objection(self, tracks: Tracks, fit: _Fit) -> str | None:
        """Return what speaks against an adjustment, None if nothing does."""
        wrong, n = int((~fit.kept).sum()), len(fit.kept)
        share = fit.noise * MEDIAN_OF_NORM
        disagreement = (
            f"the motions do not explain the images: {wrong} of {n} targets disagree, the others are off by "
            f"{100 * share:.1f} % of the image width; are poses and tracks of one time?"
        )
        if share > _LARGEST_NOISE:
            return disagreement
        # Poor motion can leave targets on both sides of the cameras, so it is asked about first.
        worse = np.square(max(fit.noise, fit.least_noise) / fit.noise)
        shown = excitation(self.task, fit.scene, fit.estimate, fit.system, tracks.E_S_from_W, worse)
        if shown.lacking:
            doubt = "; are poses and tracks of one time?" if shown.nothing_known else ""
            return "the motion is not rich enough: " + ", ".join(shown.lacking) + doubt
        if fit.kept.mean() < _LEAST_AGREEMENT:
            return (
                f"the motions do not explain the images: {wrong} of {n} targets do not agree with the "
                "others; are poses and tracks of one time?"
            )
        return None

    def _refuse(self, why: str) -> None:
        self._settled, self._losses = None, (why,)

    def state(self) -> dict[str, NDArray[Any]]:
        self._refresh()
        arrays = super().state()
        now = self._settled
        if now is None:
            return arrays
        return arrays | {
            "M": now.estimate.M,
            "radial": now.estimate.radial,
            "points": now.estimate.points,
            "targets": now.targets,
            "E_ref": now.E_ref,
            "noise": np.array([now.noise.scale_px, now.noise.freedom, now.scale]),
            "width": np.array(now.normalisation.width),
            "centre": now.normalisation.centre,
            "losses": np.array(self._losses, dtype=str),
        }

    def restore(self, state: Arrays) -> None:
        super().restore(state)
        if "M" not in state:
            return
        values = {name: np.array(state[name], float) for name in ("M", "radial", "points", "E_ref", "noise")}
        targets = np.array(state["targets"], np.int64)
        K = len(targets)
        shapes = {"M": (2, 3, 4), "radial": (2,), "points": (K, 3), "E_ref": (K, 4, 4), "noise": (3,)}
        for name, shape in shapes.items():
            if values[name].shape != shape:
                raise ValueError(f"{name} has shape {values[name].shape}, expected {shape}")
            if not np.isfinite(values[name]).all():
                raise ValueError(f"{name} is not finite")
        estimate = Estimate(values["M"], values["radial"], values["points"])
        normalisation = Normalisation(float(state["width"]), np.array(state["centre"], float))
        scale_px, freedom, scale = values["noise"].tolist()
        self._settled = Settled(
            normalisation,
            estimate,
            targets,
            values["E_ref"],
            Noise(scale_px, freedom),
            scale,
            None,
            estimate,
            self.n_observations,
            np.nan,
        )
        self._losses = tuple(str(loss) for loss in state["losses"])
        self._new = []


def _larger(block: Tracks, normalisation: Normalisation) -> bool:
    """Whether a block's pixels say that the image is larger than was thought."""
    x = block.pixels[:, ::2]
    return block.image_size is None and float(np.nanmax(x, initial=0.0)) + 1.0 > _GROWN * normalisation.width


def _outliers(fit: _Fit, size: Floats) -> tuple[str, ...]:
    """Say what was left out, and what counts for little: residual norms (M, 2) of those kept."""
    said = []
    wrong, n = int((~fit.kept).sum()), len(fit.kept)
    if wrong:
        said.append(f"{wrong} of {n} targets do not agree with the others")
    weight = cauchy(np.square(size[fit.scene.seen] / max(fit.noise, fit.least_noise)))[1]
    light = int((weight < _LEAST_WEIGHT).sum())
    if light > _WORTH_SAYING * len(weight):
        said.append(f"{light} of {len(weight)} pixels of the others are outliers and count for little")
    return tuple(said)


def _warm_start(scene: Scene, targets: Ints, old: Settled) -> Estimate:
    """Return the last estimate with new targets triangulated."""
    points = triangulated(scene, old.estimate.M, old.estimate.radial)
    _, before, now = np.intersect1d(old.targets, targets, return_indices=True)
    points[now] = old.estimate.points[before]
    return replace(old.estimate, points=points)


def _scene(
    tracks: Tracks, normalisation: Normalisation, closed: bool, lenses: bool
) -> tuple[Scene, Ints, Floats]:
    """Return observations of the longest tracks, the targets (K,) they belong to, and these' first poses."""
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
    pixels, seen = normalisation.of_pixels(tracks.pixels[keep])
    renumbered = np.unique(number[keep], return_inverse=True)[1].astype(np.int64)
    return Scene(renumbered, motions, pixels, seen, lenses), targets[chosen], reference[chosen]


@dataclass(frozen=True)
class _Fit:
    """An adjustment: the estimate, what is left of the scene, which targets (K,) were kept, and the noise.

    `least_noise` is what the best tracker has; no data are taken for better.
    """

    estimate: Estimate
    scene: Scene
    kept: Bools
    noise: float
    least_noise: float

    @cached_property
    def system(self) -> System:
        """The normal equations of the estimate."""
        return linearised(self.scene, self.estimate, cauchy, self.noise)


def _fitted_away(scene: Scene) -> Floats:
    """Return the factor (M,) that squared residuals fall short of squared noise by.

    A target takes three of its coordinates' freedoms, both cameras 22 of all.
    """
    each = 2.0 * np.add.reduceat(scene.seen.sum(axis=1), scene.starts)
    spare = 1.0 - 3.0 / each - _CAMERAS / each.sum()
    return np.asarray(1.0 / np.maximum(spare, 1.0 / _SPARE))[scene.target]


def _settled(scene: Scene, start: Estimate, least_noise: float) -> _Fit:
    """Adjust with a redescending loss, which lets wrong pixels go, leave out wrong targets, and adjust."""
    start, _ = adjust(scene, start, cauchy, noise_of(sizes(scene, start)[0]))
    size, front = sizes(scene, start)
    noise = noise_of(size)
    bounds = np.append(scene.starts, len(scene.target))
    median = np.array([np.nanmedian(size[a:b]) for a, b in pairwise(bounds)])
    behind = np.logical_or.reduceat((scene.seen & ~front).any(axis=1), scene.starts)
    kept = (median <= _WRONG_TARGET * max(noise, least_noise)) & ~behind
    if not kept.any():
        return _Fit(start, scene, kept, noise, least_noise)
    scene = scene.select(kept[scene.target])
    now = replace(start, points=start.points[kept])
    for _ in range(_ROUNDS):
        noise = noise_of(sizes(scene, now)[0])
        now, _ = adjust(scene, now, cauchy, noise)
    return _Fit(now, scene, kept, noise_of(sizes(scene, now)[0]), least_noise)
