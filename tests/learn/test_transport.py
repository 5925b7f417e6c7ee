"""Parameters transported from one lifted camera per target to every visited code (§4)."""

from __future__ import annotations

import learner_scenes as scenes
import numpy as np
import pytest
from learner_scenes import EPS

from vmf.data.tracks import from_dense
from vmf.geometry import inverse
from vmf.learn.transport import transport

ESTIMATORS = ["qr", "tls", "ml"]
# Relative motions of these have the task's own lift from any centre.
GENERAL = ["translation", "planar", "six_dof", "pan_tilt"]


def visited(scene):
    """Frames (V,), targets (V,) and codes (V, 4) of the observations in both cameras."""
    frame, target = np.nonzero(np.isfinite(scene.dense).all(axis=-1))
    return frame, target, scene.dense[frame, target]


def tolerance(learner, codes, size):
    """Rounding of a backward-stable solution, a few dozen operations an entry, of numbers of a size.

    Rows of size one come from differences like a − x_c c scaled by some 100 px: of a size of 100.
    """
    condition = max(learner.condition(code) for code in codes)
    assert np.isfinite(condition)
    return 64 * EPS * condition * size


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("name", GENERAL)
def test_visited_codes_have_their_analytic_parameters(cases, name, estimator, rng):
    case = cases[name]
    scene = scenes.make_scene(case, rng, 40, 3)
    learner = scenes.transport(case.task, estimator=estimator)
    learner.partial_fit(scene.tracks)
    assert learner.losses == ()
    frame, target, codes = visited(scene)
    rows = learner.parameters(codes).rows
    expected = scenes.analytic(case, scene)[frame, target]
    # Entries of a row differ in size by the focal length and by depth: a row is measured by its own norm.
    error = np.linalg.norm(rows - expected, axis=-1) / np.linalg.norm(expected, axis=-1)
    assert error.max() < tolerance(learner, codes[:3], 100.0)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("name", GENERAL)
def test_thesis_gauge_is_the_same_up_to_scale(cases, name, estimator, rng):
    case = cases[name]
    scene = scenes.make_scene(case, rng, 40, 2)
    learner = scenes.transport(case.task, estimator=estimator, gauge="thesis")
    learner.partial_fit(scene.tracks)
    frame, target, codes = visited(scene)
    rows = learner.parameters(codes).rows
    np.testing.assert_array_equal(rows[..., 2, -1], 1.0)
    expected = scenes.analytic(case, scene)[frame, target]
    expected = expected / expected[..., 2:, -1:]
    error = np.linalg.norm(rows - expected, axis=-1) / np.linalg.norm(expected, axis=-1)
    # The constant of c is a tenth or less of the depth ratio that the other gauge divides by.
    assert error.max() < tolerance(learner, codes[:2], 1e4)


@pytest.mark.parametrize("gauge", ["unit_depth", "thesis"])
@pytest.mark.parametrize("name", scenes.IDS)
def test_motions_between_any_two_visited_poses_are_predicted(cases, name, gauge, rng):
    """The pixel errors of all pairs of frames; for pan-tilt, both with tilts other than zero (C3)."""
    case = cases[name]
    scene = scenes.make_scene(case, rng, 30, 2)
    E = scene.tracks.E_S_from_W
    if name.startswith("pan_tilt"):
        assert np.abs(E[:, 0, 2]).min() > 0.0
    learner = scenes.transport(case.task, gauge=gauge)
    learner.partial_fit(scene.tracks)
    rows = learner.parameters(scene.dense.reshape(-1, 4)).rows.reshape(30, 2, 2, 3, -1)
    x_bar = case.task.lift(E[:, None] @ inverse(E)[None])
    u = scene.dense.reshape(30, 2, 2, 2)
    found = scenes.predictions(rows[None], x_bar[:, :, None, None])
    np.testing.assert_allclose(
        found, u[:, None] - u[None], rtol=0, atol=tolerance(learner, scene.dense[0], 1e3)
    )


@pytest.mark.parametrize("name", GENERAL)
def test_observations_in_one_camera_count_and_do_no_harm(cases, name, rng):
    case = cases[name]
    scene = scenes.make_scene(case, rng, 60, 2, lost=0.15)
    # The first frame of each target in one camera only: references differ between the cameras.
    assert np.isnan(scene.dense).any()
    dense = scene.dense.copy()
    dense[0, 0, 2:] = dense[0, 1, :2] = np.nan
    scene = scenes.Scene(from_dense(scene.tracks.times_ns, scene.tracks.E_S_from_W, dense), scene.P_W, dense)
    learner = scenes.transport(case.task)
    learner.partial_fit(scene.tracks)
    assert learner.losses == ()
    frame, target, codes = visited(scene)
    assert 0 < len(codes) < 120
    rows = learner.parameters(codes).rows
    expected = scenes.analytic(case, scene)[frame, target]
    error = np.linalg.norm(rows - expected, axis=-1) / np.linalg.norm(expected, axis=-1)
    assert error.max() < tolerance(learner, codes[:2], 100.0)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("name", GENERAL)
def test_a_target_seen_too_rarely_is_left_out_and_counted(cases, name, estimator, rng, request):
    case = cases[name]
    scene = scenes.make_scene(case, rng, 40, 3)
    dense = scene.dense.copy()
    dense[3:, 1] = np.nan
    dense[:, 2, 2:] = np.nan
    tracks = from_dense(scene.tracks.times_ns, scene.tracks.E_S_from_W, dense)
    learner = scenes.transport(case.task, estimator=estimator)
    learner.partial_fit(tracks)
    assert len(learner.losses) == 1
    # Three frames are too few; the third target was never seen by the right camera.
    assert learner.losses[0].startswith("2 of 3 targets")
    assert np.isnan(learner.parameters(dense[:3, 1]).rows).all()
    expected = scenes.analytic(case, scene)[:, 0]
    rows = learner.parameters(dense[:, 0]).rows
    error = np.linalg.norm(rows - expected, axis=-1) / np.linalg.norm(expected, axis=-1)
    assert error.max() < tolerance(learner, dense[:1, 0], 100.0)


@pytest.mark.parametrize("name", GENERAL)
def test_transport_there_and_back_changes_nothing(cases, name, rng):
    case = cases[name]
    E, shift = case.poses(rng, 5), rng.normal(size=(5, 2, 2)) * 50.0
    rows = rng.normal(size=(5, 2, 3, case.task.n_lift + 1))
    there = transport(case.task, rows, E, shift)
    back = transport(case.task, there, inverse(E), -shift)
    np.testing.assert_allclose(back, rows, rtol=0, atol=1e4 * EPS * 50.0)


def test_noise_is_what_was_put_on_the_pixels(cases, rng):
    """A median of 24 variances, each of 2·100 − 11 or more spare equations, scatters by about 3 %."""
    for name in ("translation", "planar"):
        case = cases[name]
        scene = scenes.make_scene(case, rng, 100, 12, noise=2.0)
        learner = scenes.transport(case.task)
        learner.partial_fit(scene.tracks)
        assert abs(learner.noise.scale_px / 2.0 - 1.0) < 0.1


@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_wrong_matches_do_not_move_robust_fits(cases, loss, rng):
    """5 % of wrong matches under 0.5 px of noise: the robust fit stays within 2 px of the truth."""
    case = cases["translation"]
    scene = scenes.make_scene(case, rng, 200, 2, noise=0.5)
    wrong = rng.random(scene.dense.shape[:2]) < 0.05
    dense = np.where(wrong[..., None], rng.uniform(0.0, 480.0, scene.dense.shape), scene.dense)
    tracks = from_dense(scene.tracks.times_ns, scene.tracks.E_S_from_W, dense)
    frame, target = np.nonzero(~wrong)
    expected = scenes.analytic(case, scene)[frame, target]
    errors = {}
    for kind in ("squared", loss):
        learner = scenes.transport(case.task, loss=kind)
        learner.partial_fit(tracks)
        rows = learner.parameters(dense[frame, target]).rows
        x_bar = case.task.lift(scene.tracks.E_S_from_W[:10])[:, None, None]
        difference = scenes.predictions(rows[None], x_bar) - scenes.predictions(expected[None], x_bar)
        errors[kind] = np.median(np.linalg.norm(difference, axis=-1))
    assert errors[loss] < 2.0
    assert errors[loss] < 0.5 * errors["squared"]
