"""`vmf simulate`: a simulated robot as a recording."""

from __future__ import annotations

from pathlib import Path

from vmf.data import Tracks
from vmf.data.recording import write
from vmf.data.simulate import simulate, trial_streams
from vmf.errors import InputError
from vmf.spec import LoadedSpec, dump


def write_simulation(loaded: LoadedSpec, path: Path) -> Tracks:
    """Write what trial 0 of a spec observes, so that training from the file equals training directly.

    Raises
    ------
    InputError : the spec's data are not simulated, or the file cannot be written.
    """
    spec = loaded.spec
    if spec.data.simulate is None:
        raise InputError(f"{loaded.path}: data: found recording, simulate is accepted here")
    if path.suffix != ".mcap":
        raise InputError(f"-o {path}: found a name without .mcap, FILE.mcap is accepted")
    for_training, _ = trial_streams(spec, 0)
    simulation = simulate(spec, for_training)
    write(path, simulation.tracks, simulation.poses, spec.mounting, attachment=dump(spec))
    return simulation.tracks
