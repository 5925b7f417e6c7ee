"""The structured learner: as good as calibrated cameras, and silent where it cannot be."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from vmf.data import Query
from vmf.data.simulate import held_out_queries, simulate, trial_streams
from vmf.geometry import inverse, rotation_angle
from vmf.learn import StructuredLearner, structured
from vmf.learn.adjustment import Estimate, Scene, adjust, huber, residuals, triangulated
from vmf.reconstruct import bundle
from vmf.spec import Spec

TASKS = ("pan_tilt", "translation", "planar", "six_dof")
# Targets of a question, as in the method's table.
ASKED = {"pan_tilt": 1, "translation": 2, "planar": 2, "six_dof": 6}


def spec_of(task, *, px=3.0, frames=200, targets=8, queries=100, outliers=0.0):
    return Spec.model_validate(
        {
            "task": task,
            "data": {"simulate": {"frames": frames, "targets": targets}},
            "noise": {"pixel_px": px, "outlier_ratio": outliers},
            "evaluate": {"queries": queries, "query_targets": ASKED[task]},
        }
    )


def learned(spec, trial=0):
    simulation = simulate(spec, trial_streams(spec, trial)[0])
    learner = StructuredLearner(simulation.world.task)
    learner.partial_fit(simulation.tracks)
    return simulation, learner


def errors(query, solutions):
    assert (solutions.status == "ok").all()
    between = inverse(query.truth) @ solutions.E_to_from
    shift = solutions.E_to_from[:, :3, 3] - query.truth[:, :3, 3]
    return np.median(rotation_angle(between)), np.median(np.linalg.norm(shift, axis=1))


@pytest.mark.parametrize("task", TASKS)
def test_without_noise_motions_are_exact(task):
    """Whatever the task leaves unobservable (scale, a common shift, height) is in no solved motion."""
    spec = spec_of(task, px=0.0, queries=30)
    _, learner = learned(spec)
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    solutions = bundle(learner.task, learner.cameras, query)
    # The adjustment ends at a relative gain of 1e-7 in squared pixels: √1e-7 of what its noise floor is.
    assert max(errors(query, solutions)) < 1e-6


@pytest.mark.parametrize("task", TASKS)
def test_as_good_as_calibrated_cameras(task):
    """New targets, new poses, 3 px: the medians of 100 questions are those of exact cameras within 15 %."""
    spec = spec_of(task, frames=400)
    simulation, learner = learned(spec)
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    ours = errors(query, bundle(learner.task, learner.cameras, query))
    exact = errors(query, bundle(learner.task, simulation.world.cameras, query))
    for mine, theirs in zip(ours, exact, strict=True):
        assert mine <= 1.15 * theirs + 1e-12


@pytest.mark.parametrize("task", TASKS)
def test_parameters_predict_what_a_motion_does(task):
    """Θ_S of a visited code, applied to the motions that were made, gives the pixels that were seen."""
    spec = spec_of(task, px=0.0)
    simulation, learner = learned(spec)
    codes = simulation.clean[0]
    rows = learner.parameters(codes).rows
    x_bar = simulation.world.task.lift(simulation.E_true @ inverse(simulation.E_true[0]))
    abc = np.einsum("kcra,na->nkcr", rows, x_bar)
    e = abc[..., :2] / abc[..., 2:]
    expected = (simulation.clean - simulation.clean[0]).reshape(e.shape)
    # A visited code's target ends where the adjustment does: √1e-7 of a few hundred px of image motion.
    np.testing.assert_allclose(e, expected, rtol=0, atol=np.sqrt(1e-7))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_robot_that_only_drives_and_turns_teaches_enough(seed):
    """Nothing sideways: linear triangulation puts targets behind the cameras, where many would stay."""
    simulated = {"frames": 200, "targets": 8, "seed": seed}
    along = {"travel_m": [0.5, 0.0, 0.0], "angle_rad": 0.4}
    spec = Spec.model_validate(
        {
            "task": "planar",
            "data": {"simulate": {**simulated, "workspace": along}},
            "noise": {"pixel_px": 0.0},
            "evaluate": {"queries": 30, "query_targets": 2},
        }
    )
    _, learner = learned(spec)
    assert learner.losses == ()
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    assert max(errors(query, bundle(learner.task, learner.cameras, query))) < 1e-6


def test_wrong_tracks_are_left_out():
    spec = spec_of("six_dof", px=1.0, targets=10)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    tracks = simulation.tracks
    pixels = tracks.pixels.copy()
    # One target's track wanders: each of its observations belongs to another frame.
    wrong = tracks.target == 3
    pixels[wrong] = np.random.default_rng(0).permutation(pixels[wrong])
    learner = StructuredLearner(simulation.world.task)
    learner.partial_fit(replace(tracks, pixels=pixels))
    assert learner.cameras is not None
    assert learner.losses == ("1 of 10 targets do not agree with the others",)
    assert learner.noise.scale_px == pytest.approx(1.0, rel=0.1)


def test_a_tenth_of_wrong_matches_does_little():
    spec = spec_of("six_dof", px=1.0, outliers=0.1)
    simulation, learner = learned(spec)
    clean = spec_of("six_dof", px=1.0)
    query = held_out_queries(clean, trial_streams(clean, 0)[1])
    ours = errors(query, bundle(learner.task, learner.cameras, query))
    exact = errors(query, bundle(learner.task, simulation.world.cameras, query))
    assert max(np.divide(ours, exact)) < 1.3


def test_poses_of_another_time_are_refused():
    """Poses that have nothing to do with the images leave no consistent target: that is the answer."""
    spec = spec_of("six_dof", px=1.0)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    shifted = np.roll(simulation.tracks.E_S_from_W, 50, axis=0)
    learner = StructuredLearner(simulation.world.task)
    learner.partial_fit(replace(simulation.tracks, E_S_from_W=shifted))
    assert learner.cameras is None
    assert learner.noise is None
    assert np.isnan(learner.parameters(simulation.clean[0]).rows).all()
    assert "do not explain the images" in learner.losses[0]


def test_what_was_refused_is_tried_again_with_a_quarter_more(monkeypatch):
    """Looking for a start takes long, and one more frame of many changes nothing."""
    monkeypatch.setattr(structured, "_FEW", 120)
    spec = spec_of("six_dof", px=1.0, frames=60, targets=6)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    shifted = replace(simulation.tracks, E_S_from_W=np.roll(simulation.tracks.E_S_from_W, 20, axis=0))
    learner = StructuredLearner(simulation.world.task)
    tried, original = [], structured.started

    def counting(scene, *rest):
        tried.append(len(np.unique(scene.target)))
        return original(scene, *rest)

    monkeypatch.setattr(structured, "started", counting)
    for frame in range(60):
        learner.partial_fit(shifted.select_frames(frame, frame + 1))
        assert learner.cameras is None
    first = 120 // 6
    # One try a frame while they are few, and then at 1.25, 1.25², … times as many.
    assert first / 2 <= len(tried) <= first + np.log(60 / first) / np.log(1.25) + 1
    assert learner.refused is not None


def test_too_little_data_is_said():
    spec = spec_of("six_dof", frames=4, targets=2)
    simulation, learner = learned(spec)
    assert learner.cameras is None
    assert "too few" in learner.losses[0]
    assert learner.parameters(simulation.clean[0]).support.max() == 0.0


def test_before_any_data_there_is_no_answer():
    learner = StructuredLearner(simulate(spec_of("planar"), np.random.default_rng(0)).world.task)
    assert learner.cameras is None
    assert np.isnan(learner.parameters(np.zeros((3, 4))).rows).all()


def test_block_by_block_ends_where_all_at_once_does():
    """Each block starts from the last estimate; both minimise the same robust cost."""
    spec = spec_of("translation")
    simulation, at_once = learned(spec)
    by_block = StructuredLearner(simulation.world.task)
    for begin in range(0, 200, 50):
        by_block.partial_fit(simulation.tracks.select_frames(begin, begin + 50))
        assert by_block.cameras is not None
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    one, other = (bundle(at_once.task, x.cameras, query).p for x in (at_once, by_block))
    # The cost is flat to 1e-7 at the end; that is √1e-7 of the standard errors (some cm here).
    assert np.abs(one - other).max() < 1e-3


def test_restored_learners_answer_alike():
    _, learner = learned(spec_of("planar"))
    other = StructuredLearner(learner.task)
    other.restore(learner.state())
    codes = learner.tracks.pixels[:50]
    np.testing.assert_array_equal(other.parameters(codes).rows, learner.parameters(codes).rows)
    assert other.noise == learner.noise
    assert other.losses == learner.losses


def small_scene(rng):
    """Five targets, some seen by one camera only, and a start a little off."""
    E = np.tile(np.eye(4), (30, 1, 1))
    E[:, :3, 3] = rng.uniform(-0.3, 0.3, (30, 3))
    target = np.repeat(np.arange(5), 6)
    points = rng.uniform((-0.5, -0.5, 1.5), (0.5, 0.5, 2.5), (5, 3))
    M = np.stack([np.eye(3, 4), np.eye(3, 4)])
    M[1, 0, 3] = -0.2
    seen = np.ones((30, 2), bool)
    seen[::7, 1] = False
    scene = Scene(target, E, np.zeros((30, 2, 2)), seen)
    clean, _ = residuals(scene, Estimate(M, np.zeros(2), points))
    scene = replace(scene, pixels=clean + 1e-3 * rng.standard_normal(clean.shape))
    start = Estimate(
        M + 0.01 * rng.standard_normal(M.shape), np.zeros(2), points + 0.05 * rng.standard_normal((5, 3))
    )
    return scene, start


def test_adjustment_finds_the_optimum_of_a_general_solver():
    rng = np.random.default_rng(3)
    scene, start = small_scene(rng)
    scale = 1e-3
    _, cost = adjust(scene, start, huber, scale, max_iterations=200)

    def weighted(x):
        now = Estimate(x[:24].reshape(2, 3, 4), np.zeros(2), x[24:].reshape(5, 3))
        s2 = np.square(residuals(scene, now)[0] / scale).sum(axis=-1)
        return np.sqrt(huber(s2)[0][scene.seen])

    reference = least_squares(weighted, np.append(start.M, start.points), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert cost <= 2 * reference.cost * (1 + 1e-5)


def test_linear_targets_are_exact_without_noise():
    rng = np.random.default_rng(4)
    scene, start = small_scene(rng)
    truth = Estimate(np.stack([np.eye(3, 4), np.eye(3, 4)]), np.zeros(2), start.points)
    scene = replace(scene, pixels=np.zeros_like(scene.pixels))
    scene = replace(scene, pixels=residuals(scene, truth)[0])
    np.testing.assert_allclose(triangulated(scene, truth.M, truth.radial), truth.points, atol=1e-5)


@pytest.mark.parametrize("task", TASKS)
def test_frame_by_frame_is_as_good_as_all_at_once(task):
    """New frames enter the equations where the estimate is; all is adjusted again only now and then."""
    spec = spec_of(task, frames=150, targets=6)
    simulation, at_once = learned(spec)
    by_frame = StructuredLearner(simulation.world.task)
    for frame in range(150):
        by_frame.partial_fit(simulation.tracks.select_frames(frame, frame + 1))
        assert by_frame.noise is None or by_frame.noise.scale_px > 0.0
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    one, other = (bundle(at_once.task, x.cameras, query) for x in (at_once, by_frame))
    truth = at_once.task.coordinates(query.truth, query.E_initial)
    # What one learner's answers differ from the other's is a small part of what both are off by.
    off = np.median(np.abs(one.p - truth), axis=0)
    assert (np.median(np.abs(one.p - other.p), axis=0) < 0.1 * off).all()


def test_a_frame_costs_the_same_however_many_came_before(monkeypatch):
    """Between two adjustments of everything, only the new frame's observations are looked at."""
    spec = spec_of("six_dof", frames=200, targets=6)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    learner = StructuredLearner(simulation.world.task)
    sizes = []
    original = structured.linearised

    def counting(scene, *rest):
        sizes.append(len(scene.target))
        return original(scene, *rest)

    monkeypatch.setattr(structured, "linearised", counting)
    for frame in range(200):
        learner.partial_fit(simulation.tracks.select_frames(frame, frame + 1))
        assert learner.losses is not None
    whole = [n for n in sizes if n > 6]
    assert sizes.count(6) > 120
    # Each adjustment of everything has a quarter more to look at than the one before.
    assert len(whole) < np.log(200) / np.log(1.25)


@pytest.mark.parametrize("task", TASKS)
def test_equations_renewed_bit_by_bit_are_as_good_as_all_at_once(task, monkeypatch):
    """Each time they have caught up they are one Gauss–Newton step of the whole adjustment."""
    monkeypatch.setattr(structured, "_FEW", 120)
    spec = spec_of(task, frames=300, targets=6)
    simulation, at_once = learned(spec)
    sizes, original = [], structured.adjust

    def counting(scene, *rest):
        sizes.append(len(scene.target))
        return original(scene, *rest)

    monkeypatch.setattr(structured, "adjust", counting)
    by_frame = StructuredLearner(simulation.world.task)
    for frame in range(300):
        by_frame.partial_fit(simulation.tracks.select_frames(frame, frame + 1))
        assert by_frame.losses is not None
    # Everything was adjusted last when there was about a quarter more than is few.
    assert max(sizes) <= 1.25 * 120 + 6
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    one, other = (bundle(at_once.task, x.cameras, query) for x in (at_once, by_frame))
    truth = at_once.task.coordinates(query.truth, query.E_initial)
    off = np.median(np.abs(one.p - truth), axis=0)
    assert (np.median(np.abs(one.p - other.p), axis=0) < 0.1 * off).all()


def test_a_frames_work_is_bounded(monkeypatch):
    """No more is looked at for a frame than its share of renewal and one portion put off till then."""
    monkeypatch.setattr(structured, "_FEW", 120)
    spec = spec_of("six_dof", frames=400, targets=6)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    learner = StructuredLearner(simulation.world.task)
    learner.partial_fit(simulation.tracks.select_frames(0, 100))
    assert learner.cameras is not None
    sizes, original = [], structured.linearised

    def counting(scene, *rest):
        sizes.append(len(scene.target))
        return original(scene, *rest)

    monkeypatch.setattr(structured, "linearised", counting)
    for frame in range(100, 400):
        learner.partial_fit(simulation.tracks.select_frames(frame, frame + 1))
        assert learner.cameras is not None
    assert max(sizes) <= 256 + 8 * 6
    # The frame itself, and eight old observations for each of its own.
    assert sum(sizes) <= 300 * 6 * (1 + 8)


def test_targets_that_come_later_are_learned(monkeypatch):
    """Observations without a place in the equations are counted; when they are many, all is adjusted."""
    monkeypatch.setattr(structured, "_FEW", 120)
    spec = spec_of("six_dof", frames=200, targets=8)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    learner = StructuredLearner(simulation.world.task)
    for frame in range(200):
        block = simulation.tracks.select_frames(frame, frame + 1)
        if frame < 100:
            here = block.target < 4
            some = block.frame[here], block.target[here], block.pixels[here]
            block = replace(block, frame=some[0], target=some[1], pixels=some[2])
        learner.partial_fit(block)
        assert learner.losses is not None
    codes = simulation.tracks.pixels[simulation.tracks.frame == 199]
    answer = learner.parameters(codes)
    assert answer.own.all()
    assert (answer.support == 8).all()


def test_a_fit_that_is_lost_is_found_again(monkeypatch):
    """One target moves on its own from the middle of the run on: all is adjusted again without it."""
    monkeypatch.setattr(structured, "_FEW", 120)
    spec = spec_of("six_dof", px=1.0, frames=300, targets=8)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    pixels = simulation.tracks.pixels.copy()
    moved = (simulation.tracks.target == 3) & (simulation.tracks.frame >= 60)
    pixels[moved] += (80.0, 0.0, 80.0, 0.0)
    tracks = replace(simulation.tracks, pixels=pixels)
    learner = StructuredLearner(simulation.world.task)
    for frame in range(300):
        learner.partial_fit(tracks.select_frames(frame, frame + 1))
        assert learner.losses is not None
    assert learner.losses == ("1 of 8 targets do not agree with the others",)
    assert learner.noise.scale_px == pytest.approx(1.0, rel=0.1)


def test_tracks_shuffled_between_ids_are_refused():
    spec = spec_of("six_dof", px=1.0)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    tracks, rng = simulation.tracks, np.random.default_rng(1)
    pixels = tracks.pixels.copy()
    for frame in range(tracks.n_frames):
        mine = np.nonzero(tracks.frame == frame)[0]
        pixels[mine] = pixels[rng.permutation(mine)]
    learner = StructuredLearner(simulation.world.task)
    learner.partial_fit(replace(tracks, pixels=pixels))
    assert learner.cameras is None
    assert "do not explain the images" in learner.losses[0]


def bent(codes, k, width=640.0, centre=(319.5, 239.5)):
    """Pixels of a lens: those that `(1 + k r²)` takes to the given ones of a pinhole camera."""
    straight = (codes.reshape(-1, 2, 2) - centre) / width
    out = straight.copy()
    for _ in range(50):
        out = straight / (1.0 + k * np.square(out).sum(axis=-1, keepdims=True))
    return (out * width + centre).reshape(codes.shape)


def test_a_lens_is_learned_where_that_is_asked_for():
    """Barrel distortion of up to 25 px: straight cameras do not explain it, learned lenses do."""
    spec = spec_of("six_dof", px=1.0, frames=300)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    query = held_out_queries(spec, trial_streams(spec, 0)[1])
    k = 0.3
    tracks = replace(simulation.tracks, pixels=bent(simulation.tracks.pixels, k))
    asked = Query(bent(query.initial, k), bent(query.desired, k), query.E_initial, query.E_desired)
    found = {}
    for distortion in (False, True):
        learner = StructuredLearner(simulation.world.task, distortion)
        learner.partial_fit(tracks)
        views = Query(
            learner.rectified(asked.initial),
            learner.rectified(asked.desired),
            asked.E_initial,
            asked.E_desired,
        )
        found[distortion] = errors(query, bundle(learner.task, learner.cameras, views))
        restored = StructuredLearner(learner.task, distortion)
        restored.restore(learner.state())
        np.testing.assert_array_equal(restored.rectified(asked.initial), views.initial)
    exact = errors(query, bundle(learner.task, simulation.world.cameras, query))
    for straight, lens, best in zip(found[False], found[True], exact, strict=True):
        assert lens < 1.15 * best
        assert straight > 1.25 * best


def test_visited_codes_answer_with_their_own_targets():
    """Known for hundreds of frames, a target is better placed than one noisy code can say."""
    spec = spec_of("six_dof")
    simulation, learner = learned(spec)
    codes = simulation.tracks.pixels[:20]
    answer = learner.parameters(codes)
    assert answer.own.all()
    x_bar = learner.task.lift(simulation.E_true @ inverse(simulation.E_true[0]))
    first = simulation.tracks.pixels[simulation.tracks.frame == 0]
    abc = np.einsum("kcra,na->nkcr", learner.parameters(first).rows, x_bar)
    predicted = first.reshape(-1, 2, 2) + abc[..., :2] / abc[..., 2:]
    # The code's own noise is in neither: what is left is what the cameras and targets are off by.
    off = (predicted - simulation.clean.reshape(predicted.shape)).reshape(-1, 2)
    assert np.median(np.linalg.norm(off, axis=1)) < 1.0
    assert not learner.parameters(codes + 0.5).own.any()


@pytest.mark.parametrize("task", TASKS)
def test_pixels_stay_as_they_are_where_no_lens_is_learned(task):
    """Not even rounding may bend them: codes that were visited are found again by their very bits."""
    spec = spec_of(task, frames=60, targets=6)
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    learner = StructuredLearner(simulation.world.task)
    first = simulation.tracks.pixels[simulation.tracks.frame == 0]
    for frame in range(60):
        learner.partial_fit(simulation.tracks.select_frames(frame, frame + 1))
        np.testing.assert_array_equal(learner.rectified(first), first)
    assert learner.parameters(first).own.all()
