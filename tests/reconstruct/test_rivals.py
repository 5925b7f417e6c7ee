"""What every reconstruction method promises, for every task."""

import numpy as np
import pytest
from rival_scenes import FEWEST, TARGETS, random_query, thesis_rig

from vmf.geometry import motion
from vmf.reconstruct import METHODS, CalibrationError, disturb, reconstruct
from vmf.solve import Query, StopReason
from vmf.tasks import TASKS, make_task

methods = pytest.mark.parametrize("method", METHODS)
tasks = pytest.mark.parametrize("task", TASKS)
ARRAYS = ("E_to_from", "p", "covariance", "residual_px", "condition")


def ask(method, task, query, **options):
    return reconstruct(method, make_task(task), thesis_rig(task).cameras(), query, **options)


def assert_same(one, other, atol=1e-8):
    assert one.reason.tolist() == other.reason.tolist()
    for name in ARRAYS:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-6, atol=atol)


@methods
@tasks
@pytest.mark.parametrize("from_rest", [True, False])
def test_noise_free_views_give_the_motion_back(method, task, from_rest):
    query = random_query(task, 15, TARGETS[task], np.random.default_rng(1), from_rest=from_rest)
    if task == "pan_tilt" and not from_rest:
        assert np.abs(query.E_initial[:, 0, 2]).max() > 0.1
    found = ask(method, task, query)
    assert (found.status == "ok").all()
    np.testing.assert_allclose(found.E_to_from, query.truth, atol=1e-8)
    p = make_task(task).coordinates(query.truth, query.E_initial)
    np.testing.assert_allclose(make_task(task).motion(found.p, query.E_initial), query.truth, atol=1e-8)
    assert found.p.shape == p.shape
    assert found.residual_px.max() < 1e-6


@methods
@tasks
def test_cameras_that_are_not_parallel(method, task):
    cameras = disturb(thesis_rig(task), CalibrationError(1.0, 2.0, 3.0, 4.0))
    query = random_query(task, 8, TARGETS[task], np.random.default_rng(2), cameras=cameras)
    found = reconstruct(method, make_task(task), cameras, query)
    np.testing.assert_allclose(found.E_to_from, query.truth, atol=1e-8)


@methods
@pytest.mark.parametrize("task", ["six_dof", "planar", "translation"])
def test_known_rotation_needs_one_target(method, task):
    query = random_query(task, 8, 1, np.random.default_rng(3))
    found = ask(method, task, query, known_rotation=True)
    assert (found.status == "ok").all()
    np.testing.assert_allclose(found.E_to_from, query.truth, atol=1e-8)


@methods
def test_known_rotation_leaves_nothing_of_a_rotation(method):
    query = random_query("pan_tilt", 1, 2, np.random.default_rng(3))
    with pytest.raises(ValueError, match="only rotate"):
        ask(method, "pan_tilt", query, known_rotation=True)


@methods
@tasks
def test_a_batch_is_its_queries_one_at_a_time(method, task):
    query = random_query(task, 6, TARGETS[task] + 1, np.random.default_rng(4), noise_px=2.0)
    query.desired[::2, -1, 2:] = np.nan
    together = ask(method, task, query)
    for i in range(len(query)):
        alone = ask(method, task, query.select(np.array([i])))
        assert alone.reason[0] is together.reason[i]
        np.testing.assert_allclose(alone.p[0], together.p[i], atol=1e-8)
        np.testing.assert_allclose(alone.covariance[0], together.covariance[i], rtol=1e-6)


@methods
@tasks
def test_padding_and_inputs_stay_as_they_are(method, task):
    query = random_query(task, 6, TARGETS[task], np.random.default_rng(5), noise_px=2.0)
    pad = np.full((6, 3, 4), np.nan)
    padded = Query(
        np.concatenate([pad, query.initial], axis=1),
        np.concatenate([pad, query.desired], axis=1),
        query.E_initial,
        query.E_desired,
    )
    before = padded.initial.copy(), padded.desired.copy()
    assert_same(ask(method, task, padded), ask(method, task, query))
    np.testing.assert_array_equal(padded.initial, before[0])
    np.testing.assert_array_equal(padded.desired, before[1])


@methods
@tasks
def test_too_few_targets_are_refused_and_the_fewest_are_not(method, task):
    query = random_query(task, 4, FEWEST[task], np.random.default_rng(6))
    assert (ask(method, task, query).status == "ok").all()
    query.desired[:, 0] = np.nan
    found = ask(method, task, query)
    assert found.reason.tolist() == [StopReason.TOO_FEW_EQUATIONS] * 4
    for array in (found.E_to_from, found.p, found.covariance):
        assert np.isnan(array).all()


@methods
@tasks
def test_nothing_seen_nothing_answered(method, task):
    for n in (0, 2):
        nothing = np.full((3, n, 4), np.nan)
        poses = np.tile(np.eye(4), (3, 1, 1))
        found = ask(method, task, Query(nothing, nothing, poses, poses))
        assert found.reason.tolist() == [StopReason.TOO_FEW_EQUATIONS] * 3
    assert len(ask(method, task, Query(nothing[:0], nothing[:0], poses[:0], poses[:0]))) == 0


@methods
@tasks
def test_codes_of_points_behind_the_cameras_are_said_to_be(method, task):
    query = random_query(task, 3, TARGETS[task], np.random.default_rng(7))
    exchanged = [2, 3, 0, 1]
    behind = Query(
        query.initial[..., exchanged], query.desired[..., exchanged], query.E_initial, query.E_desired
    )
    found = ask(method, task, behind)
    assert found.reason.tolist() == [StopReason.BEHIND_CAMERA] * 3
    assert np.isnan(found.E_to_from).all()


def test_unknown_methods_are_errors():
    with pytest.raises(KeyError):
        ask("guess", "translation", random_query("translation", 1, 1, np.random.default_rng(8)))


def median_errors(method, task, query):
    """Median geodesic angle (rad) and |error| of t_x, t_y, t_z (m)."""
    found = ask(method, task, query)
    assert (found.status == "ok").all()
    angle = motion.rotation_angle(found.E_to_from @ motion.inverse(query.truth))
    t = np.abs(found.E_to_from - query.truth)[:, :3, 3]
    return np.array([np.median(angle), *np.median(t, axis=0)])


@pytest.mark.parametrize(
    ("method", "task", "table"),
    [
        # Method §8: an independent prototype on 60 queries, whose medians are good to about ±20 %.
        ("triangulate_arun", "translation", (0.0, 0.029, 0.025, 0.159)),
        ("bundle", "translation", (0.0, 0.020, 0.020, 0.078)),
        ("triangulate_arun", "six_dof", (0.306, 0.313, 0.329, 0.240)),
        # t_y is .040 there: an asymmetry between x and y that random orientations of this rig do not have.
        ("bundle", "six_dof", (0.086, 0.094, None, 0.081)),
    ],
)
def test_medians_are_those_of_an_independent_prototype(method, task, table):
    query = random_query(task, 400, TARGETS[task], np.random.default_rng(9), noise_px=3.0)
    for found, expected in zip(median_errors(method, task, query), table, strict=True):
        assert expected is None or found == pytest.approx(expected, rel=0.30, abs=1e-9)
