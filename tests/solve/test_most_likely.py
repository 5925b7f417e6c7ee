"""The most likely motion: of a learned function, with honest covariances, among wrong correspondences."""

from dataclasses import replace

import numpy as np
import pytest

from vmf.data.simulate import held_out_queries, make_world, simulate, trial_streams
from vmf.estimate.noise import Noise
from vmf.geometry import inverse, rotation_angle, triangulate
from vmf.learn import StructuredLearner
from vmf.reconstruct import bundle
from vmf.solve import Function, SolverOptions, StopReason, ask, ask_known, ask_most_likely, concatenate
from vmf.spec import Spec
from vmf.tasks import TASKS

ML = SolverOptions(cost="ml")


def asked(task, *, px, queries, targets):
    """An experiment's world, and queries on new targets at new poses."""
    spec = Spec.model_validate(
        {
            "task": task,
            "data": {"simulate": {"frames": 300, "targets": 8}},
            "noise": {"pixel_px": px},
            "evaluate": {"queries": queries, "query_targets": targets},
        }
    )
    return spec, make_world(spec), held_out_queries(spec, trial_streams(spec, 0)[1])


def analytic(world):
    """The exact visuomotor function of a world's cameras, as a learner would offer it."""

    def parameters(codes):
        rows = np.full((len(codes), 2, 3, world.task.n_lift + 1), np.nan)
        found = triangulate(world.cameras, codes)
        rows[found.ok] = world.task.parameters(world.cameras.M, found.points[found.ok][:, None])
        return rows, np.zeros(len(codes), bool)

    # A parallel rig: both images show a target in the same row.
    return Function(parameters, lambda q: q[:, 1].copy())


def off(query, solutions):
    """Median angle and distance of the errors, of all but one in a hundred at most."""
    ok = solutions.status == "ok"
    assert ok.mean() >= 0.99
    truth, E = query.truth[ok], solutions.E_to_from[ok]
    between = inverse(truth) @ E
    shift = E[:, :3, 3] - truth[:, :3, 3]
    return np.median(rotation_angle(between)), np.median(np.linalg.norm(shift, axis=1))


@pytest.mark.parametrize("task", TASKS)
def test_of_the_exact_function_it_is_that_of_the_exact_cameras(task):
    """Taking Θ_S as affine near a code costs the square of the noise over the size of the image."""
    _, world, query = asked(task, px=0.1, queries=40, targets=6)
    mine = ask_most_likely(world.task, analytic(world), query, ML, None)
    theirs = bundle(world.task, world.cameras, query)
    spread = np.sqrt(np.einsum("qii->qi", theirs.covariance))
    assert (mine.status == "ok").all()
    assert np.median(np.abs(mine.p - theirs.p) / spread) < 0.05


@pytest.mark.parametrize("task", ["translation", "planar", "six_dof"])
def test_it_beats_the_geometric_cost(task):
    """The noise of the code that indexes the parameters dominates single shots, and `ml` minds it."""
    _, world, query = asked(task, px=3.0, queries=300, targets=6)
    function = analytic(world)
    geometric = ask(world.task, lambda c: function.parameters(c)[0], query, SolverOptions())
    usual = np.nonzero(geometric.status == "ok")[0]
    some = query.select(usual)
    mine = off(some, ask_most_likely(world.task, function, some, ML, Noise(3.0)))
    theirs = off(some, geometric.select(usual))
    assert mine[0] <= theirs[0] + 1e-12
    assert mine[1] < 0.8 * theirs[1]


@pytest.mark.parametrize("task", TASKS)
def test_covariance_is_what_the_errors_are(task):
    """Mean squared Mahalanobis distance over 1000 questions to the *learned* function: that of its freedom.

    A tenth of a pixel keeps the worst-posed of the questions in the range of first order.
    """
    spec, world, query = asked(task, px=0.1, queries=1000, targets=6)
    learner = StructuredLearner(world.task)
    learner.partial_fit(simulate(spec, trial_streams(spec, 0)[0]).tracks)
    found = bundle(world.task, learner.cameras, query, noise=learner.noise)
    assert (found.status == "ok").all()
    error = found.p - world.task.coordinates(query.truth, query.E_initial)
    angles = np.array([unit == "rad" for _, unit in world.task.components])
    error[:, angles] = (error[:, angles] + np.pi) % (2 * np.pi) - np.pi
    distance = np.einsum("qi,qij,qj->q", error, np.linalg.inv(found.covariance), error)
    assert distance.mean() == pytest.approx(world.task.n_motion, rel=0.10)


@pytest.mark.parametrize("task", TASKS)
def test_wrong_correspondences_are_rejected_and_named(task):
    """Two of ten targets end anywhere: the error stays below twice that without them, and they are shown."""
    _, world, query = asked(task, px=3.0, queries=150, targets=10)
    rng = np.random.default_rng(5)
    wrong = rng.permuted(np.tile(np.arange(10) < 2, (150, 1)), axis=1)
    anywhere = rng.uniform((0, 0, 0, 0), (640, 480, 640, 480), (150, 10, 4))
    spoilt = replace(query, desired=np.where(wrong[..., None], anywhere, query.desired))
    clean = bundle(world.task, world.cameras, query, noise=Noise(3.0))
    robust = bundle(world.task, world.cameras, spoilt, noise=Noise(3.0))
    for one, other in zip(off(query, robust), off(query, clean), strict=True):
        assert one <= 2.0 * other + 1e-12
    assert robust.rejected[wrong].mean() > 0.97
    assert robust.rejected[~wrong].mean() < 0.01
    assert not clean.rejected.any()


def test_most_targets_against_any_motion_is_no_answer():
    _, world, query = asked("six_dof", px=1.0, queries=20, targets=10)
    rng = np.random.default_rng(6)
    anywhere = rng.uniform((0, 0, 0, 0), (640, 480, 640, 480), query.desired.shape)
    found = bundle(world.task, world.cameras, replace(query, desired=anywhere), noise=Noise(1.0))
    assert (found.status != "ok").all()
    assert StopReason.INCONSISTENT in found.reason


@pytest.mark.parametrize("noise", [None, Noise(1.0)])
def test_questions_that_all_diverge_end_as_they_do_among_others(noise):
    _, world, query = asked("six_dof", px=1.0, queries=20, targets=6)
    rng = np.random.default_rng(6)
    anywhere = rng.uniform((0, 0, 0, 0), (640, 480, 640, 480), query.desired.shape)
    query = replace(query, desired=anywhere)
    among = bundle(world.task, world.cameras, query, noise=noise)
    lost = np.flatnonzero(among.status == "diverged")
    assert lost.size
    alone = bundle(world.task, world.cameras, query.select(lost), noise=noise)
    assert list(alone.reason) == list(among.reason[lost])
    assert np.isnan(alone.E_to_from).all()


def test_questions_that_cannot_be_asked_leave_the_others_as_they_are():
    _, world, query = asked("translation", px=0.5, queries=6, targets=3)
    alone = bundle(world.task, world.cameras, query, noise=Noise(0.5))
    blind = query.initial.copy()
    blind[[0, 3]] = np.nan
    some = bundle(world.task, world.cameras, replace(query, initial=blind), noise=Noise(0.5))
    assert (some.status[[0, 3]] == "refused").all()
    np.testing.assert_array_equal(some.E_to_from[[1, 2, 4, 5]], alone.E_to_from[[1, 2, 4, 5]])


def test_of_two_targets_that_contradict_each_other_neither_is_believed():
    """One of each pair is matched with the other's desired view of another question."""
    _, world, query = asked("translation", px=0.5, queries=60, targets=2)
    desired = query.desired.copy()
    desired[:, 1] = np.roll(desired[:, 1], 1, axis=0)
    solutions = bundle(world.task, world.cameras, replace(query, desired=desired), noise=Noise(0.5))
    answered = solutions.status == "ok"
    between = np.linalg.norm((query.truth - solutions.E_to_from)[:, :3, 3], axis=1)
    # Some wrong matches happen to fit; an answer far from the truth must be rare.
    assert (answered & (between > 0.3)).mean() < 0.1
    assert answered.mean() < 0.3


def test_known_codes_have_no_noise_of_their_own():
    """Parameters that hold for a code as it was observed make `ml` the geometric cost."""
    _, world, query = asked("six_dof", px=1.0, queries=30, targets=6)
    rows = np.full((*query.initial.shape[:2], 2, 3, 13), np.nan)
    rows[:] = analytic(world).parameters(query.initial.reshape(-1, 4))[0].reshape(rows.shape)
    known = ask_known(world.task, rows, query, ML, None)
    geometric = ask_known(world.task, rows, query, SolverOptions(), None)
    np.testing.assert_allclose(known.p, geometric.p, rtol=0, atol=1e-6)


@pytest.mark.parametrize("task", TASKS)
def test_known_codes_are_answered_as_by_two_views(task):
    """With parameters of its own for every code, the places of two views have nothing to say."""
    _, world, query = asked(task, px=1.0, queries=30, targets=6)
    exact, noise = analytic(world), Noise(1.0, np.inf)
    rows = exact.parameters(query.initial.reshape(-1, 4))[0]
    rows = rows.reshape(*query.initial.shape[:2], *rows.shape[1:])

    def own(codes):
        return exact.parameters(codes)[0], np.ones(len(codes), bool)

    desired = query.desired.copy()
    desired[::3, 0, :2] = np.nan
    query = replace(query, desired=desired)
    known = ask_known(world.task, rows, query, ML, noise)
    general = ask_most_likely(world.task, Function(own, exact.y_right), query, ML, noise)
    np.testing.assert_array_equal(known.status, general.status)
    # Both end where a further step gains less than a thousandth of a standard error.
    ok = known.status == "ok"
    sigma = np.sqrt(np.einsum("qii->qi", known.covariance[ok]))
    assert (np.abs(known.p[ok] - general.p[ok]) <= 5e-3 * sigma).all()
    np.testing.assert_allclose(known.covariance[ok], general.covariance[ok], rtol=0.02)


def test_without_parameters_it_says_so():
    _, world, query = asked("six_dof", px=1.0, queries=3, targets=6)

    def nothing(codes):
        return np.full((len(codes), 2, 3, 13), np.nan), np.zeros(len(codes), bool)

    found = ask_most_likely(world.task, Function(nothing, lambda q: q[:, 1]), query, ML, None)
    assert all(reason is StopReason.NO_PARAMETERS for reason in found.reason)


def test_one_camera_of_the_desired_view_is_enough():
    _, world, query = asked("six_dof", px=0.1, queries=30, targets=6)
    left = ask_most_likely(world.task, analytic(world), query, replace(ML, cameras="left"), None)
    right_gone = query.of_camera("left")
    same = ask_most_likely(world.task, analytic(world), right_gone, ML, None)
    # Their starts differ: by the geometric cost, the other camera's errors are left out or not seen.
    np.testing.assert_allclose(left.p, same.p, rtol=0, atol=1e-6)
    assert (left.status == "ok").all()


def test_solutions_of_different_sizes_are_joined():
    _, world, few = asked("translation", px=1.0, queries=3, targets=2)
    _, _, many = asked("translation", px=1.0, queries=2, targets=5)
    joined = concatenate([bundle(world.task, world.cameras, q, noise=Noise(1.0)) for q in (few, many)])
    assert joined.weights.shape == (5, 5)
    assert np.isnan(joined.weights[:3, 2:]).all()
    assert np.isfinite(joined.weights[3:]).all()
