"""Every estimator against an independent solution of the same problem."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares as scipy_least_squares

from vmf.estimate import (
    MlEstimator,
    QrEstimator,
    TlsEstimator,
    augmented_rows,
    unit_depth_gauge,
    update_rank_1,
    update_rank_k,
)
from vmf.geometry import project
from vmf.tasks import make_task

EPS = np.finfo(float).eps
# MINPACK's default tolerance on the relative gain, √ε: the reference's optimisers stopped no later.
MINPACK_TOLERANCE = 1.5e-8


def draw(case, rng, m=60, noise=0.5):
    """Lifts (m, k+1), noisy errors (m, 2) and the true parameters, from one centre."""
    E_c, P = case.centres(rng), case.points(rng)
    E = case.task.motion(case.unknowns(rng, m), np.repeat(E_c[None], m, axis=0))
    e = project(case.cameras.left, case.move(E, P[None])[:, 0])[0] - project(case.cameras.left, P)[0]
    return case.task.lift(E), e + noise * rng.normal(size=e.shape), case.task.parameters(case.cameras.left, P)


def literal_system(x_bar, e):
    """Eq. 3.46 with the sign of §9 C1: [E' 1 0 0 −e_x E'; 0 0 E' 1 −e_y E'] θ = e."""
    A, b = [], []
    for x, (e_x, e_y) in zip(x_bar, e, strict=True):
        lift, zero = list(x[:-1]), [0.0] * len(x)
        A.append([*lift, 1.0, *zero, *(-e_x * x[:-1])])
        A.append([*zero, *lift, 1.0, *(-e_y * x[:-1])])
        b += [e_x, e_y]
    return np.array(A), np.array(b)


def predict(rows, x_bar):
    abc = x_bar @ rows.T
    return abc[:, :2] / abc[:, 2:]


def reprojection(rows, x_bar, e):
    """Residual vector and smallest depth ratio of rows (3, k+1), whatever their gauge."""
    abc = x_bar @ rows.T
    return (abc[:, :2] / abc[:, 2:] - e).ravel(), abc[:, 2].min()


class TestFactor:
    def test_augmented_rows_are_the_literal_system(self, case, rng):
        x_bar, e, _ = draw(case, rng)
        A, b = literal_system(x_bar, e)
        np.testing.assert_array_equal(augmented_rows(x_bar, e).reshape(len(b), -1), np.column_stack([A, b]))

    @pytest.mark.parametrize("n", [1, 4, 12])
    def test_givens_is_lapack_up_to_row_signs(self, rng, n):
        rows = rng.normal(size=(3 * n, n))
        givens = np.zeros((n, n))
        for row in rows:
            givens = update_rank_1(givens, row)
        lapack = update_rank_k(np.zeros((n, n)), rows)
        flip = np.sign(np.diag(lapack)) * np.sign(np.diag(givens))
        size = np.linalg.norm(rows)
        tol = 8 * 3 * n * EPS * size * np.linalg.cond(rows)
        np.testing.assert_allclose(givens, flip[:, None] * lapack, rtol=0, atol=tol)
        np.testing.assert_array_equal(np.tril(givens, -1), 0.0)

    def test_factors_keep_the_inner_products(self, rng):
        """RᵀR = ΣrᵀR, which is what a triangular factor is for."""
        rows = rng.normal(size=(5, 20, 6))
        R = update_rank_k(np.zeros((6, 6)), rows)
        assert R.shape == (5, 6, 6)
        gram = np.swapaxes(rows, -1, -2) @ rows
        np.testing.assert_allclose(np.swapaxes(R, -1, -2) @ R, gram, rtol=0, atol=64 * EPS * gram.max())

    def test_updates_leave_their_inputs_alone(self, rng):
        R, row = np.triu(rng.normal(size=(4, 4))), rng.normal(size=4)
        kept = R.copy(), row.copy()
        update_rank_1(R, row)
        update_rank_k(R, row[None])
        np.testing.assert_array_equal(R, kept[0])
        np.testing.assert_array_equal(row, kept[1])

    @pytest.mark.parametrize("one_by_one", [True, False])
    def test_reference_incremental_least_squares(self, reference, one_by_one):
        data = reference["incremental_qr"]
        A, b = np.array(data["A"]), np.array(data["b"])
        rows = np.column_stack([A, b])
        n = rows.shape[1]
        R = np.zeros((n, n))
        if one_by_one:
            for row in rows:
                R = update_rank_1(R, row)
        else:
            for block in np.array_split(rows, 7):
                R = update_rank_k(R, block)
        solution = np.linalg.solve(R[:-1, :-1], R[:-1, -1])
        # 12 digits of A and b, times the condition of A; the norm is printed to 10 decimals.
        tol = 1e-12 * np.linalg.cond(A) * 10
        np.testing.assert_allclose(solution, data["solution"], rtol=0, atol=tol * np.abs(solution).max())
        assert abs(R[-1, -1]) == pytest.approx(data["residual_norm"], abs=tol * np.linalg.norm(b))


class TestQr:
    def test_is_batch_least_squares(self, case, rng):
        x_bar, e, _ = draw(case, rng)
        A, b = literal_system(x_bar, e)
        # The minimum-norm solution of the 9-entry lift, whose equations leave three directions free (C3).
        theta, _, rank, s = np.linalg.lstsq(A, b, rcond=1e-11)
        estimator = QrEstimator(x_bar.shape[1], n_free=case.n_free)
        estimator.partial_fit(x_bar[None], e[None])
        estimate = estimator.estimate()
        condition = s[0] / s[rank - 1]
        residual = np.linalg.norm(A @ theta - b)
        # Wedin's bound: ε κ (‖θ‖ + κ ‖r‖ / ‖A‖).
        tol = 64 * EPS * condition * (np.linalg.norm(theta) + condition * residual / s[0])
        found = estimate.rows[0].ravel()
        assert found[-1] == 1.0
        np.testing.assert_allclose(found[:-1], theta, rtol=0, atol=tol)
        assert estimate.rank[0] == rank
        assert estimate.condition[0] == pytest.approx(condition, rel=64 * EPS * condition)
        assert estimate.residual_px[0] * np.sqrt(len(b)) == pytest.approx(residual, rel=1e-9)

    @pytest.mark.parametrize("m", [1, 2, 3, 5])
    def test_gives_the_shortest_solution_while_rank_deficient(self, case, rng, m):
        x_bar, e, _ = draw(case, rng)
        A, b = literal_system(x_bar[:m], e[:m])
        theta, _, rank, s = np.linalg.lstsq(A, b, rcond=1e-11)
        if rank == A.shape[1]:
            pytest.skip("these many equations determine this task")
        estimator = QrEstimator(x_bar.shape[1], n_free=case.n_free)
        estimator.partial_fit(x_bar[None, :m], e[None, :m])
        estimate = estimator.estimate()
        condition = s[0] / s[rank - 1]
        residual = np.linalg.norm(A @ theta - b)
        tol = 64 * EPS * condition * (np.linalg.norm(theta) + condition * residual / s[0])
        assert not estimate.determined[0]
        assert estimate.rank[0] == rank
        np.testing.assert_allclose(estimate.rows[0].ravel()[:-1], theta, rtol=0, atol=tol)

    @pytest.mark.parametrize("name", ["translation", "planar", "six_dof", "pan_tilt"])
    def test_reference_values(self, reference, name):
        for x_bar, e, target, _ in reference_equations(reference, name):
            expected = np.array(target["least_squares_at_0_from_noisy_1_to_39"])
            estimator = QrEstimator(x_bar.shape[1])
            estimator.partial_fit(x_bar[None], e[None])
            estimate = estimator.estimate()
            theta = estimate.rows[0].ravel()[:-1]
            A, b = literal_system(x_bar, e)
            # 12 digits: relative 1e-12 of A and b through Wedin's bound.
            condition = np.linalg.cond(A)
            bound = np.linalg.norm(theta) + condition * np.linalg.norm(A @ theta - b) / np.linalg.norm(A, 2)
            np.testing.assert_allclose(theta, expected, rtol=1e-11, atol=1e-12 * condition * bound)
            # θ of an ill-conditioned system may differ; the least residual may not.
            least = np.linalg.norm(A @ expected - b)
            assert np.linalg.norm(A @ theta - b) == pytest.approx(least, rel=1e-6)


class TestTls:
    def test_is_the_smallest_singular_vector_of_the_scaled_rows(self, case, rng):
        x_bar, e, _ = draw(case, rng)
        if case.id == "pan_tilt":
            pytest.skip("its unobservable direction has no plain singular vector")
        # Hartley: errors centred, with mean square 1 per coordinate; lifts whitened to unit mean square.
        mean = e.mean(axis=0)
        spread = np.sqrt(np.square(e - mean).sum(axis=1).mean() / 2)
        target = (e - mean) / spread
        n = x_bar.shape[1]
        L = np.linalg.cholesky(x_bar.T @ x_bar / len(e)).T
        white = x_bar @ np.linalg.inv(L)
        zero = np.zeros_like(white)
        rows = np.concatenate(
            [
                np.concatenate([white, zero, -target[:, :1] * white], axis=1),
                np.concatenate([zero, white, -target[:, 1:] * white], axis=1),
            ]
        )
        _, s, Vt = np.linalg.svd(rows)
        a, b, c = Vt[-1].reshape(3, n) @ np.linalg.inv(L).T
        expected = np.stack([spread * a + mean[0] * c, spread * b + mean[1] * c, c])
        estimator = TlsEstimator(n)
        estimator.partial_fit(x_bar[None], e[None])
        estimate = estimator.estimate()
        rest = case.task.identity_lift
        found, expected = unit_depth_gauge(estimate.rows[0], rest), unit_depth_gauge(expected, rest)
        # Whitening and centring may each cost the condition of the lifts; a singular vector, its gap.
        size = np.abs(expected).max()
        tol = 64 * EPS * np.linalg.cond(x_bar) ** 2 * s[0] / (s[-2] - s[-1]) * size
        np.testing.assert_allclose(found, expected, rtol=0, atol=tol)

    def test_is_nearly_as_good_as_maximum_likelihood(self, case, rng):
        """With every observable direction counting alike, only the depth ratios (0.6 to 1.6) weigh rows."""
        missed = {TlsEstimator: [], MlEstimator: []}
        for _ in range(7):
            x_bar, e, truth = draw(case, rng, m=100)
            for make, errors in missed.items():
                estimator = make(x_bar.shape[1], n_free=case.n_free)
                estimator.partial_fit(x_bar[None], e[None])
                fit = predict(estimator.estimate().rows[0], x_bar)
                errors.append(np.sqrt(np.square(fit - predict(truth, x_bar)).mean()))
        assert np.median(missed[MlEstimator]) < 0.5
        assert np.median(missed[TlsEstimator]) < 1.6**2 * np.median(missed[MlEstimator])

    def test_does_not_depend_on_the_units(self, case, rng):
        """Pixels or millipixels, metres or millimetres: the predictions stay the same."""
        x_bar, e, _ = draw(case, rng)
        units = np.append(2.0 ** rng.integers(-10, 10, x_bar.shape[1] - 1), 1.0)
        plain, scaled = TlsEstimator(x_bar.shape[1]), TlsEstimator(x_bar.shape[1])
        plain.partial_fit(x_bar[None], e[None])
        scaled.partial_fit((x_bar * units)[None], 1024 * e[None])
        estimate = plain.estimate()
        tol = 64 * EPS * np.abs(e).max() * estimate.condition[0] * (2.0**20)
        np.testing.assert_allclose(
            predict(scaled.estimate().rows[0], x_bar * units) / 1024,
            predict(estimate.rows[0], x_bar),
            rtol=0,
            atol=tol,
        )

    def test_a_shift_of_all_errors_does_not_matter(self, case, rng):
        """§3: noise in u_c adds a constant to every e and changes a, b by multiples of c only."""
        x_bar, e, _ = draw(case, rng)
        shift = np.array([37.0, -12.0])
        plain, shifted = TlsEstimator(x_bar.shape[1]), TlsEstimator(x_bar.shape[1])
        plain.partial_fit(x_bar[None], e[None])
        shifted.partial_fit(x_bar[None], e[None] + shift)
        estimate = plain.estimate()
        tol = (
            64 * EPS * np.abs(e).max() * np.linalg.cond(literal_system(x_bar, e)[0][:, : 2 * x_bar.shape[1]])
        )
        tol *= estimate.condition[0]
        if case.id == "pan_tilt":
            tol = 64 * EPS * np.abs(e).max() * estimate.condition[0] * 1e3
        np.testing.assert_allclose(
            predict(shifted.estimate().rows[0], x_bar) - shift,
            predict(estimate.rows[0], x_bar),
            rtol=0,
            atol=tol,
        )


class TestMl:
    def test_scipy_from_the_truth_ends_at_the_same_cost(self, case, rng):
        x_bar, e, truth = draw(case, rng, m=80)
        estimator = MlEstimator(x_bar.shape[1], n_free=case.n_free)
        estimator.partial_fit(x_bar[None], e[None])
        estimate = estimator.estimate()
        r, nearest = reprojection(estimate.rows[0], x_bar, e)
        # Orthonormal lifts: the same problem over the same predictions, but well enough scaled for SciPy.
        U, s, Vt = np.linalg.svd(x_bar, full_matrices=False)
        kept = s > 1e-11 * s[0]
        white = U[:, kept] * np.sqrt(len(e))
        start = truth @ Vt[kept].T * s[kept] / np.sqrt(len(e))
        start[:2] /= 100.0
        expected = scipy_least_squares(
            lambda t: reprojection(t.reshape(3, -1), white, e / 100.0)[0],
            start.ravel(),
            x_scale="jac",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=2000,
        )
        # Both end where a relative gain of about 1e-14 is left.
        assert r @ r <= 2 * expected.cost * 1e4 * (1 + 1e-9)
        assert r @ r == pytest.approx(2 * expected.cost * 1e4, rel=1e-9)
        assert nearest > 0
        assert estimate.residual_px[0] == pytest.approx(np.sqrt(np.square(r).mean()), rel=1e-9)

    def test_beats_the_linear_estimators_and_the_truth_at_its_own_cost(self, case, rng):
        x_bar, e, truth = draw(case, rng)
        costs = {}
        for make in (QrEstimator, TlsEstimator, MlEstimator):
            estimator = make(x_bar.shape[1], n_free=case.n_free)
            estimator.partial_fit(x_bar[None], e[None])
            costs[make] = np.square(reprojection(estimator.estimate().rows[0], x_bar, e)[0]).sum()
        assert costs[MlEstimator] <= min(costs.values()) * (1 + 1e-12)
        assert costs[MlEstimator] < np.square(reprojection(truth, x_bar, e)[0]).sum()

    @pytest.mark.parametrize("name", ["translation", "planar", "six_dof"])
    def test_reference_values(self, reference, name):
        task = make_task(name)
        for x_bar, e, target, E in reference_equations(reference, name):
            expected = np.array(target["ml_unit_depth_at_0_from_noisy_1_to_39"]).reshape(3, -1)
            estimator = MlEstimator(x_bar.shape[1])
            estimator.partial_fit(x_bar[None], e[None])
            estimate = estimator.estimate()
            assert estimate.determined[0]
            found = unit_depth_gauge(estimate.rows[0], task.identity_lift)
            ours, nearest = reprojection(found, x_bar, e)
            theirs, _ = reprojection(expected, x_bar, e)
            # The same minimum: ours no higher, theirs within the tolerance of its optimiser.
            assert nearest > 0
            assert ours @ ours <= theirs @ theirs * (1 + 1e-12)
            assert theirs @ theirs <= ours @ ours * (1 + MINPACK_TOLERANCE)
            # ‖J δθ‖² is twice the gain left, so every prediction moves by no more than its root.
            moved = np.sqrt(2 * MINPACK_TOLERANCE) * np.linalg.norm(ours)
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=moved)
            at_7 = predict(found, task.lift(E[7:8]))[0]
            np.testing.assert_allclose(at_7, target["ml_predicted_left_error_at_7"], rtol=0, atol=moved)

    def test_the_reference_for_pan_tilt_is_no_optimum(self, reference):
        """Its "ml" parameters put observations behind the camera and cost more than ours and the truth."""
        task = make_task("pan_tilt", "thesis")
        for x_bar, e, target, _ in reference_equations(reference, "pan_tilt"):
            theirs, their_nearest = reprojection(
                np.array(target["ml_unit_depth_at_0_from_noisy_1_to_39"]).reshape(3, -1), x_bar, e
            )
            truth = np.array(target["unit_depth_at_0"]).reshape(3, -1)
            # The errors carry the noise of pose 0, which any fit may shift away: so may the truth.
            a, b, c = truth
            free = (e - predict(truth, x_bar)).mean(axis=0)
            shifted, nearest_of_truth = reprojection(
                np.stack([a + free[0] * c, b + free[1] * c, c]), x_bar, e
            )
            estimator = MlEstimator(x_bar.shape[1])
            estimator.partial_fit(x_bar[None], e[None])
            estimate = estimator.estimate()
            ours, nearest = reprojection(unit_depth_gauge(estimate.rows[0], task.identity_lift), x_bar, e)
            assert their_nearest < 0 < min(nearest, nearest_of_truth)
            assert theirs @ theirs > shifted @ shifted > ours @ ours
            assert estimate.determined[0]


def reference_equations(reference, name):
    """Lifts, noisy errors of poses 1 … 39 from 0, the target and all poses, for each target."""
    data = reference["tasks"][name]
    task = make_task(name, "thesis")
    E = np.array(data["E"])
    for target in data["targets"]:
        u = np.array(target["left_noisy"])
        yield task.lift(E[1:]), u[1:] - u[0], target, E


class TestRobust:
    @pytest.mark.parametrize("loss", ["huber", "tukey"])
    def test_gross_outliers_do_little_harm(self, case, rng, loss):
        """One track in ten is somewhere else in the image: predictions stay an order of magnitude nearer."""
        if case.id.startswith("pan_tilt") and loss == "huber":
            pytest.skip("Huber's weights never vanish: a pole of c·x̄ beside one wrong track outlives them")
        missed = {"squared": [], loss: []}
        for _ in range(5):
            x_bar, e, truth = draw(case, rng, m=200)
            exact = predict(truth, x_bar)
            wrong = rng.permutation(200)[:20]
            e[wrong] += rng.uniform(50, 300, (20, 2)) * rng.choice([-1, 1], (20, 2))
            for name, errors in missed.items():
                estimator = MlEstimator(x_bar.shape[1], n_free=case.n_free, loss=name)
                estimator.partial_fit(x_bar[None], e[None])
                fit = predict(estimator.estimate().rows[0], x_bar)
                errors.append(np.sqrt(np.square(fit - exact).mean()))
        assert np.median(missed[loss]) < np.median(missed["squared"]) / 10
        # Noise of 0.5 px on 400 coordinates, ≤ 38 parameters: 0.5 √(38/400) is 0.15 px without outliers.
        assert np.median(missed[loss]) < 0.5

    @pytest.mark.parametrize("loss", ["huber", "tukey"])
    def test_clean_data_cost_little(self, case, rng, loss):
        x_bar, e, truth = draw(case, rng, m=200)
        missed = {}
        for name in ("squared", loss):
            estimator = MlEstimator(x_bar.shape[1], n_free=case.n_free, loss=name)
            estimator.partial_fit(x_bar[None], e[None])
            fit = predict(estimator.estimate().rows[0], x_bar)
            missed[name] = np.sqrt(np.square(fit - predict(truth, x_bar)).mean())
        # 95 % efficient on average; one draw of ≤ 38 parameters scatters by 1/√(2·11) about that.
        assert missed[loss] < 1.5 * missed["squared"]

    @pytest.mark.parametrize("loss", ["huber", "tukey"])
    def test_exact_data_stay_exact(self, case, rng, loss):
        x_bar, e, _ = draw(case, rng, noise=0.0)
        estimator = MlEstimator(x_bar.shape[1], n_free=case.n_free, loss=loss)
        estimator.partial_fit(x_bar[None], e[None])
        estimate = estimator.estimate()
        tol = 64 * EPS * estimate.condition[0] * np.abs(e).max()
        np.testing.assert_allclose(predict(estimate.rows[0], x_bar), e, rtol=0, atol=tol)
        assert estimate.determined[0]

    @pytest.mark.parametrize("loss", ["squared", "huber", "tukey"])
    def test_missing_errors_do_not_confuse_the_scale(self, case, rng, loss):
        x_bar, e, truth = draw(case, rng, m=200)
        e[::2] = np.nan
        estimator = MlEstimator(x_bar.shape[1], n_free=case.n_free, loss=loss)
        estimator.partial_fit(x_bar[None], e[None])
        fit = predict(estimator.estimate().rows[0], x_bar)
        assert np.sqrt(np.square(fit - predict(truth, x_bar)).mean()) < 0.5
