"""`vmf simulate`: a simulated robot as a recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vmf.data import Tracks
from vmf.data.recording import TRUE_TRACKS_TOPIC, CompressedImages, Extras, write
from vmf.data.recording.output import check_target
from vmf.data.simulate import Simulation, image_stream, simulate, trial_streams
from vmf.errors import InputError
from vmf.experiment.cameras import about, known_cameras
from vmf.experiment.filmed import observe
from vmf.progress import Report
from vmf.spec import LoadedSpec, Spec, dump

# Median step at which klt keeps two thirds of its tracks from frame to frame, and other trackers no more.
_MOST_STEP_PX = 50.0


def write_simulation(
    loaded: LoadedSpec, path: Path, images: bool = False, progress: Report | None = None
) -> Tracks:
    """Write what trial 0 of a spec observes, so that training from the file equals training directly.

    With `images`, both cameras' images are written, and as tracks the true pixels of what they show.

    Raises
    ------
    InputError : the spec's data are not simulated, or the file cannot be written.
    """
    spec = loaded.spec
    if spec.data.simulate is None:
        raise InputError(f"{loaded.path}: data: found recording, simulate is accepted here")
    check_target(path, "-o")
    for_training, _ = trial_streams(spec, 0)
    if images:
        return _write_film(spec, simulate(spec, for_training), path, progress)
    simulation = observe(spec, 0, for_training).simulation
    extras = Extras(about(spec), known_cameras(spec, simulation.world.image_size))
    write(path, simulation.tracks, simulation.poses, spec.mounting, attachment=dump(spec), extras=extras)
    return simulation.tracks


def hard_to_follow(tracks: Tracks) -> str | None:
    """Return what to say of a film whose targets move too far from frame to frame, None if they do not."""
    pixels = np.full((tracks.n_frames, tracks.n_targets, 2), np.nan)
    pixels[tracks.frame, tracks.target] = tracks.pixels[:, :2]
    steps = np.linalg.norm(np.diff(pixels, axis=0), axis=2)
    steps = steps[np.isfinite(steps)]
    if len(steps) and np.median(steps) <= _MOST_STEP_PX:
        return None
    far = f"targets move {np.median(steps):.0f} px" if len(steps) else "no target stays in sight"
    return (
        f"{far} from frame to frame, too far for klt, sift, meanshift and camshift to follow; "
        "data.simulate.motion=hand_guided and a higher data.simulate.rate_hz bring them nearer"
    )


def _write_film(spec: Spec, simulation: Simulation, path: Path, progress: Report | None) -> Tracks:
    from vmf.data.images import encoded
    from vmf.data.render import film

    assert spec.data.simulate is not None
    shot = film(simulation, spec.data.simulate, image_stream(spec))
    form, quality, n = shot.images.format, shot.images.jpeg_quality, shot.tracks.n_frames

    def pairs() -> Iterator[tuple[bytes, bytes]]:
        for i, (left, right) in enumerate(shot.frames()):
            yield encoded(left, form, quality), encoded(right, form, quality)
            if progress is not None:
                progress(i + 1, n, "image pairs")

    write(
        path,
        shot.tracks,
        simulation.poses,
        spec.mounting,
        attachment=dump(spec),
        images=CompressedImages(form, pairs()),
        tracks_topic=TRUE_TRACKS_TOPIC,
        extras=Extras(about(spec), known_cameras(spec, simulation.world.image_size, shot.images.distortion)),
    )
    return shot.tracks
