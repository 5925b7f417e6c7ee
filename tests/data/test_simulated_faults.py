"""What goes wrong in simulated data on purpose: odometry that drifts, trackers that lose their target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.data.simulate import Simulation, check_drift, check_lost, simulate, trial_streams
from vmf.errors import InputError
from vmf.geometry import inverse
from vmf.spec import Spec

SIZE = np.array([640, 480])


def make_spec(task: str = "planar", noise: Mapping[str, float] | None = None, **source: Any) -> Spec:
    data = {"simulate": {"frames": 60, **source}}
    return Spec.model_validate({"task": task, "data": data, "noise": noise or {}})


def run(spec: Spec) -> Simulation:
    return simulate(spec, trial_streams(spec, 0)[0])


def pixels(s: Simulation) -> np.ndarray:
    """Pixels (N, K, 4) as observed, NaN where a target was not."""
    out = np.full(s.clean.shape, np.nan)
    out[s.tracks.frame, s.tracks.target] = s.tracks.pixels
    return out


def steps(E: np.ndarray) -> np.ndarray:
    T = inverse(E)
    return inverse(T[:-1]) @ T[1:]


@pytest.mark.parametrize("task", ["planar", "translation", "six_dof"])
def test_each_step_of_odometry_is_off_by_the_root_of_its_length(task: str) -> None:
    """Deviations of n errors over their scale scatter by 1/√(2n); four of those."""
    drift = {"drift_m_per_sqrt_m": 0.02}
    if task != "translation":
        drift["drift_rad_per_sqrt_m"] = 0.03
    s = run(make_spec(task, drift, frames=600))
    true, measured = steps(s.E_true), steps(s.tracks.E_S_from_W)
    error = inverse(true) @ measured
    root = np.sqrt(np.linalg.norm(true[:, :3, 3], axis=1))
    n = len(root)
    moved = error[:, :3, 3] / root[:, None]
    # Small rotations: the entries below the diagonal are the rotation vector to second order.
    turned = np.stack([error[:, 2, 1], error[:, 0, 2], error[:, 1, 0]], axis=1) / root[:, None]
    free_m = {"planar": [0, 1]}.get(task, [0, 1, 2])
    free_rad = {"planar": [2], "translation": []}.get(task, [0, 1, 2])
    for k in range(3):
        expected = 0.02 * (k in free_m)
        assert abs(moved[:, k].std() - expected) <= 4 * expected / np.sqrt(2 * n) + 1e-12
        # 0.03 rad over a metre or two: the second order is a thousandth.
        expected = 0.03 * (k in free_rad)
        assert abs(turned[:, k].std() - expected) <= (4 / np.sqrt(2 * n) + 2e-3) * expected + 1e-12
    # It begins where the robot is.
    np.testing.assert_allclose(s.tracks.E_S_from_W[0], s.E_true[0], rtol=0, atol=1e-12)


def test_drift_changes_what_the_robot_says_and_not_what_it_does_or_sees() -> None:
    still, drifts = run(make_spec()), run(make_spec(noise={"drift_m_per_sqrt_m": 0.1}))
    np.testing.assert_array_equal(still.E_true, drifts.E_true)
    np.testing.assert_array_equal(still.tracks.pixels, drifts.tracks.pixels)
    assert np.abs(still.tracks.E_S_from_W - drifts.tracks.E_S_from_W).max() > 0.05
    again = run(make_spec(noise={"drift_m_per_sqrt_m": 0.1}))
    np.testing.assert_array_equal(again.tracks.E_S_from_W, drifts.tracks.E_S_from_W)


@pytest.mark.parametrize(
    ("task", "noise", "said"),
    [
        ("pan_tilt", {"drift_m_per_sqrt_m": 0.1}, "does not travel"),
        ("translation", {"drift_rad_per_sqrt_m": 0.1}, "does not turn"),
    ],
)
def test_what_does_not_move_does_not_drift(task: str, noise: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_drift(make_spec(task, noise))


@given(
    target=st.integers(0, 1),
    camera=st.sampled_from(["left", "right", "both"]),
    first=st.integers(1, 58),
    frames=st.integers(1, 80),
    shows=st.sampled_from(["nothing", "edge"]),
)
def test_a_lost_tracker_loses_what_is_said_and_nothing_else(
    target: int, camera: str, first: int, frames: int, shows: str
) -> None:
    lost = {"target": target, "camera": camera, "from_frame": first, "frames": frames, "shows": shows}
    whole, holed = pixels(run(make_spec())), pixels(run(make_spec(lost=[lost])))
    columns = {"left": [0, 1], "right": [2, 3], "both": [0, 1, 2, 3]}[camera]
    gone = np.zeros(whole.shape, bool)
    gone[first : first + frames, target, columns] = True
    np.testing.assert_array_equal(holed[~gone], whole[~gone])
    if shows == "nothing":
        assert np.isnan(holed[gone]).all()
        return
    for left in range(0, len(columns), 2):
        stuck = holed[first : first + frames, target, columns[left] : columns[left] + 2]
        was = whole[first, target, columns[left] : columns[left] + 2]
        assert (stuck == stuck[0]).all()
        # One coordinate is as it was, the other at the nearer border; noise may have put it beyond.
        moved = stuck[0] != was
        assert moved.sum() == 1
        assert stuck[0][moved] in (0.0, (SIZE - 1)[moved])
        to_border = np.minimum(was, SIZE - 1 - was)
        assert to_border[moved] == to_border.min()


@pytest.mark.parametrize(
    ("lost", "said"),
    [
        ({"target": 2, "from_frame": 3, "frames": 1}, "found target 2, 0 to 1"),
        ({"target": 0, "from_frame": 60, "frames": 1}, "found from_frame 60, 1 to 59"),
    ],
)
def test_a_tracker_that_is_not_there_loses_nothing(lost: dict[str, int], said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_lost(make_spec(lost=[lost]))


def test_pixels_without_noise_come_beside_those_observed() -> None:
    s = run(make_spec("six_dof", lost=[{"target": 1, "from_frame": 5, "frames": 3}]))
    exact = s.clean[s.tracks.frame, s.tracks.target]
    np.testing.assert_array_equal(s.tracks.exact, exact)
    part = s.tracks.select(np.array([2, 6, 7]))
    assert part.exact is not None
    np.testing.assert_array_equal(part.exact, s.clean[[2, 6, 7]][part.frame, part.target])


def test_a_tool_starts_where_it_is_said() -> None:
    where = {"tool_start_m": (0.1, -0.1, 1.2), "travel_m": (0.1, 0.1, 0.1)}
    spec = Spec.model_validate(
        {
            "task": "translation",
            "mounting": "eye_to_hand",
            "data": {"simulate": {"frames": 40, "targets": 1, "workspace": where}},
        }
    )
    s = run(spec)
    np.testing.assert_allclose(s.E_true[0, :3, 3], where["tool_start_m"], rtol=0, atol=1e-12)
    assert (np.abs(s.E_true[:, :3, 3] - where["tool_start_m"]) <= 0.1 + 1e-12).all()
    with pytest.raises(InputError, match="tool_start_m"):
        run(make_spec(workspace={"tool_start_m": (0.0, 0.0, 1.0)}))
