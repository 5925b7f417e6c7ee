"""From images to motions: what trackers see is as good to learn from as the truth with their noise on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from films import compared, followed, shot

from vmf.data.tracks import Tracks
from vmf.experiment.asking import answer
from vmf.experiment.build import build_learner
from vmf.experiment.protocols import held_out_pairs
from vmf.geometry import motion
from vmf.spec import Spec

# Six seconds to learn from, long enough for the motion to be rich, and three to ask about.
TRAIN, ASK, RATE_HZ, GAPS, DRAWS = 60, 30, 10.0, (3, 5, 8), 6
# Of the error of a learner that had the true pixels, with the same noise on them.
MOST = 1.2
OPTIONS = {"klt": ("corners=50",), "sift": ("features=200",), "meanshift": ("targets=4", "refound=same_id")}
# Four blobs are all there are: one more than the motion needs would be asking for too much.
LEAST_TARGETS = {"meanshift": 3}


def medians(spec: Spec, tracks: Tracks) -> np.ndarray:
    """Median errors in angle (rad) and distance (m) of motions between later views, as tracked."""
    learner = build_learner(spec)
    learner.partial_fit(tracks.select_frames(0, TRAIN))
    asked = held_out_pairs(spec, tracks, np.arange(TRAIN, TRAIN + ASK), 0)
    assert sum(len(a.query) for a in asked) >= ASK
    off = []
    for query in (a.query for a in asked):
        E = answer(spec, learner, query).E_to_from
        solved = np.isfinite(E).all(axis=(1, 2))
        wrong = np.full((2, len(E)), np.inf)
        wrong[0, solved] = motion.rotation_angle(motion.inverse(query.truth[solved]) @ E[solved])
        wrong[1, solved] = np.linalg.norm(E[solved, :3, 3] - query.truth[solved, :3, 3], axis=1)
        off.append(wrong)
    return np.asarray(np.median(np.concatenate(off, axis=1), axis=1))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["aruco", "klt", "sift", "meanshift"])
def test_tracks_are_as_good_as_true_pixels_with_their_noise(kind: str) -> None:
    of = shot(kind, frames=TRAIN + ASK, rate_hz=RATE_HZ)
    both = compared(kind, of, followed(kind, of, *OPTIONS.get(kind, ())))
    noise = both.rms_px
    evaluate = {"gaps": GAPS, "min_targets": LEAST_TARGETS.get(kind)}
    spec = of.spec.model_copy(update={"evaluate": of.spec.evaluate.model_copy(update=evaluate)})
    tracked = medians(spec, both.tracks)
    seen = np.isfinite(both.tracks.pixels)
    ideal = []
    for seed in range(DRAWS):
        rng = np.random.default_rng(seed)
        noisy = both.true + noise * rng.standard_normal(both.true.shape)
        ideal.append(medians(spec, replace(both.tracks, pixels=np.where(seen, noisy, np.nan))))
    assert (tracked <= MOST * np.mean(ideal, axis=0)).all(), (tracked / np.mean(ideal, axis=0), noise)
