"""Simulated data: what is true, what is seen of it, and what depends on which random numbers."""

from __future__ import annotations

import numpy as np
import pytest

from vmf.data import Query, workspace
from vmf.data.poses import PanTiltJoints
from vmf.data.simulate import (
    disturbed_views,
    held_out_queries,
    held_out_questions,
    make_world,
    simulate,
    trained_code_truth,
    trial_streams,
)
from vmf.errors import InputError
from vmf.geometry import in_view, inverse, rotation_angle, stereo_code
from vmf.spec import Spec

TASKS = ["pan_tilt", "translation", "planar", "six_dof"]
CASES = [(task, motion, "eye_in_hand") for task in TASKS for motion in ("random", "hand_guided")] + [
    (task, motion, "eye_to_hand")
    for task in ("translation", "six_dof")
    for motion in ("random", "hand_guided")
]
SIZE = (640, 480)


def make_spec(task="translation", motion="random", mounting="eye_in_hand", noise=None, evaluate=None, **more):
    return Spec.model_validate(
        {
            "task": task,
            "mounting": mounting,
            "data": {"simulate": {"motion": motion, "frames": 60, **more}},
            "noise": noise or {},
            "evaluate": evaluate or {},
        }
    )


def run(spec, trial=0):
    return simulate(spec, trial_streams(spec, trial)[0])


def dense(simulation):
    n, k = simulation.clean.shape[:2]
    return np.swapaxes(simulation.tracks.pixels.reshape(k, n, 4), 0, 1)


@pytest.fixture(params=CASES, ids=["-".join(c) for c in CASES])
def kind(request):
    return dict(zip(("task", "motion", "mounting"), request.param, strict=True))


def test_both_cameras_see_every_target_in_every_frame(kind):
    s = run(make_spec(**kind))
    P_S = np.einsum("nij,kj->nki", s.E_true[:, :3, :3], s.targets_W) + s.E_true[:, None, :3, 3]
    codes, depth = stereo_code(s.world.cameras, P_S)
    assert codes.shape == (60, workspace.TARGETS[kind["task"]], 4)
    np.testing.assert_array_equal(codes, s.clean)
    assert in_view(codes, depth, SIZE).all()
    # Every target is an observation of every frame, noise or not.
    assert len(s.tracks.frame) == codes.shape[0] * codes.shape[1]


def test_true_motions_are_in_the_task_space(kind):
    s = run(make_spec(**kind))
    world = s.world.task.world()
    assert world.departure(s.E_true).max() < 1e-12
    relative = s.E_true @ inverse(s.E_true[0])
    assert s.world.task.departure(relative).max() < 1e-12
    np.testing.assert_array_equal(s.E_true[0], s.world.region.start)


@pytest.mark.parametrize("noise", [{}, {"pose_m": 0.01, "pose_rad": 0.02}], ids=["exact", "noisy"])
def test_poses_become_motions_as_those_of_recordings_do(kind, noise):
    s = run(make_spec(**kind, noise=noise))
    np.testing.assert_array_equal(s.tracks.E_S_from_W, s.poses.motions(kind["mounting"]))
    assert isinstance(s.poses, PanTiltJoints) == (kind["task"] == "pan_tilt")
    if not noise:
        # From matrices to quaternions or angles and back.
        np.testing.assert_allclose(s.tracks.E_S_from_W, s.E_true, rtol=0, atol=1e-14)


def test_poses_stay_in_the_workspace():
    where = {"travel_m": (0.2, 0.1, 0.0), "angle_rad": 0.1}
    for task in TASKS:
        s = run(make_spec(task, workspace=where, targets=1))
        position = inverse(s.E_true)[:, :3, 3]
        angle = rotation_angle(s.E_true)
        if task == "pan_tilt":
            np.testing.assert_array_equal(position, 0.0)
        else:
            assert (np.abs(position) <= np.array(where["travel_m"]) + 1e-12).all()
            assert np.abs(position[:, 0]).max() > 0.15
        # Angles about several axes of 0.1 rad each compose to no more than their sum.
        most = {"pan_tilt": 0.2, "translation": 0.0, "planar": 0.1, "six_dof": 0.3}[task]
        assert angle.max() <= most + 1e-7


def test_targets_lie_in_their_box():
    box = {"target_low_m": (-0.1, -0.2, 1.5), "target_high_m": (0.3, 0.2, 1.75)}
    s = run(make_spec(workspace=box, targets=200, frames=2))
    assert (s.targets_W >= box["target_low_m"]).all()
    assert (s.targets_W <= box["target_high_m"]).all()


def test_pixel_noise_has_the_stated_deviation():
    """A sample deviation of n numbers scatters by σ/√(2n); four of those."""
    s = run(make_spec("six_dof", frames=400, noise={"pixel_px": 3.0}))
    error = (dense(s) - s.clean).reshape(-1, 4)
    n = len(error)
    assert (np.abs(error.std(axis=0) - 3.0) < 4 * 3.0 / np.sqrt(2 * n)).all()
    assert (np.abs(error.mean(axis=0)) < 4 * 3.0 / np.sqrt(n)).all()
    # Coordinates are independent of each other.
    assert np.abs(np.corrcoef(error.T) - np.eye(4)).max() < 4 / np.sqrt(n)


def test_no_noise_is_the_truth():
    s = run(make_spec("planar", noise={"pixel_px": 0.0}))
    np.testing.assert_array_equal(dense(s), s.clean)


@pytest.mark.parametrize("mounting", ["eye_in_hand", "eye_to_hand"])
def test_pose_noise_has_the_stated_deviations(mounting):
    s = run(make_spec("six_dof", mounting=mounting, frames=500, noise={"pose_m": 0.02, "pose_rad": 0.01}))
    T_true = s.E_true if mounting == "eye_to_hand" else inverse(s.E_true)
    T = s.tracks.E_S_from_W if mounting == "eye_to_hand" else inverse(s.tracks.E_S_from_W)
    shift = T[:, :3, 3] - T_true[:, :3, 3]
    assert abs(shift.std() - 0.02) < 4 * 0.02 / np.sqrt(2 * shift.size)
    # Rotation vectors of three components of 0.01 rad: 3 σ² in the mean square, scatter √(2/3n) of it.
    angle = rotation_angle(inverse(T_true) @ T)
    assert abs((angle**2).mean() / 3e-4 - 1.0) < 4 * np.sqrt(2 / (3 * 500))
    # Pixels come from true poses.
    assert np.abs(dense(s) - s.clean).max() < 6 * 3.0


def test_joint_noise_is_put_on_the_joints():
    s = run(make_spec("pan_tilt", frames=500, noise={"pose_rad": 0.01, "pose_m": 1.0}))
    true = s.world.task.world().coordinates(s.E_true, np.eye(4))
    error = np.stack([s.poses.pan_rad, s.poses.tilt_rad], axis=1) - true
    assert (np.abs(error.std(axis=0) - 0.01) < 4 * 0.01 / np.sqrt(1000)).all()
    np.testing.assert_array_equal(s.tracks.E_S_from_W[:, :3, 3], 0.0)


@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0])
def test_outliers_have_their_share_and_lie_anywhere(ratio):
    s = run(make_spec("six_dof", frames=300, noise={"pixel_px": 0.0, "outlier_ratio": ratio}))
    wrong = (dense(s) != s.clean).any(axis=-1)
    n = wrong.size
    assert abs(wrong.mean() - ratio) <= 4 * np.sqrt(ratio * (1 - ratio) / n)
    if ratio == 0.0:
        return
    seen = dense(s)[wrong]
    assert (seen != s.clean[wrong]).all()
    assert (seen >= -0.5).all()
    assert (seen <= np.tile(SIZE, 2) - 0.5).all()
    # Uniform: the middle of the image within four standard errors, w/√12n.
    middle = np.tile(SIZE, 2) / 2 - 0.5
    assert (np.abs(seen.mean(axis=0) - middle) < 4 * np.tile(SIZE, 2) / np.sqrt(12 * len(seen))).all()


def test_disturbed_targets_move_by_their_deviation():
    """Small shifts of each target and frame, in px f/Z times as large; lost where they leave the image."""
    spec = make_spec("translation", frames=300, noise={"pixel_px": 0.0, "point_m": 0.01})
    s = run(spec)
    disturbed = disturbed_views(s, spec, np.random.default_rng(5))
    seen = disturbed.pixels
    assert seen.shape == s.clean.shape
    inside = np.isfinite(seen).all(axis=-1)
    assert inside.mean() > 0.9
    assert ((seen[inside] >= -0.5) & (seen[inside] <= np.tile(SIZE, 2) - 0.5)).all()
    P_S = s.targets_W + s.E_true[:, None, :3, 3]
    Z = P_S[..., 2] - 0.1
    # Along y only: Δy = f (ΔY − (y/f) ΔZ) / Z to first order, a second order of |Δ|/Z, 1 % here.
    slope = (s.clean[..., 1] - 255.0) / 472.0
    error = (seen - s.clean)[..., 1] * Z / 472.0 / np.sqrt(1.0 + slope**2)
    n = inside.sum()
    assert abs(np.square(error[inside]).mean() ** 0.5 / 0.01 - 1.0) < 4 / np.sqrt(2 * n) + 0.02
    still = disturbed_views(s, make_spec("translation", noise={"pixel_px": 0.0}), np.random.default_rng(5))
    np.testing.assert_array_equal(still.pixels, s.clean)


def hand_guided(task, mounting="eye_in_hand", frames=900):
    s = run(make_spec(task, "hand_guided", mounting, frames=frames))
    return s, s.tracks.times_ns / 1e9


@pytest.mark.parametrize(("task", "motion", "mounting"), CASES[1::2])
def test_hand_guided_times_are_frames_of_a_clock(task, motion, mounting):
    _, t = hand_guided(task, mounting)
    ticks = (t - t[0]) * 30.0
    np.testing.assert_allclose(ticks, np.rint(ticks), rtol=0, atol=1e-4)
    assert (np.diff(np.rint(ticks)) >= 1).all()


def fastest(s, t):
    """Speeds (N−1,) in units of E's entries a second between kept frames."""
    return np.linalg.norm(np.diff(s.E_true[:, :3], axis=0).reshape(len(t) - 1, -1), axis=1) / np.diff(t)


@pytest.mark.parametrize(("task", "motion", "mounting"), CASES[1::2])
def test_hand_guided_motion_has_bounded_speed(task, motion, mounting):
    """Way points are 1.5 s apart and at most the workspace's diagonal; a cubic overshoots little."""
    s, t = hand_guided(task, mounting)
    travel, angle = np.array(s.world.region.travel), s.world.region.angle or 0.0
    # Entries of R change by √2 a radian; turns compose from three angles between −angle and angle.
    diagonal = 2 * np.linalg.norm(travel) + np.sqrt(2) * 2 * angle * np.sqrt(3) * (1 + travel.max() + 2.0)
    assert fastest(s, t).max() < 3 * diagonal / 1.5


@pytest.mark.parametrize(("task", "motion", "mounting"), CASES[1::2])
def test_hand_guided_motion_never_jerks(task, motion, mounting):
    """A spline's velocity is continuous: over 1/30 s it changes by the acceleration's share, not by itself.

    With way points 1.5 s apart, a speed v takes about 1.5 s to turn, so it changes by some 2 v/45 a frame;
    half of the largest speed within a frame is a jump.
    """
    s, t = hand_guided(task, mounting)
    v = np.diff(s.E_true[:, :3], axis=0).reshape(len(t) - 1, -1) / np.diff(t)[:, None]
    neighbours = (np.diff(t)[1:] < 0.05) & (np.diff(t)[:-1] < 0.05)
    jump = np.linalg.norm(np.diff(v, axis=0), axis=1)[neighbours]
    assert jump.max() < 0.5 * np.linalg.norm(v, axis=1).max()


def test_hand_guided_motion_never_stands_still():
    s, t = hand_guided("translation")
    assert fastest(s, t).min() > 0.0


def test_same_seed_same_data(kind):
    one, other = run(make_spec(**kind)), run(make_spec(**kind))
    np.testing.assert_array_equal(one.tracks.pixels, other.tracks.pixels)
    np.testing.assert_array_equal(one.tracks.E_S_from_W, other.tracks.E_S_from_W)


def test_other_trials_and_seeds_other_data():
    spec = make_spec()
    runs = [run(spec, 0), run(spec, 1), run(make_spec(seed=2), 0), run(make_spec(seed=2), 1)]
    for i, one in enumerate(runs):
        for other in runs[:i]:
            assert not np.isin(one.targets_W, other.targets_W).any()
            assert not np.isin(one.tracks.pixels, other.tracks.pixels).any()


def test_a_trial_does_not_depend_on_those_before_it():
    spec = make_spec(evaluate={"queries": 3})
    alone = run(spec, 3).tracks.pixels
    for trial in range(4):
        training, queries = trial_streams(spec, trial)
        held_out_queries(spec, queries)
        last = simulate(spec, training).tracks.pixels
    np.testing.assert_array_equal(last, alone)


def test_queries_do_not_depend_on_training():
    one, other = make_spec(evaluate={"queries": 5}), make_spec(evaluate={"queries": 5}, frames=7)
    np.testing.assert_array_equal(
        held_out_queries(one, trial_streams(one, 0)[1]).initial,
        held_out_queries(other, trial_streams(other, 0)[1]).initial,
    )


def test_held_out_queries_are_new_views_of_new_targets(kind):
    spec = make_spec(**kind, noise={"pixel_px": 0.0}, evaluate={"queries": 6, "query_targets": 3})
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    task = make_world(spec).task
    assert query.initial.shape == query.desired.shape == (6, 3, 4)
    for views in (query.initial, query.desired):
        assert ((views >= -0.5) & (views <= np.tile(SIZE, 2) - 0.5)).all()
    assert task.departure(query.truth).max() < 1e-12
    # Initial and desired view show the same points: triangulated in S, one is the other moved by the truth.
    M = make_world(spec).cameras.M

    def triangulate(u):
        pixels = u.reshape(6, 3, 2, 2)
        A = pixels[..., None] * M[:, None, 2] - M[:, :2]
        A = A.reshape(6, 3, 4, 4)
        return np.linalg.solve(
            np.swapaxes(A[..., :3], -1, -2) @ A[..., :3], -np.swapaxes(A[..., :3], -1, -2) @ A[..., 3:]
        )[..., 0]

    moved = np.einsum("qij,qnj->qni", query.truth[:, :3, :3], triangulate(query.initial))
    moved += query.truth[:, None, :3, 3]
    np.testing.assert_allclose(moved, triangulate(query.desired), rtol=0, atol=1e-9)


def seen_in_truth(world, query, truth):
    """Pixels (Q, n, 8) of both views by the truth alone, noise included."""
    desired = np.einsum("qij,qnj->qni", query.truth[:, :3, :3], truth.points + truth.moved)
    desired += query.truth[:, None, :3, 3]
    codes = [stereo_code(world.cameras, P)[0] for P in (truth.points, desired)]
    return np.concatenate(codes, axis=-1) + truth.noise_px


def test_the_truth_of_queries_is_what_their_pixels_come_from(kind):
    spec = make_spec(**kind, evaluate={"queries": 6, "query_targets": 3})
    query, truth = held_out_questions(spec, trial_streams(spec, 0)[1])
    same = held_out_queries(spec, trial_streams(spec, 0)[1])
    np.testing.assert_array_equal(query.desired, same.desired)
    pixels = np.concatenate([query.initial, query.desired], axis=-1)
    np.testing.assert_allclose(seen_in_truth(make_world(spec), query, truth), pixels, rtol=0, atol=1e-9)
    assert truth.noise_px.std() == pytest.approx(3.0, rel=4 / np.sqrt(2 * truth.noise_px.size))
    assert (truth.moved == 0).all()


@pytest.mark.parametrize("point_m", [0.0, 0.05])
def test_the_truth_at_trained_codes_is_what_their_pixels_come_from(point_m, kind):
    spec = make_spec(**kind, frames=12, noise={"point_m": point_m})
    s = run(spec)
    targets, newest = np.arange(len(s.targets_W))[::-1], np.array([4, 9, 11])
    disturbed = disturbed_views(s, spec, np.random.default_rng(5)) if point_m else None
    seen = (s.clean + s.noise_px if disturbed is None else disturbed.pixels)[newest][:, targets]
    first = np.tile((s.clean + s.noise_px)[2, targets], (3, 1, 1))
    query = Query(first, seen, s.E_true[[2, 2, 2]], s.E_true[newest])
    truth = trained_code_truth(s, 2, newest, targets, disturbed)
    pixels = seen_in_truth(s.world, query, truth)
    found = np.isfinite(seen)
    assert found.any()
    np.testing.assert_allclose(pixels[..., 4:][found], seen[found], rtol=0, atol=1e-9)
    np.testing.assert_allclose(pixels[..., :4], first, rtol=0, atol=1e-9)


def test_reversed_queries_have_the_inverse_truth():
    spec = make_spec("six_dof", evaluate={"queries": 4})
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    np.testing.assert_allclose(
        query.reversed().truth @ query.truth, np.tile(np.eye(4), (4, 1, 1)), atol=1e-14
    )
    assert len(query.select(np.array([True, False, True, False]))) == 2


BLIND = {
    "targets behind": {"target_low_m": (-0.1, -0.1, -2.0), "target_high_m": (0.1, 0.1, -1.0)},
    "targets aside": {"target_low_m": (20.0, -0.1, 1.0), "target_high_m": (21.0, 0.1, 2.0)},
}


@pytest.mark.parametrize("where", BLIND.values(), ids=BLIND)
def test_a_workspace_without_targets_in_view_is_refused(where):
    with pytest.raises(InputError, match=r"data\.simulate\.workspace: the start pose shows no point"):
        run(make_spec(workspace=where))


@pytest.mark.parametrize("motion", ["random", "hand_guided"])
def test_a_workspace_whose_poses_lose_the_targets_is_refused(motion, monkeypatch):
    monkeypatch.setattr(workspace, "_MAX_BATCHES", 20)
    with pytest.raises(InputError) as refusal:
        run(make_spec("translation", motion, workspace={"travel_m": (1e7, 1e7, 0.0)}))
    (line,) = refusal.value.lines
    assert line.startswith("data.simulate.workspace: only 0 of 81920 poses show all 2 targets")
    assert "lessen travel_m" in line


def test_a_box_upside_down_is_refused():
    where = {"target_low_m": (0.0, 0.0, 2.0), "target_high_m": (1.0, 1.0, 1.0)}
    with pytest.raises(InputError, match=r"target_low_m .* lies above target_high_m"):
        run(make_spec(workspace=where))


@pytest.mark.parametrize("task", ["pan_tilt", "planar"])
def test_heads_and_bases_carry_their_cameras(task):
    with pytest.raises(InputError, match="eye_in_hand is accepted"):
        run(make_spec(task, mounting="eye_to_hand"))


@pytest.mark.parametrize("task", ["translation", "six_dof"])
def test_tools_move_in_front_of_fixed_cameras(task):
    """Eye-to-hand: targets near the tool's origin, which starts 2 m ahead; poses are the tool's own."""
    s = run(make_spec(task, mounting="eye_to_hand", noise={"pixel_px": 0.0}))
    np.testing.assert_array_equal(s.E_true[0, :3, 3], [0.0, 0.0, 2.0])
    assert np.abs(s.targets_W).max() <= 0.1
    assert (np.abs(s.E_true[:, :3, 3] - [0.0, 0.0, 2.0]) <= np.array([0.3, 0.4, 0.3]) + 1e-12).all()
    np.testing.assert_allclose(s.poses.position_m, s.E_true[:, :3, 3], rtol=0, atol=1e-15)
