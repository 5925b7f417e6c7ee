"""`vmf simulate`: a simulated robot as a recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from vmf.data import Tracks
from vmf.data.recording import TRUE_TRACKS_TOPIC, CompressedImages, Extras, write
from vmf.data.recording.output import check_target
from vmf.data.simulate import Simulation, image_stream, simulate, trial_streams
from vmf.errors import InputError
from vmf.experiment.cameras import about, known_cameras
from vmf.experiment.filmed import observe
from vmf.progress import Report
from vmf.spec import LoadedSpec, Spec, dump


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
