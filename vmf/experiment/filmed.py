"""Simulated data that go through images: rendered, and tracked, on the way to the learner."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vmf.data import Tracks
from vmf.data.simulate import Simulation, image_stream, simulate
from vmf.data.tracks import from_dense
from vmf.data.workspace import codes
from vmf.errors import InputError
from vmf.experiment.protocols import pixels_of
from vmf.spec import Spec

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Filmed:
    """A simulation as it was seen, and what is to be said of that."""

    simulation: Simulation
    notes: tuple[str, ...] = ()


def observe(spec: Spec, trial: int, rng: np.random.Generator) -> Filmed:
    """Simulate what a trial learns from, through images where the spec says so.

    Raises
    ------
    InputError : the workspace hardly ever shows all targets, or the tracker finds none of them.
    """
    simulation = simulate(spec, rng)
    source = spec.data.simulate
    assert source is not None
    if source.tracker is None:
        return Filmed(simulation)
    seen, points = _tracked(spec, simulation, image_stream(spec, trial))
    return _as_seen(simulation, seen, points, source.tracker.kind)


def _tracked(spec: Spec, simulation: Simulation, rng: np.random.Generator) -> tuple[Tracks, Floats]:
    """Return what the tracker makes of the film, frame by frame, and the true point (K, 3) of each target.

    A target of the tracker is the drawn point that it is nearest to in the median over its frames.
    """
    # Images are for few; OpenCV takes its time to load.
    from vmf.data.render import film, grey
    from vmf.track import make_tracker

    source = spec.data.simulate
    assert source is not None
    assert source.tracker is not None
    shot = film(simulation, source, rng)
    found: dict[str, Floats] = {}
    n = len(simulation.E_true)
    with make_tracker(source.tracker) as tracker:
        for i, (left, right) in enumerate(shot.frames()):
            pair = (left, right) if tracker.colour else (grey(left), grey(right))
            sightings = tracker.step(*pair)
            for name, pixel in zip(sightings.ids, sightings.pixels, strict=True):
                found.setdefault(name, np.full((n, 4), np.nan))[i] = pixel
    if not found:
        raise InputError(
            f"data.simulate.tracker: {source.tracker.kind} found no target in {n} rendered frames; "
            "larger targets (data.simulate.images.size_m) or nearer ones may help"
        )
    pixels = np.stack(list(found.values()), axis=1)
    true = pixels_of(shot.tracks, np.arange(shot.tracks.n_targets))
    nearest = []
    for k in range(pixels.shape[1]):
        off = np.linalg.norm(true - pixels[:, k : k + 1], axis=-1)
        known = np.isfinite(off).any(axis=0)
        median = np.full(off.shape[1], np.inf)
        median[known] = np.nanmedian(off[:, known], axis=0)
        nearest.append(int(np.argmin(median)))
    seen = simulation.tracks
    tracks = from_dense(seen.times_ns, seen.E_S_from_W, pixels, tuple(found), seen.image_size)
    return tracks, shot.scene.points[nearest]


def _as_seen(simulation: Simulation, seen: Tracks, points: Floats, kind: str) -> Filmed:
    """Return the simulation with the tracker's targets for its own."""
    clean, _ = codes(simulation.world.cameras, simulation.E_true, points)
    pixels = pixels_of(seen, np.arange(seen.n_targets))
    exact = from_dense(seen.times_ns, seen.E_S_from_W, pixels, seen.ids, seen.image_size, clean)
    off = pixels - clean
    rms = float(np.sqrt(np.nanmean(np.square(off))))
    both = np.asarray(np.isfinite(pixels).all(axis=-1))
    share = float(np.mean(both.any(axis=1)))
    note = (
        f"{kind}: {seen.n_targets} targets, in both images of {100 * share:.1f} % of the frames, "
        f"{rms:.2g} px off in root mean square"
    )
    noise_px = np.where(np.isfinite(off), off, 0.0)
    return Filmed(
        replace(simulation, tracks=exact, targets_W=points, clean=clean, noise_px=noise_px), (note,)
    )
