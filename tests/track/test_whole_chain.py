"""From images to motions: what trackers see is as good to learn from as the truth with their noise on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from films import SETTINGS, compared, followed, shot

from vmf.data.simulate import held_out_queries
from vmf.data.tracks import Tracks
from vmf.experiment.asking import answer
from vmf.experiment.build import build_learner
from vmf.geometry import motion
from vmf.spec import Spec

FRAMES, QUERIES, DRAWS = 60, 120, 6
# Of the error of a learner that had the true pixels, with the same noise on them.
MOST = 1.2


def medians(spec: Spec, tracks: Tracks) -> np.ndarray:
    """Median errors in angle (rad) and distance (m) of motions between new views of new targets."""
    learner = build_learner(spec)
    learner.partial_fit(tracks)
    query = held_out_queries(spec, np.random.default_rng(5))
    E = answer(spec, learner, query).E_to_from
    angle = motion.rotation_angle(motion.inverse(query.truth) @ E)
    distance = np.linalg.norm(E[:, :3, 3] - query.truth[:, :3, 3], axis=1)
    return np.array([np.median(angle), np.median(distance)])


@pytest.mark.long
@pytest.mark.parametrize("kind", ["aruco", "klt", "meanshift"])
def test_tracks_are_as_good_as_true_pixels_with_their_noise(kind: str) -> None:
    of = shot(kind, frames=FRAMES)
    options = ("corners=50",) if kind == "klt" else SETTINGS.get(kind, ())
    both = compared(kind, of, followed(kind, of, *options))
    noise = both.rms_px
    spec = of.spec.model_copy(
        update={
            "noise": of.spec.noise.model_copy(update={"pixel_px": noise}),
            "evaluate": of.spec.evaluate.model_copy(update={"queries": QUERIES}),
        }
    )
    tracked = medians(spec, both.tracks)
    seen = np.isfinite(both.tracks.pixels)
    ideal = []
    for seed in range(DRAWS):
        rng = np.random.default_rng(seed)
        noisy = both.true + noise * rng.standard_normal(both.true.shape)
        ideal.append(medians(spec, replace(both.tracks, pixels=np.where(seen, noisy, np.nan))))
    assert (tracked <= MOST * np.mean(ideal, axis=0)).all(), (tracked / np.mean(ideal, axis=0), noise)
