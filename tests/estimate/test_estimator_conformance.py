"""What every incremental estimator promises, for every task space and kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from vmf.estimate import ESTIMATORS
from vmf.geometry import project

Floats = NDArray[np.float64]
EPS = np.finfo(float).eps
M = 60


@dataclass(frozen=True)
class Equations:
    """Lifts (B, m, k+1) and errors (B, m, 2) of B targets in the left camera, and what they should be."""

    x_bar: Floats
    e: Floats
    truth: Floats


def draw(case, rng, batch=1, m=M, noise=0.0):
    E_c, P = case.centres(rng, batch), case.points(rng, batch)
    E = case.task.motion(case.unknowns(rng, batch, m), np.repeat(E_c[:, None], m, axis=1))
    moved = (E[..., :3, :3] @ P[:, None, :, None])[..., 0] + E[..., :3, 3]
    e = project(case.cameras.left, moved)[0] - project(case.cameras.left, P)[0][:, None]
    return Equations(case.task.lift(E), e + noise * rng.normal(size=e.shape), e)


def predict(rows, x_bar):
    abc = x_bar @ np.swapaxes(rows, -1, -2)
    return abc[..., :2] / abc[..., 2:]


def tolerance(name, estimate, equations):
    """Pixels by which two right answers may differ in their predictions of the errors they were fitted to.

    A backward-stable solution of rows of size |e| is off by ε · condition · size, a few dozen operations an
    entry, and a prediction divides that by its depth ratio (|c|·|x̄| / c·x̄ is the cancellation in it).
    Maximum likelihood ends at a relative gain of 1e-14, which leaves √1e-14 of the residual norm.
    """
    c, x_bar, e = estimate.rows[:, None, 2], equations.x_bar, equations.e
    known = np.isfinite(e).all(axis=-1)
    cancellation = (np.abs(c) * np.abs(x_bar)).sum(axis=-1) / np.abs((c * x_bar).sum(axis=-1))
    rounding = 64 * EPS * estimate.condition.max() * np.abs(e[known]).max() * cancellation[known].max() ** 2
    if name != "ml":
        return rounding
    return rounding + 10 * 1e-7 * (estimate.residual_px * np.sqrt(estimate.n_equations)).max()


@pytest.fixture(params=["lapack", "givens"])
def kernel(request):
    return request.param


@pytest.fixture(params=list(ESTIMATORS))
def name(request):
    return request.param


@pytest.fixture
def make(case, name, kernel):
    def build(batch=1):
        return ESTIMATORS[name](case.task.n_lift + 1, batch, n_free=case.n_free, kernel=kernel)

    return build


def fitted(make, equations, rounds=1):
    estimator = make(len(equations.e))
    for part in np.array_split(np.arange(equations.e.shape[1]), rounds):
        estimator.partial_fit(equations.x_bar[:, part], equations.e[:, part])
    return estimator


def test_before_any_equation_there_is_an_undetermined_estimate(case, make):
    estimate = make(2).estimate()
    assert estimate.rows.shape == (2, 3, case.task.n_lift + 1)
    assert not estimate.determined.any()
    np.testing.assert_array_equal(estimate.rank, 0)
    np.testing.assert_array_equal(estimate.n_equations, 0)


def test_noise_free_equations_give_exact_predictions(case, make, name, rng):
    equations = draw(case, rng, batch=2)
    estimate = fitted(make, equations).estimate()
    assert estimate.determined.all()
    np.testing.assert_array_equal(estimate.n_equations, 2 * M)
    tol = tolerance(name, estimate, equations)
    np.testing.assert_allclose(predict(estimate.rows, equations.x_bar), equations.e, rtol=0, atol=tol)
    assert (estimate.residual_px <= tol).all()


def test_noise_free_equations_predict_new_motions(case, make, name, rng):
    E_c, P = case.centres(rng), case.points(rng)
    E = case.task.motion(case.unknowns(rng, 2 * M), np.repeat(E_c[None], 2 * M, axis=0))
    e = project(case.cameras.left, case.move(E, P[None])[:, 0])[0] - project(case.cameras.left, P)[0]
    x_bar = case.task.lift(E)
    estimator = make()
    estimator.partial_fit(x_bar[None, :M], e[None, :M])
    estimate = estimator.estimate()
    # New lifts are combinations of the old ones; their largest coefficient multiplies the rounding.
    leverage = np.abs(np.linalg.lstsq(x_bar[:M].T, x_bar[M:].T, rcond=1e-11)[0]).sum(axis=0).max()
    tol = tolerance(name, estimate, Equations(x_bar[None], e[None], e[None])) * max(1.0, leverage)
    np.testing.assert_allclose(predict(estimate.rows[0], x_bar[M:]), e[M:], rtol=0, atol=tol)


def test_order_of_equations_does_not_matter(case, make, name, rng):
    equations = draw(case, rng, noise=0.5)
    order = rng.permutation(M)
    estimate = fitted(make, equations).estimate()
    shuffled = fitted(
        make, Equations(equations.x_bar[:, order], equations.e[:, order], equations.truth)
    ).estimate()
    x_bar = equations.x_bar
    tol = tolerance(name, estimate, equations)
    np.testing.assert_allclose(predict(shuffled.rows, x_bar), predict(estimate.rows, x_bar), rtol=0, atol=tol)
    np.testing.assert_array_equal(shuffled.rank, estimate.rank)
    np.testing.assert_array_equal(shuffled.determined, estimate.determined)


@pytest.mark.parametrize("rounds", [7, M])
def test_size_of_portions_does_not_matter(case, make, name, rng, rounds):
    equations = draw(case, rng, noise=0.5)
    at_once, in_portions = fitted(make, equations).estimate(), fitted(make, equations, rounds).estimate()
    tol = tolerance(name, at_once, equations)
    x_bar = equations.x_bar
    np.testing.assert_allclose(
        predict(in_portions.rows, x_bar), predict(at_once.rows, x_bar), rtol=0, atol=tol
    )
    np.testing.assert_allclose(in_portions.residual_px, at_once.residual_px, rtol=0, atol=tol)
    np.testing.assert_array_equal(in_portions.n_equations, at_once.n_equations)


def test_asking_changes_nothing(case, make, rng):
    equations = draw(case, rng, noise=0.5)
    estimator = fitted(make, equations)
    first, second = estimator.estimate(), estimator.estimate()
    np.testing.assert_array_equal(first.rows, second.rows)


def test_inputs_are_neither_changed_nor_kept(case, make, rng):
    equations = draw(case, rng, noise=0.5)
    x_bar, e = equations.x_bar.copy(), equations.e.copy()
    estimator = make()
    estimator.partial_fit(x_bar, e)
    np.testing.assert_array_equal(x_bar, equations.x_bar)
    np.testing.assert_array_equal(e, equations.e)
    before = estimator.estimate()
    x_bar[:], e[:] = 7.0, -1e6
    np.testing.assert_array_equal(estimator.estimate().rows, before.rows)


def test_outputs_are_not_the_insides(case, make, rng):
    estimator = fitted(make, draw(case, rng, noise=0.5))
    before = estimator.estimate().rows.copy()
    estimator.estimate().rows[:] = 0.0
    state = estimator.state()
    for array in state.values():
        array[:] = 0.0
    np.testing.assert_array_equal(estimator.estimate().rows, before)


def test_restored_state_goes_on_equal(case, make, rng):
    equations = draw(case, rng, batch=2, noise=0.5)
    estimator = make(2)
    estimator.partial_fit(equations.x_bar[:, :40], equations.e[:, :40])
    state = estimator.state()
    other = make(2)
    other.restore(state)
    np.testing.assert_array_equal(other.estimate().rows, estimator.estimate().rows)
    for one in (estimator, other):
        one.partial_fit(equations.x_bar[:, 40:], equations.e[:, 40:])
    np.testing.assert_array_equal(other.estimate().rows, estimator.estimate().rows)
    # Going on must not have written into the state that was handed out.
    third = make(2)
    third.restore(state)
    np.testing.assert_array_equal(third.estimate().n_equations, 80)


def test_memory_is_bounded_where_promised(case, make, name, rng):
    equations = draw(case, rng, noise=0.5)
    estimator = fitted(make, equations)
    before = sum(a.nbytes for a in estimator.state().values())
    estimator.partial_fit(equations.x_bar, equations.e)
    after = sum(a.nbytes for a in estimator.state().values())
    assert estimator.bounded_memory == (name != "ml")
    if estimator.bounded_memory:
        assert after == before
    else:
        assert after - before == equations.x_bar.nbytes + equations.e.nbytes


def test_centres_of_a_batch_are_strangers(case, make, name, rng):
    equations = draw(case, rng, batch=3, noise=0.5)
    together = fitted(make, equations).estimate()
    for b in range(3):
        one = Equations(equations.x_bar[b : b + 1], equations.e[b : b + 1], equations.truth[b : b + 1])
        alone = fitted(make, one).estimate()
        np.testing.assert_allclose(
            predict(alone.rows, one.x_bar),
            predict(together.rows[b : b + 1], one.x_bar),
            rtol=0,
            atol=tolerance(name, alone, one),
        )
        assert alone.rank[0] == together.rank[b]
        assert alone.residual_px[0] == pytest.approx(together.residual_px[b], rel=1e-6)


@pytest.mark.parametrize("hole", [(np.nan, np.nan), (np.nan, 3.0), (3.0, np.nan)])
def test_errors_that_are_missing_add_nothing(case, make, name, rng, hole):
    equations = draw(case, rng, noise=0.5)
    with_holes = equations.e.copy()
    with_holes[:, ::4] = hole
    keep = np.arange(M) % 4 != 0
    holey = fitted(make, Equations(equations.x_bar, with_holes, equations.truth)).estimate()
    kept = Equations(equations.x_bar[:, keep], equations.e[:, keep], equations.truth[:, keep])
    short = fitted(make, kept).estimate()
    np.testing.assert_allclose(
        predict(holey.rows, kept.x_bar),
        predict(short.rows, kept.x_bar),
        rtol=0,
        atol=tolerance(name, short, kept),
    )
    np.testing.assert_array_equal(holey.n_equations, 2 * keep.sum())
    np.testing.assert_array_equal(holey.n_equations, short.n_equations)
    np.testing.assert_array_equal(holey.rank, short.rank)
    assert holey.residual_px[0] == pytest.approx(short.residual_px[0], rel=1e-6)


def test_lifts_that_are_missing_with_their_errors_add_nothing(case, make, rng):
    equations = draw(case, rng, noise=0.5)
    x_bar, e = equations.x_bar.copy(), equations.e.copy()
    x_bar[:, 3], e[:, 3] = np.nan, np.nan
    estimate = fitted(make, Equations(x_bar, e, equations.truth)).estimate()
    assert np.isfinite(estimate.rows).all()
    assert estimate.n_equations[0] == 2 * (M - 1)


def test_nothing_but_holes_is_nothing(case, make, rng):
    equations = draw(case, rng)
    estimate = fitted(
        make, Equations(equations.x_bar, np.full_like(equations.e, np.nan), equations.truth)
    ).estimate()
    assert not estimate.determined[0]
    assert estimate.n_equations[0] == 0
    assert estimate.rank[0] == 0


def test_undetermined_until_there_are_enough_equations(case, make, rng):
    """3·n_free − 1 unknowns need as many equations, and generic ones suffice."""
    needed = int(np.ceil((3 * case.n_free - 1) / 2))
    equations = draw(case, rng, m=needed + 3)
    for m, enough in ((1, False), (needed - 1, False), (needed + 3, True)):
        estimator = make()
        estimator.partial_fit(equations.x_bar[:, :m], equations.e[:, :m])
        estimate = estimator.estimate()
        assert bool(estimate.determined[0]) is enough
        assert np.isfinite(estimate.rows).all()
        assert estimate.rank[0] <= min(2 * m, 3 * case.n_free - 1 + (estimate.residual_px[0] > 1e-9))


def test_one_observation_repeated_never_suffices(case, make, rng):
    equations = draw(case, rng, m=1, noise=0.5)
    estimator = make()
    estimator.partial_fit(np.repeat(equations.x_bar, M, axis=1), np.repeat(equations.e, M, axis=1))
    estimate = estimator.estimate()
    assert not estimate.determined[0]
    assert estimate.n_equations[0] == 2 * M


def test_motions_along_one_line_never_suffice(case, make, rng):
    E_c, P = case.centres(rng), case.points(rng)
    p = np.linspace(-0.2, 0.2, M)[:, None] * np.eye(case.task.n_motion)[-1]
    E = case.task.motion(p, np.repeat(E_c[None], M, axis=0))
    e = project(case.cameras.left, case.move(E, P[None])[:, 0])[0] - project(case.cameras.left, P)[0]
    estimator = make()
    estimator.partial_fit(case.task.lift(E)[None], e[None])
    assert not estimator.estimate().determined[0]


def test_kernels_agree(case, name, rng):
    equations = draw(case, rng, noise=0.5)
    estimates = []
    for kernel in ("lapack", "givens"):
        estimator = ESTIMATORS[name](case.task.n_lift + 1, n_free=case.n_free, kernel=kernel)
        estimator.partial_fit(equations.x_bar, equations.e)
        estimates.append(estimator.estimate())
    np.testing.assert_allclose(
        *(predict(e.rows, equations.x_bar) for e in estimates),
        rtol=0,
        atol=tolerance(name, estimates[0], equations),
    )
