"""The scatter of pixels: a Student t whose scale and tails are found again, and whose loss is its own."""

import numpy as np
import pytest
from scipy import stats

from vmf.estimate.noise import NEARLY_GAUSSIAN, Noise


def drawn(rng, freedom, coordinates, n=200_000, scale=2.0):
    """Squared norms of multivariate Student t residuals."""
    normal = np.square(rng.standard_normal((n, coordinates))).sum(axis=1)
    mixing = 1.0 if np.isinf(freedom) else rng.chisquare(freedom, n) / freedom
    return scale**2 * normal / mixing


@pytest.mark.parametrize("freedom", [1.5, 3.0, 10.0])
@pytest.mark.parametrize("coordinates", [2, 4, 5])
def test_scale_and_freedom_are_found_again(rng, freedom, coordinates):
    noise = Noise.of(drawn(rng, freedom, coordinates), coordinates)
    assert noise.freedom == freedom
    # The median of 200,000 draws is known to half a percent or so.
    assert noise.scale_px == pytest.approx(2.0, rel=0.02)


def test_gaussian_scatter_is_nearly_gaussian(rng):
    noise = Noise.of(drawn(rng, np.inf, 4), 4)
    assert noise.freedom == NEARLY_GAUSSIAN
    assert noise.scale_px == pytest.approx(2.0, rel=0.02)


def test_what_is_not_finite_does_not_count(rng):
    square = drawn(rng, 3.0, 4, n=1000)
    assert Noise.of(np.append(square, [np.nan, np.inf]), 4) == Noise.of(square, 4)
    assert np.isnan(Noise.of(np.full(3, np.nan), 4).scale_px)


@pytest.mark.parametrize("freedom", [1.0, 4.0, NEARLY_GAUSSIAN])
def test_loss_is_twice_the_negative_log_likelihood(rng, freedom):
    d, noise = 5, Noise(1.0, freedom)
    x = rng.normal(size=(50, d)) * 3
    square = np.square(x).sum(axis=1)
    logpdf = stats.multivariate_t(np.zeros(d), np.eye(d), df=freedom).logpdf
    loss, slope = noise.loss(square, np.full(50, float(d)))
    np.testing.assert_allclose(loss, -2 * (logpdf(x) - logpdf(np.zeros(d))), rtol=1e-9)
    up, down = (noise.loss(square + h, np.full(50, float(d)))[0] for h in (1e-5, -1e-5))
    np.testing.assert_allclose(slope, (up - down) / 2e-5, rtol=1e-6)


def test_without_tails_it_is_least_squares():
    square = np.array([0.0, 1.0, 100.0])
    loss, slope = Noise(1.0, np.inf).loss(square, np.full(3, 5.0))
    np.testing.assert_array_equal(loss, square)
    np.testing.assert_array_equal(slope, 1.0)
    np.testing.assert_array_equal(Noise(1.0, np.inf).information(np.full(3, 5.0)), 1.0)


@pytest.mark.parametrize("freedom", [3.0, NEARLY_GAUSSIAN])
def test_information_is_the_expected_square_of_the_score(rng, freedom):
    d = 4
    square = drawn(rng, freedom, d, scale=1.0)
    _, slope = Noise(1.0, freedom).loss(square, np.full(len(square), float(d)))
    # The score of one coordinate is slope · r, and coordinates are alike.
    assert Noise(1.0, freedom).information(np.array(float(d))) == pytest.approx(
        np.mean(np.square(slope) * square / d), rel=0.02
    )


def test_gaussian_residuals_are_hardly_ever_called_wrong(rng):
    square = drawn(rng, np.inf, 5, scale=1.0)
    assert Noise(1.0).wrong(square, np.full(len(square), 5.0)).mean() < 1e-4
    assert Noise(1.0).wrong(np.array([1e4]), np.array([5.0])).all()
