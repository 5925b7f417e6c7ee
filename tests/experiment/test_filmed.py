"""Simulated data that go through images on the way: what the tracker sees is near what is there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from vmf.data.simulate import trial_streams
from vmf.errors import InputError
from vmf.experiment.filmed import Filmed, observe
from vmf.experiment.protocols import pixels_of
from vmf.experiment.simulated import write_simulation
from vmf.spec import Spec, dump, loads

RIG = {"width_px": 320, "height_px": 240, "fx_px": 234.5, "fy_px": 236.0, "cx_px": 172.0, "cy_px": 127.5}


def make_spec(**more: Any) -> Spec:
    source = {
        "rig": RIG,
        "frames": 12,
        "motion": "hand_guided",
        "targets": 2,
        "workspace": {"target_low_m": (-0.4, -0.3, 1.5), "target_high_m": (0.4, 0.3, 2.0)},
        "images": {"targets": "blob", "background": "plain", "size_m": 0.15},
        "tracker": {"kind": "meanshift", "targets": 2},
        "seed": 3,
    }
    return Spec.model_validate({"task": "translation", "data": {"simulate": {**source, **more}}})


def seen(spec: Spec, trial: int = 0) -> Filmed:
    return observe(spec, trial, trial_streams(spec, trial)[0])


def test_tracked_pixels_are_those_of_the_targets_named() -> None:
    found = seen(make_spec())
    s = found.simulation
    assert s.targets_W.shape == (s.tracks.n_targets, 3)
    off = pixels_of(s.tracks, np.arange(s.tracks.n_targets)) - s.clean
    known = np.isfinite(off)
    assert known.any(axis=(0, 2)).all()
    # A disc of 20 px is found to a fraction of a pixel, and two discs are further apart than that.
    assert np.abs(off[known]).max() < 2.0
    apart = np.linalg.norm(s.clean[:, 0, :2] - s.clean[:, 1, :2], axis=-1)
    assert apart.min() > 10.0
    np.testing.assert_array_equal(s.noise_px[known], off[known])
    assert "px off in root mean square" in found.notes[0]


def test_what_is_seen_depends_on_seed_and_trial_alone() -> None:
    a, b, other = seen(make_spec()), seen(make_spec()), seen(make_spec(), trial=1)
    np.testing.assert_array_equal(a.simulation.tracks.pixels, b.simulation.tracks.pixels)
    assert not np.array_equal(a.simulation.tracks.pixels, other.simulation.tracks.pixels)


def test_poses_are_those_of_the_same_spec_without_images() -> None:
    plain = seen(make_spec(tracker=None)).simulation
    np.testing.assert_array_equal(seen(make_spec()).simulation.E_true, plain.E_true)


def test_a_tracker_that_finds_nothing_is_one_line() -> None:
    tiny = {"targets": "blob", "background": "plain", "size_m": 0.002}
    with pytest.raises(InputError, match="meanshift found no target in 12 rendered frames"):
        seen(make_spec(images=tiny))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"images": {"targets": "texture"}}, "tracker meanshift follows images.targets: blob"),
        ({"lost": [{"target": 0, "from_frame": 1, "frames": 1}]}, "it is the tracker that loses"),
    ],
)
def test_a_tracker_needs_what_it_follows(more: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        make_spec(**more)


def test_what_is_written_is_what_was_learned_from(tmp_path: Path) -> None:
    spec = make_spec()
    written = write_simulation(loads(dump(spec), tmp_path / "a.yaml"), tmp_path / "a.mcap")
    np.testing.assert_array_equal(written.pixels, seen(spec).simulation.tracks.pixels)
