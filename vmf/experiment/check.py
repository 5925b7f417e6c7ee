"""What a spec asks that only the experiment knows to be impossible."""

from __future__ import annotations

from pathlib import Path

from vmf.data.recording import RecordingData
from vmf.data.simulate import check_drift, check_lost, make_world
from vmf.errors import InputError
from vmf.experiment import protocols
from vmf.experiment.build import check_solver, wants_exact
from vmf.experiment.functions import functions
from vmf.experiment.recorded import recorded_folds
from vmf.spec import Spec


def check(spec: Spec, data: RecordingData | None) -> None:
    """Refuse before any work what could only fail later.

    Parameters
    ----------
    spec : the experiment.
    data : its recording, None for a simulation, or where the recording has not been read.

    Raises
    ------
    InputError : the spec cannot be carried out.
    """
    recorded = spec.data.recording is not None
    for one in functions(spec).values():
        check_solver(one)
        if recorded and wants_exact(one):
            raise InputError(
                "learner.matrices: found exact, which only a simulation knows; observed is accepted"
            )
    check_drift(spec)
    if not recorded:
        make_world(spec)
        check_lost(spec)
    if recorded and spec.evaluate.trials != 1:
        raise InputError(
            f"evaluate.trials: found {spec.evaluate.trials}, a recording is one trial: 1 is accepted"
        )
    if spec.name is not None and Path(spec.name).name != spec.name:
        raise InputError(f"name: found {spec.name!r}, the name of a directory without separators is accepted")
    if recorded and "held_out" in spec.evaluate.protocol and not spec.evaluate.gaps:
        raise InputError("evaluate.gaps: found none, a list of frame counts is accepted")
    if data is not None and spec.evaluate.folds > max(data.tracks.n_frames // 2, 1):
        raise InputError(
            f"evaluate.folds: found {spec.evaluate.folds}, at most half as many blocks as the recording's "
            f"{data.tracks.n_frames} frames are accepted"
        )
    if not spec.evaluate.protocol:
        raise InputError("evaluate.protocol: found none, trained_code and held_out are accepted")
    if spec.data.simulate is not None:
        protocols.checkpoints(spec, spec.data.simulate.frames)
        protocols.beyond(spec, spec.data.simulate.frames)
    elif data is not None:
        fewest = min(len(fold.train) for fold in recorded_folds(spec, data.tracks))
        if fewest < 2:
            raise InputError(
                f"evaluate: {fewest} frames of {data.tracks.n_frames} to learn from, 2 or more are accepted; "
                "raise evaluate.train_fraction"
            )
        protocols.checkpoints(spec, fewest)
        protocols.beyond(spec, fewest)
