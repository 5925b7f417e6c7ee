"""`model.npz` gives back the very learner that was saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vmf.approximate import APPROXIMATORS
from vmf.data.simulate import simulate, trial_streams
from vmf.experiment import model_file
from vmf.experiment.build import build_learner
from vmf.experiment.model_file import Model
from vmf.spec import Spec

CMAC = {"kind": "cmac", "overlays": 8, "tile_px": 64, "table_size": 4096}
# With their defaults.
OTHERS = [kind for kind in APPROXIMATORS if kind not in ("none", "cmac", "polynomial")]
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "transport none": ({"kind": "transport"}, {"kind": "none"}),
    "transport cmac": ({"kind": "transport"}, CMAC),
    "transport cmac uniform": ({"kind": "transport"}, {**CMAC, "displacement": "uniform", "gauge": "thesis"}),
    "transport cmac moving average": ({"kind": "transport"}, {**CMAC, "training": "moving_average"}),
    "transport cmac randomised": ({"kind": "transport"}, {**CMAC, "training": "randomised"}),
    **{f"transport {kind}": ({"kind": "transport"}, {"kind": kind}) for kind in OTHERS},
    **{f"compressed {kind}": ({"kind": "pipeline"}, {"kind": kind}) for kind in OTHERS},
    "transport polynomial": ({"kind": "transport", "estimator": "qr"}, {"kind": "polynomial"}),
    "transport own codes": ({"kind": "transport", "visited": "own"}, {"kind": "polynomial", "degree": 1}),
    "compressed cmac": ({"kind": "pipeline"}, CMAC),
    "compressed none": ({"kind": "pipeline", "estimator": "tls"}, {"kind": "none"}),
    "compressed bounded": ({"kind": "pipeline", "length": 5}, CMAC),
    "compressed pooled": ({"kind": "pipeline", "readout": "pooled"}, CMAC),
    "sequential cmac": ({"kind": "pipeline", "engine": "sequential", "length": 5}, CMAC),
    "sequential kaczmarz": ({"kind": "pipeline", "engine": "sequential", "readout": "kaczmarz"}, CMAC),
    "sequential none": ({"kind": "pipeline", "engine": "sequential"}, {"kind": "none"}),
}


def learned(kind: str, task: str = "translation") -> tuple[Model, np.ndarray]:
    """A model after some frames, and the codes it has met."""
    learner, approximator = KINDS[kind]
    source = {"frames": 14, "targets": 3, "seed": 2}
    spec = Spec.model_validate(
        {"task": task, "data": {"simulate": source}, "learner": learner, "approximator": approximator}
    )
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    made = build_learner(spec)
    made.partial_fit(tracks.select_frames(0, 9))
    made.partial_fit(tracks.select_frames(9, 14))
    return Model(spec, made), tracks.pixels


@pytest.mark.parametrize("kind", KINDS)
def test_a_loaded_model_answers_bit_for_bit_and_saves_the_same_bytes(tmp_path: Path, kind: str) -> None:
    model, codes = learned(kind)
    model_file.save(tmp_path / "a.npz", model)
    loaded = model_file.load(tmp_path / "a.npz")
    assert loaded.spec == model.spec
    near = codes + np.random.default_rng(1).normal(0, 10, codes.shape)
    for asked in (codes, near, codes[:0]):
        a, b = model.learner.parameters(asked), loaded.learner.parameters(asked)
        np.testing.assert_array_equal(a.rows, b.rows)
        np.testing.assert_array_equal(a.support, b.support)
    assert np.isfinite(model.learner.parameters(codes).rows).any()
    assert loaded.learner.noise == model.learner.noise
    model_file.save(tmp_path / "b.npz", loaded)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_a_loaded_model_goes_on_learning_as_if_nothing_had_happened(tmp_path: Path, kind: str) -> None:
    model, codes = learned(kind)
    model_file.save(tmp_path / "a.npz", model)
    loaded = model_file.load(tmp_path / "a.npz")
    spec = model.spec
    more = simulate(spec, trial_streams(spec, 0)[0]).tracks.select_frames(3, 8)
    for learner in (model.learner, loaded.learner):
        learner.partial_fit(more)
    a, b = (m.learner.parameters(codes) for m in (model, loaded))
    np.testing.assert_array_equal(a.rows, b.rows)


def test_what_a_learner_could_not_use_is_known_after_loading(tmp_path: Path) -> None:
    spec = Spec.model_validate(
        {"task": "six_dof", "data": {"simulate": {"frames": 3}}, "learner": {"kind": "transport"}}
    )
    learner = build_learner(spec)
    learner.partial_fit(simulate(spec, trial_streams(spec, 0)[0]).tracks)
    assert learner.losses
    model_file.save(tmp_path / "a.npz", Model(spec, learner))
    loaded = model_file.load(tmp_path / "a.npz").learner
    assert loaded.losses == learner.losses


def test_a_model_that_learned_nothing_comes_back_as_such(tmp_path: Path) -> None:
    spec = Spec.model_validate({"task": "planar", "data": {"simulate": {}}, "learner": {"kind": "transport"}})
    model_file.save(tmp_path / "a.npz", Model(spec, build_learner(spec)))
    loaded = model_file.load(tmp_path / "a.npz").learner
    assert loaded.tracks is None
    assert np.isnan(loaded.parameters(np.zeros((2, 4))).rows).all()


def test_nothing_half_written_is_left_where_writing_fails(tmp_path: Path) -> None:
    model, _ = learned("transport polynomial")
    (tmp_path / "a.npz").mkdir()
    with pytest.raises(OSError, match=r"a\.npz"):
        model_file.save(tmp_path / "a.npz", model)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
