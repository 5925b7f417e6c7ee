"""A mobile base: its poses in the plane, odometry that drifts, and a controller that parks it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from vmf.data.simulate import drifted
from vmf.geometry import inverse
from vmf.spec.model import Noise

Floats = NDArray[np.float64]

_STEP_S = 0.05
_MOST_STEPS = 6000
# Of the controller, in 1/s, and the base's own limits.
_NEAR, _TURN, _APPROACH = 0.6, 2.0, 1.0
_MOST_M_S, _MOST_RAD_S = 0.5, 1.0


@dataclass(frozen=True)
class Parking:
    """How a base has driven to where it should be.

    Attributes
    ----------
    true : (N, 4, 4) poses `W_T_S`.
    odometry : (N, 4, 4) the same as the base believes.
    stopped : whether odometry came near enough to the goal.
    """

    true: Floats
    odometry: Floats
    stopped: bool


def planar_pose(x_m: ArrayLike, y_m: ArrayLike, heading_rad: ArrayLike) -> Floats:
    """Return poses `W_T_S` (…, 4, 4) in the plane."""
    x, y, heading = np.broadcast_arrays(*(np.asarray(v, float) for v in (x_m, y_m, heading_rad)))
    T = np.zeros((*x.shape, 4, 4))
    T[..., 0, 0] = T[..., 1, 1] = np.cos(heading)
    T[..., 1, 0] = np.sin(heading)
    T[..., 0, 1] = -T[..., 1, 0]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    T[..., 0, 3], T[..., 1, 3] = x, y
    return T


def in_plane(T: Floats) -> Floats:
    """Return x, y (m) and heading (rad) of poses (…, 4, 4), as (…, 3)."""
    return np.stack([T[..., 0, 3], T[..., 1, 3], np.arctan2(T[..., 1, 0], T[..., 0, 0])], axis=-1)


def wander(
    rng: np.random.Generator, reach: tuple[float, float, float], frames: int, frames_per_leg: int
) -> Floats:
    """Return poses (N, 4, 4) of a smooth tour through random places.

    Parameters
    ----------
    reach : largest |x| and |y| (m) and |heading| (rad) of the places.
    frames : N.
    frames_per_leg : between two places.
    """
    places = rng.uniform(-1.0, 1.0, (frames // frames_per_leg + 2, 3)) * np.array(reach)
    way = CubicSpline(frames_per_leg * np.arange(len(places)), places)(np.arange(frames))
    return planar_pose(*np.clip(way, -np.array(reach), reach).T)


def park(
    rng: np.random.Generator,
    start: Floats,
    goal: Floats,
    noise: Noise,
    stop_m: float,
    stop_rad: float,
) -> Parking:
    """Drive from `start` (4, 4) to where odometry says that `goal` (4, 4) is reached, and stop there.

    The law is that of Aicardi et al. (1995) for a base that cannot move sideways; its distance and its two
    angles to the goal go to zero together.
    """
    true, believed = [start], [start]
    for _ in range(_MOST_STEPS):
        x, y, heading = in_plane(inverse(goal) @ believed[-1]).tolist()
        distance = float(np.hypot(x, y))
        if distance <= stop_m and abs(heading) <= stop_rad:
            return Parking(np.array(true), np.array(believed), True)
        speed, rate = _velocities(x, y, heading)
        if distance <= stop_m:
            speed, rate = 0.0, float(np.clip(-_TURN * heading, -_MOST_RAD_S, _MOST_RAD_S))
        step = planar_pose(speed * _STEP_S, 0.0, rate * _STEP_S)
        true.append(true[-1] @ step)
        # What the wheels report of a step is off by a little.
        measured = drifted(rng, "planar", np.stack([np.eye(4), step]), noise)[1] if noise.drifts else step
        believed.append(believed[-1] @ measured)
    return Parking(np.array(true), np.array(believed), False)


def _velocities(x: float, y: float, heading: float) -> tuple[float, float]:
    """Return forward speed (m/s) and turning rate (rad/s) towards the origin with heading zero."""
    distance = float(np.hypot(x, y))
    to_goal = _wrapped(np.arctan2(y, x) - heading + np.pi)
    on_arrival = _wrapped(to_goal + heading)
    speed = _NEAR * distance * np.cos(to_goal)
    # sin γ cos γ / γ, which is 1 at zero.
    gain = float(np.sinc(2.0 * to_goal / np.pi))
    rate = _TURN * to_goal + _NEAR * gain * (to_goal + _APPROACH * on_arrival)
    # Both slowed down alike, the path stays what it is.
    slow = max(1.0, abs(speed) / _MOST_M_S, abs(rate) / _MOST_RAD_S)
    return float(speed / slow), float(rate / slow)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
