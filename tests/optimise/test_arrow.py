"""Problems of arrow shape: the minima of a general solver, and every problem a stranger to the others."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from vmf.optimise import Equations, Stop, minimise_arrow

F, N = 2, 4


class Circles:
    """Points q_j seen from a shared shift x: two bent views of each, so that the costs are not quadratic."""

    def __init__(self, rng, problems):
        self.data = rng.normal(size=(problems, N, 6))
        self.x = rng.normal(size=(problems, F))
        self.q = rng.normal(size=(problems, N, 3))

    def residuals(self, x, q, index):
        shift = np.concatenate([x, np.zeros((len(x), 1))], axis=1)[:, None]
        r = np.concatenate([q, np.sin(q) + shift + 0.1 * q**2], axis=-1) - self.data[index]
        J_q = np.zeros((*r.shape, 3))
        J_x = np.zeros((*r.shape, F))
        for i in range(3):
            J_q[..., i, i] = 1.0
            J_q[..., 3 + i, i] = np.cos(q[..., i]) + 0.2 * q[..., i]
        for i in range(F):
            J_x[..., 3 + i, i] = 1.0
        return r, J_x, J_q

    def equations(self, x, q, index):
        r, J_x, J_q = self.residuals(x, q, index)
        t = lambda J: np.swapaxes(J, -1, -2)  # noqa: E731
        return Equations(
            0.5 * np.square(r).sum(axis=(1, 2)),
            (t(J_x) @ J_x).sum(axis=1),
            t(J_x) @ J_q,
            t(J_q) @ J_q,
            (t(J_x) @ r[..., None])[..., 0].sum(axis=1),
            (t(J_q) @ r[..., None])[..., 0],
        )


def test_minima_are_those_of_a_general_solver(rng):
    problem = Circles(rng, 6)
    fit = minimise_arrow(problem.equations, problem.x, problem.q)
    assert fit.converged.all()
    for i in range(6):

        def flat(z, i=i):
            r, _, _ = problem.residuals(z[None, :F], z[F:].reshape(1, N, 3), np.array([i]))
            return r.ravel()

        start = np.append(fit.x[i], fit.q[i])
        reference = least_squares(flat, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        assert fit.cost[i] <= reference.cost * (1 + 1e-9)


def test_each_problem_ends_as_it_does_alone(rng):
    problem = Circles(rng, 5)
    together = minimise_arrow(problem.equations, problem.x, problem.q)
    for i in range(5):
        alone = minimise_arrow(
            lambda x, q, index, i=i: problem.equations(x, q, np.full(len(index), i)),
            problem.x[i : i + 1],
            problem.q[i : i + 1],
        )
        assert alone.iterations[0] == together.iterations[i]
        np.testing.assert_allclose(alone.x[0], together.x[i], rtol=0, atol=1e-9)
        np.testing.assert_allclose(alone.q[0], together.q[i], rtol=0, atol=1e-9)


def test_groups_without_influence_stay(rng):
    problem = Circles(rng, 3)

    def without_last(x, q, index):
        here = problem.equations(x, q, index)
        for part in (here.H_xq, here.H_qq, here.g_q):
            part[:, -1] = 0.0
        return here

    fit = minimise_arrow(without_last, problem.x, problem.q, max_iterations=5)
    np.testing.assert_array_equal(fit.q[:, -1], problem.q[:, -1])


def test_what_is_not_finite_at_the_start_is_said(rng):
    problem = Circles(rng, 2)
    problem.data[1, 0, 0] = np.nan
    fit = minimise_arrow(problem.equations, problem.x, problem.q)
    assert fit.stop[1] == Stop.NOT_FINITE
    assert fit.converged[0]


@pytest.mark.parametrize("shape", [(0, N), (2, 0)])
def test_nothing_to_do(shape):
    problems, n = shape
    zeros = np.zeros

    def nothing(x, q, index):
        A = len(x)
        eye = np.broadcast_to(np.eye(F), (A, F, F)).copy()
        return Equations(
            0.5 * np.square(x).sum(axis=1),
            eye,
            zeros((A, n, F, 3)),
            zeros((A, n, 3, 3)),
            x.copy(),
            zeros((A, n, 3)),
        )

    fit = minimise_arrow(nothing, np.ones((problems, F)), zeros((problems, n, 3)))
    assert fit.converged.all()
    np.testing.assert_allclose(fit.x, 0.0, atol=1e-9)
