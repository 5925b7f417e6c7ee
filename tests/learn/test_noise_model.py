"""The noise that a structured learner reports is that of the pixels, however short the tracks were."""

from __future__ import annotations

import numpy as np
import pytest

from vmf.data.simulate import simulate, trial_streams
from vmf.data.tracks import Tracks
from vmf.learn import StructuredLearner
from vmf.spec import Spec
from vmf.tasks import make_task


def in_short_tracks(tracks: Tracks, each: int) -> Tracks:
    """Call a target by another name after every so many frames."""
    number = tracks.target * (tracks.n_frames // each + 1) + tracks.frame // each
    names, target = np.unique(number, return_inverse=True)
    order = np.lexsort((tracks.frame, target))
    return Tracks(
        tracks.times_ns,
        tracks.E_S_from_W,
        tracks.frame[order],
        target[order].astype(np.int64),
        tracks.pixels[order],
        tuple(str(n) for n in names),
        tracks.image_size,
    )


def learned(each: int | None, px: float = 1.0, frames: int = 360) -> StructuredLearner:
    spec = Spec.model_validate(
        {
            "task": "six_dof",
            "data": {"simulate": {"frames": frames, "targets": 8, "seed": 4}},
            "noise": {"pixel_px": px},
        }
    )
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    learner = StructuredLearner(make_task("six_dof", "general"))
    learner.partial_fit(tracks if each is None else in_short_tracks(tracks, each))
    return learner


@pytest.mark.parametrize("each", [None, 12, 6, 4, 3])
def test_fitting_takes_nothing_off_the_noise(each: int | None) -> None:
    noise = learned(each).noise
    assert noise is not None
    # 11,520 coordinates: a standard error of a hundredth, and some for tails that are learned too.
    assert noise.scale_px * np.sqrt(noise.freedom / (noise.freedom - 2.0)) == pytest.approx(1.0, rel=0.06)


def test_pixels_far_outside_the_image_are_left_out_and_counted() -> None:
    spec = Spec.model_validate({"task": "six_dof", "data": {"simulate": {"frames": 60, "targets": 8}}})
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    wild = tracks.pixels.copy()
    wild[5] = 1e6
    learner = StructuredLearner(make_task("six_dof", "general"))
    learner.partial_fit(
        Tracks(
            tracks.times_ns,
            tracks.E_S_from_W,
            tracks.frame,
            tracks.target,
            wild,
            tracks.ids,
            tracks.image_size,
        )
    )
    assert learner.cameras is not None
    assert learner.losses == ("2 pixels far outside the image were left out",)


def test_poses_that_are_no_numbers_are_refused() -> None:
    spec = Spec.model_validate({"task": "six_dof", "data": {"simulate": {"frames": 10, "targets": 4}}})
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    tracks.E_S_from_W[3, 0, 3] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        StructuredLearner(make_task("six_dof", "general")).partial_fit(tracks)
