"""A serial arm against the product of its links, and its lifts against what they have to hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vmf.spec.studies import JointSpaceStudy, KinematicsError, Link
from vmf.study.arm import Arm, JointLift, KinematicLift, TrigonometricLift

LINKS = JointSpaceStudy().links
Floats = NDArray[np.float64]

lengths = st.floats(-1.0, 1.0)
links = st.lists(
    st.builds(Link, d_m=lengths, a_m=lengths, alpha_deg=st.floats(-170.0, 170.0)), min_size=1, max_size=3
)


def denavit_hartenberg(link: Link, q: float) -> Floats:
    """The textbook matrix, entry by entry."""
    ca, sa = np.cos(np.radians(link.alpha_deg)), np.sin(np.radians(link.alpha_deg))
    c, s = np.cos(q), np.sin(q)
    return np.array(
        [
            [c, -s * ca, s * sa, link.a_m * c],
            [s, c * ca, -c * sa, link.a_m * s],
            [0.0, sa, ca, link.d_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


@given(links, st.integers(0, 1000))
def test_poses_are_the_inverse_of_the_links_product(links: list[Link], seed: int) -> None:
    q = np.random.default_rng(seed).uniform(-3, 3, (4, len(links)))
    found = Arm(links).E_S_from_W(q)
    for angles, E in zip(q, found, strict=True):
        W_T_S = np.eye(4)
        for link, angle in zip(links, angles, strict=True):
            W_T_S = W_T_S @ denavit_hartenberg(link, angle)
        np.testing.assert_allclose(E, np.linalg.inv(W_T_S), atol=1e-12)


@pytest.mark.parametrize(
    "lift", [TrigonometricLift(3), KinematicLift(Arm(LINKS), (0.3, -1.3, 0.2))], ids=["joints", "kinematics"]
)
def test_jacobians_are_finite_differences_and_constants_stay(
    lift: JointLift, rng: np.random.Generator
) -> None:
    delta, h = rng.uniform(-1, 1, (5, 3)), 1e-6
    J = lift.jacobian(delta)
    assert J.shape == (5, lift.size, 3)
    for joint in range(3):
        step = h * np.eye(3)[joint]
        difference = (lift.lift(delta + step) - lift.lift(delta - step)) / (2 * h)
        # Central differences are off by h² times a third derivative of order 1, and by rounding over h.
        np.testing.assert_allclose(J[..., joint], difference, atol=1e-9)
    assert (lift.lift(delta)[:, -1] == 1.0).all()


@given(links, st.integers(0, 1000))
def test_what_a_camera_sees_is_linear_in_the_lift_over_joints(links: list[Link], seed: int) -> None:
    """Whatever the links are: rows of M E(home + Δ) P are combinations of the products."""
    rng = np.random.default_rng(seed)
    n = len(links)
    M, P = rng.standard_normal((3, 4)), np.append(rng.standard_normal(3), 1.0)
    home, delta = rng.uniform(-3, 3, n), rng.uniform(-3, 3, (4 * 3**n, n))
    seen = Arm(links).E_S_from_W(home + delta) @ P @ M.T
    x_bar = TrigonometricLift(n).lift(delta)
    assert x_bar.shape[1] == 3**n
    coefficients = np.linalg.lstsq(x_bar, seen, rcond=None)[0]
    np.testing.assert_allclose(x_bar @ coefficients, seen, atol=1e-9 * max(1.0, np.abs(seen).max()))


def test_unknowns_are_three_rows_less_a_scale() -> None:
    assert [TrigonometricLift(n).unknowns for n in (1, 2, 3, 6)] == [8, 26, 80, 2186]
    assert KinematicLift(Arm(LINKS), (0.0, 0.0, 0.0)).unknowns == 38


def test_errors_of_the_kinematics_are_where_they_are_said_to_be() -> None:
    q = np.array([0.1, -0.2, 0.3])
    right = Arm(LINKS)
    tool = Arm(LINKS, KinematicsError(name="tool", tool_m=0.1))
    moved = np.linalg.inv(right.E_S_from_W(q)) @ np.array([0.1, 0.1, 0.1, 1.0])
    np.testing.assert_allclose(tool.E_S_from_W(q) @ moved, [0, 0, 0, 1], atol=1e-12)
    zero = Arm(LINKS, KinematicsError(name="zero", zero_rad=0.1))
    np.testing.assert_allclose(
        zero.E_S_from_W(q), right.E_S_from_W(q + np.array([0.1, -0.1, 0.1])), atol=1e-12
    )
    off = (0.05, -0.05, 0.05)
    longer = [
        Link(d_m=link.d_m + by, a_m=link.a_m + by, alpha_deg=link.alpha_deg)
        for link, by in zip(LINKS, off, strict=True)
    ]
    length = Arm(LINKS, KinematicsError(name="length", length_m=0.05))
    np.testing.assert_allclose(length.E_S_from_W(q), Arm(longer).E_S_from_W(q), atol=1e-12)
