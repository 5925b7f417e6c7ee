"""The structured learner on real recordings, nothing calibrated: as accurate as an independent prototype."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vmf.data.recording import read
from vmf.experiment import protocols
from vmf.experiment.asking import answer
from vmf.geometry import inverse, rotation_angle
from vmf.learn import StructuredLearner
from vmf.spec import load
from vmf.tasks import make_task

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.long


def opened(name, *overrides):
    path = ROOT / "configs" / "real" / f"{name}.yaml"
    spec = load(path, overrides).spec
    file = (path.parent / spec.data.recording.path).resolve()
    if not file.exists():
        pytest.skip(f"the recording {file.name} is not beside the project")
    return spec, read(spec.data.recording, spec.mounting, path.parent).tracks


def errors(spec, tracks, fold, every=1):
    """Angles (rad) and distances (m) between true and solved motions, by gap; one question of `every`."""
    learner = StructuredLearner(make_task(spec.task))
    learner.partial_fit(tracks.select(fold.train))
    found = {}
    for asked in protocols.held_out_pairs(spec, tracks, fold.test, 0):
        query = asked.query.select(np.arange(0, len(asked.query), every))
        solutions = answer(spec, learner, query)
        ok = solutions.status == "ok"
        truth = query.truth[ok]
        E = solutions.E_to_from[ok]
        shift = np.linalg.norm((E - truth)[:, :3, 3], axis=1)
        found[str(asked.case[0])] = rotation_angle(inverse(truth) @ E), shift
    return found


def test_starry_night_reaches_calibrated_accuracy():
    spec, tracks = opened("starry_night")
    found = errors(spec, tracks, protocols.folds(spec, tracks.n_frames)[0])
    for case, (degrees, metres) in {"gap=5": (0.90, 0.0135), "gap=20": (2.2, 0.022)}.items():
        angle, distance = found[case]
        assert np.degrees(np.median(angle)) <= degrees
        assert np.median(distance) <= metres


def test_the_tools_position_is_found_within_a_millimetre():
    spec, tracks = opened("franka_tag")
    folds = protocols.folds(spec, tracks.n_frames)
    distance = np.concatenate([d for fold in folds for _, d in errors(spec, tracks, fold).values()])
    assert len(distance) > 50
    assert np.median(distance) <= 0.0008
    assert np.percentile(distance, 90) <= 0.0016
    # Looked up from pixels by an affine map, the tool is found to centimetres.
    affine = np.concatenate([affine_distances(tracks, fold) for fold in folds])
    assert 10.0 * np.median(distance) <= np.median(affine)
    assert 10.0 * np.percentile(distance, 90) <= np.percentile(affine, 90)


def affine_distances(tracks, fold):
    """How far tool positions (m) are from an affine function of the code, fitted to the training poses."""
    both = np.isfinite(tracks.pixels).all(axis=1)
    codes = np.column_stack([tracks.pixels[both], np.ones(both.sum())])
    position = tracks.E_S_from_W[tracks.frame[both], :3, 3]
    train = np.isin(tracks.frame[both], fold.train)
    A = np.linalg.lstsq(codes[train], position[train], rcond=None)[0]
    return np.linalg.norm(codes[~train] @ A - position[~train], axis=1)


def test_poses_of_another_time_are_refused():
    spec, tracks = opened("starry_night")
    shifted = tracks.select(np.arange(50, 883))
    learner = StructuredLearner(make_task(spec.task))
    wrong = tracks.select(np.arange(833))
    learner.partial_fit(type(wrong)(**{**vars(wrong), "E_S_from_W": shifted.E_S_from_W}))
    assert learner.cameras is None
    assert "do not explain the images" in learner.losses[0]


RAW = "data.recording.path=../../../shared/data/kitti07_raw.mcap"


@pytest.mark.parametrize(("more", "slack"), [((), 1.0), ((RAW,), 1.3)])
def test_a_car_is_followed_in_six_degrees_of_freedom(more, slack):
    """Thousands of short tracks with heavy tails: one file as published, the ids of the other cut by hand."""
    spec, tracks = opened("kitti07", "task=six_dof", *more)
    found = errors(spec, tracks, protocols.folds(spec, tracks.n_frames)[0], every=4)
    for case, (degrees, metres) in {"gap=1": (0.035, 0.018), "gap=5": (0.08, 0.050)}.items():
        angle, distance = found[case]
        # About 100 and 70 questions of a quarter of all.
        assert len(angle) > 65
        assert np.degrees(np.median(angle)) <= slack * degrees
        assert np.median(distance) <= slack * metres


def test_tracks_shuffled_between_ids_are_refused():
    spec, tracks = opened("starry_night")
    tracks, rng = tracks.select(np.arange(300)), np.random.default_rng(0)
    pixels = tracks.pixels.copy()
    for frame in range(tracks.n_frames):
        mine = np.nonzero(tracks.frame == frame)[0]
        pixels[mine] = pixels[rng.permutation(mine)]
    learner = StructuredLearner(make_task(spec.task))
    learner.partial_fit(replace(tracks, pixels=pixels))
    assert learner.cameras is None
    assert "do not explain the images" in learner.losses[0]
