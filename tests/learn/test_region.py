"""The region of trained codes: what lies inside, how far outside is, and what does not count as trained."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, minimize

from vmf.learn import Region

Floats = np.ndarray
WIDTH, HEIGHT = 640.0, 480.0


def codes_of_a_rig(n: int, seed: int = 0, noise_px: float = 0.0) -> Floats:
    """Codes of a parallel rig: left pixel anywhere, disparity 20…80 px."""
    random = np.random.default_rng(seed)
    x, y, disparity = random.uniform([100, 0, 20], [WIDTH, HEIGHT, 80], (n, 3)).T
    return np.stack([x, y, x - disparity, y], axis=1) + noise_px * random.standard_normal((n, 4))


def nearest_by_quadratic_programming(region: Region, code: Floats) -> float:
    """The distance to the polytope by a general solver, from a point that is inside."""
    A, b = region.normals, region.offsets
    slack = linprog(
        [0, 0, 0, 0, -1], A_ub=np.column_stack([A, np.ones(len(A))]), b_ub=b, bounds=[(None, None)] * 5
    )
    assert slack.status == 0
    done = minimize(
        lambda x: float(np.sum((x - code) ** 2)),
        slack.x[:4],
        jac=lambda x: 2 * (x - code),
        constraints={"type": "ineq", "fun": lambda x: b - A @ x, "jac": lambda x: -A},
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 500},
    )
    # 8: no better point along the search direction, which is where a minimum to the last digit ends.
    assert done.status in (0, 8), done.message
    assert (A @ done.x <= b + 1e-6).all()
    return float(np.sqrt(done.fun))


@pytest.mark.parametrize("noise_px", [0.0, 3.0])
def test_trained_codes_and_what_lies_between_them_are_inside(noise_px: float) -> None:
    codes = codes_of_a_rig(500, noise_px=noise_px)
    region = Region.of(codes, noise_px)
    np.testing.assert_array_equal(region.outside_px(codes), 0.0)
    random = np.random.default_rng(1)
    between = random.dirichlet(np.ones(500), 200) @ codes
    np.testing.assert_array_equal(region.outside_px(between), 0.0)


def test_the_normals_have_unit_length_so_that_offsets_are_px() -> None:
    region = Region.of(codes_of_a_rig(500, noise_px=1.0), 1.0)
    np.testing.assert_allclose(np.linalg.norm(region.normals, axis=1), 1.0, rtol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 400.0))
def test_the_distance_is_that_to_the_nearest_code_of_the_region(seed: int, far: float) -> None:
    region = Region.of(codes_of_a_rig(60, noise_px=1.0), 1.0)
    random = np.random.default_rng(seed)
    direction = random.standard_normal(4)
    code = np.array([370.0, 240.0, 320.0, 240.0]) + far * direction / np.linalg.norm(direction)
    found = region.outside_px(code[None])[0]
    # SLSQP ends within the square root of its tolerance on the squared distance.
    assert found == pytest.approx(nearest_by_quadratic_programming(region, code), abs=1e-4)


def test_one_px_farther_along_a_facet_is_one_px_more() -> None:
    region = Region.of(codes_of_a_rig(2000), None)
    low = np.array([[-100.0, 240.0, -150.0, 240.0], [-101.0, 240.0, -151.0, 240.0]])
    here, there = region.outside_px(low)
    # Both pixels move by 1 px, along a facet that is nearly x_L = 100.
    assert 0.0 < there - here <= np.sqrt(2)
    assert here > 150.0


def test_a_code_in_the_middle_with_a_disparity_never_seen_is_outside() -> None:
    region = Region.of(codes_of_a_rig(2000, noise_px=0.5), 0.5)
    nearer = np.array([[370.0, 240.0, 370.0 - 180.0, 240.0]])
    # 100 px more disparity than ever seen are 100/√2 px in stereo space.
    assert region.outside_px(nearer)[0] == pytest.approx(100 / np.sqrt(2), abs=15)


def test_a_code_off_the_epipolar_line_is_outside() -> None:
    region = Region.of(codes_of_a_rig(2000, noise_px=0.5), 0.5)
    wrong = np.array([[370.0, 240.0, 320.0, 300.0]])
    # Less three σ of the asked code, and four of the trained ones.
    assert region.outside_px(wrong)[0] == pytest.approx(60 / np.sqrt(2) - 7 * 0.5, abs=1.0)


def test_noise_widens_the_region() -> None:
    codes = codes_of_a_rig(500)
    outside = np.array([[-100.0, 240.0, -150.0, 240.0]])
    by_noise = [Region.of(codes, noise).outside_px(outside)[0] for noise in (0.0, 1.0, 10.0)]
    assert by_noise[0] > by_noise[1] > by_noise[2] > 0.0


@pytest.mark.parametrize("shift", [0.0, 1e4])
def test_where_the_images_origin_is_does_not_matter(shift: float) -> None:
    codes = codes_of_a_rig(300, noise_px=1.0)
    asked = np.random.default_rng(2).uniform(-200, 800, (50, 4))
    expected = Region.of(codes, 1.0).outside_px(asked)
    np.testing.assert_allclose(
        Region.of(codes + shift, 1.0).outside_px(asked + shift), expected, atol=1e-6 * max(shift, 1.0)
    )


def test_codes_not_fully_seen_do_not_train() -> None:
    codes = codes_of_a_rig(200)
    blind = codes.copy()
    blind[:, 2:] = np.nan
    region = Region.of(codes)
    both = Region.of(np.concatenate([codes, blind]))
    np.testing.assert_array_equal(both.offsets, region.offsets)
    with pytest.raises(ValueError, match="no code was seen by both cameras"):
        Region.of(blind)
    with pytest.raises(ValueError, match="no code was seen by both cameras"):
        Region.of(np.zeros((0, 4)))


FEW = {
    "one": np.array([[300.0, 200.0, 250.0, 200.0]]),
    "one, often": np.tile([300.0, 200.0, 250.0, 200.0], (30, 1)),
    "two": np.array([[300.0, 200.0, 250.0, 200.0], [340.0, 260.0, 280.0, 260.0]]),
    "a line": np.linspace([300.0, 200.0, 250.0, 200.0], [340.0, 260.0, 280.0, 260.0], 25),
    "a plane": codes_of_a_rig(60) * [1, 1, 0, 1] + codes_of_a_rig(60)[:, [0]] * [0, 0, 1, 0],
    "corners of a plane": np.array([[0, 0, 0, 0], [9, 0, 9, 0], [0, 9, 0, 9], [9, 9, 9, 9.0]]),
    "five": codes_of_a_rig(5),
}


@pytest.mark.parametrize("name", FEW)
def test_few_or_flat_codes_still_make_a_region(name: str) -> None:
    codes = FEW[name]
    region = Region.of(codes)
    np.testing.assert_array_equal(region.outside_px(codes), 0.0)
    np.testing.assert_array_equal(region.outside_px(codes.mean(axis=0, keepdims=True)), 0.0)
    far = codes.mean(axis=0) + np.array([[1e3, 0, 0, 0], [0, 1e3, 0, 0], [0, 0, 1e3, 0], [0, 0, 0, -1e3]])
    assert (region.outside_px(far) > 100.0).all()


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_wrong_correspondences_do_not_widen_the_region_much(share: float) -> None:
    """Random matches would make the whole image trained; what is left of them is near the true codes."""
    random = np.random.default_rng(3)
    sound = codes_of_a_rig(3000, noise_px=1.0) * [0.5, 0.5, 0.5, 0.5] + [100, 100, 100, 100]
    wrong = random.uniform([0, 0, 0, 0], [WIDTH, HEIGHT, WIDTH, HEIGHT], (round(share * 3000), 4))
    region = Region.of(np.concatenate([sound, wrong]), 1.0)
    clean = Region.of(sound, 1.0)
    assert (clean.outside_px(wrong) > 0.0).mean() > 0.95
    # Codes of the same rig 100 px beyond the true ones, on all sides.
    corners = np.array([[0.0, 0.0], [0.0, 440.0], [540.0, 0.0], [540.0, 440.0]])
    beyond = np.column_stack([corners, corners - [25.0, 0.0]])
    expected = clean.outside_px(beyond)
    assert (expected > 50.0).all()
    assert (region.outside_px(beyond) > 0.4 * expected).all()
    # What was sound is as good as never lost.
    assert (region.outside_px(sound) > 0.0).mean() < 0.005


def test_a_code_of_one_camera_is_as_far_outside_as_it_must_be() -> None:
    codes = codes_of_a_rig(500)
    region = Region.of(codes)
    seen_left, seen_right = codes[:40].copy(), codes[:40].copy()
    seen_left[:, 2:] = np.nan
    seen_right[:, :2] = np.nan
    np.testing.assert_allclose(region.outside_px(np.concatenate([seen_left, seen_right])), 0.0, atol=1e-6)
    away = seen_left + np.array([5000.0, 0.0, 0.0, 0.0])
    found = region.outside_px(away)
    # No code lies to the right of the image; the rest is in how far from its edge these were.
    np.testing.assert_allclose(found, away[:, 0] - codes[:, 0].max(), atol=30.0)
    assert np.isnan(region.outside_px(np.full((1, 4), np.nan))).all()
