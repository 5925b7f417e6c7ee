"""Where simulated targets and poses lie: each task's workspace, and draws from it that both cameras see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from vmf.errors import InputError
from vmf.geometry import StereoCameras, from_rotation_translation, in_view, stereo_code
from vmf.spec.model import Workspace
from vmf.tasks import Task

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]

# Candidates drawn at once, and how many may fail in a row before a workspace counts as blind.
_BATCH = 4096
_MAX_BATCHES = 4000
# A hand changes its mind about this often.
_WAYPOINT_S = 1.5


@dataclass(frozen=True)
class Region:
    """A workspace with nothing left out.

    Attributes
    ----------
    low, high : corners of the target box in W (m).
    start : (4, 4) pose `E_S_from_W` at the start.
    travel : half-widths of the box in which S (eye-in-hand) or the tool (eye-to-hand) moves (m).
    angle : largest angle of each of the task's rotations (rad), None for any rotation.
    eye_to_hand : whether poses are the tool's in front of fixed cameras, not the cameras' own.
    """

    low: Vector
    high: Vector
    start: Floats
    travel: Vector
    angle: float | None
    eye_to_hand: bool


# Eye-in-hand targets about 2 m in front; S has x right, y down, z forward, or x forward, y left, z up.
_TARGETS: dict[str, tuple[Vector, Vector]] = {
    "six_dof": ((-0.5, -0.5, 1.5), (0.5, 0.5, 2.5)),
    "translation": ((-0.5, -0.5, 1.5), (0.5, 0.5, 2.5)),
    "planar": ((1.5, -0.5, -0.4), (2.5, 0.5, 0.4)),
    "pan_tilt": ((1.5, -0.3, -0.3), (2.5, 0.3, 0.3)),
}
_TRAVEL: dict[str, Vector] = {
    "six_dof": (1.0, 1.0, 1.0),
    "translation": (1.0, 1.0, 1.0),
    "planar": (1.0, 1.0, 0.0),
    "pan_tilt": (0.0, 0.0, 0.0),
}
_ANGLE: dict[str, float | None] = {"six_dof": None, "translation": 0.0, "planar": 0.5, "pan_tilt": 0.6}
# Eye-to-hand: the tool starts 2 m in front of the cameras and its targets are near its origin.
_TOOL_START = (0.0, 0.0, 2.0)
_TOOL_BOX: tuple[Vector, Vector] = ((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1))
_TOOL_TRAVEL: Vector = (0.3, 0.4, 0.3)
TARGETS: dict[str, int] = {"pan_tilt": 1, "translation": 2, "planar": 2, "six_dof": 6}


def region(task: Task, mounting: str, motion: str, workspace: Workspace) -> Region:
    """Return the region a spec means, with the task's defaults for what it leaves out.

    Raises
    ------
    InputError : the mounting makes no sense for the task, or the target box is empty.
    """
    start = np.eye(4)
    low, high = _TARGETS[task.name]
    travel, angle = _TRAVEL[task.name], _ANGLE[task.name]
    if mounting == "eye_to_hand":
        if task.name in ("pan_tilt", "planar"):
            raise InputError(f"mounting: {task.name} moves the cameras, eye_in_hand is accepted")
        start[:3, 3] = workspace.tool_start_m or _TOOL_START
        (low, high), travel = _TOOL_BOX, _TOOL_TRAVEL
    elif workspace.tool_start_m is not None:
        raise InputError(
            "data.simulate.workspace.tool_start_m: there is a tool eye_to_hand alone, null is accepted"
        )
    if task.name == "six_dof" and (motion == "hand_guided" or mounting == "eye_to_hand"):
        angle = 0.6
    low = workspace.target_low_m or low
    high = workspace.target_high_m or high
    if any(a > b for a, b in zip(low, high, strict=True)):
        raise InputError(f"data.simulate.workspace: target_low_m {low} lies above target_high_m {high}")
    return Region(
        low,
        high,
        start,
        workspace.travel_m or travel,
        workspace.angle_rad or angle,
        mounting == "eye_to_hand",
    )


def draw_targets(rng: np.random.Generator, where: Region, shape: tuple[int, ...]) -> Floats:
    """Return targets (*shape, 3) in W, uniform in the box."""
    return rng.uniform(where.low, where.high, (*shape, 3))


def draw_poses(rng: np.random.Generator, task: Task, where: Region, n: int) -> Floats:
    """Return poses (n, 4, 4) drawn uniformly from the workspace, seen or not."""
    t = rng.uniform(-1.0, 1.0, (n, 3)) * where.travel
    if task.name == "pan_tilt":
        angles = rng.uniform(-1.0, 1.0, (n, 2)) * (where.angle or 0.0)
        return task.world().motion(angles, where.start)
    if task.name == "planar":
        angle = rng.uniform(-1.0, 1.0, (n, 1)) * (where.angle or 0.0)
        R = Rotation.from_euler("z", angle).as_matrix()
    elif task.name == "translation":
        R = np.broadcast_to(np.eye(3), (n, 3, 3))
    elif where.angle is None:
        R = Rotation.random(n, rng=rng).as_matrix()
    else:
        angles = rng.uniform(-1.0, 1.0, (n, 3)) * where.angle
        R = Rotation.from_euler("ZYX", angles).as_matrix()
    return _about_start(R, t, where)


def _about_start(R: Floats, position: Floats, where: Region) -> Floats:
    """Poses with rotation R whose origin has moved by `position` from the start.

    Eye-in-hand: S is at `position` in W, so E = [R | −R position]. Eye-to-hand: the tool is.
    """
    if where.eye_to_hand:
        return from_rotation_translation(R, where.start[:3, 3] + position)
    return from_rotation_translation(R, -(R @ position[..., None])[..., 0])


def codes(cameras: StereoCameras, E: Floats, P_W: Floats) -> tuple[Floats, Floats]:
    """Return codes (…, K, 4) and depths (…, K, 2) of targets (…, K, 3) of W seen from poses (…, 4, 4)."""
    return stereo_code(cameras, in_S(E, P_W))


def in_S(E: Floats, P_W: Floats) -> Floats:
    """Return targets (…, K, 3) of W in the frames S of poses `E_S_from_W` (…, 4, 4)."""
    return np.asarray(np.einsum("...ij,...kj->...ki", E[..., :3, :3], P_W) + E[..., None, :3, 3])


def sees(cameras: StereoCameras, size: tuple[int, int], E: Floats, P_W: Floats) -> NDArray[np.bool_]:
    """Tell which poses (…, 4, 4) show every one of the targets (…, K, 3) in both images."""
    return np.asarray(in_view(*codes(cameras, E, P_W), size).all(axis=-1))


def visible_poses(
    rng: np.random.Generator,
    task: Task,
    where: Region,
    cameras: StereoCameras,
    size: tuple[int, int],
    P_W: Floats,
    n: int,
) -> Floats:
    """Return n random poses (n, 4, 4) that show all targets (K, 3) in both cameras.

    Raises
    ------
    InputError : the workspace hardly ever shows all targets.
    """
    found: list[Floats] = []
    count = 0
    for _ in range(_MAX_BATCHES):
        E = draw_poses(rng, task, where, _BATCH)
        # Most candidates already lose the first target.
        E = E[sees(cameras, size, E, P_W[:1])]
        E = E[sees(cameras, size, E, P_W)]
        found.append(E)
        count += len(E)
        if count >= n:
            return np.concatenate(found)[:n]
    raise InputError(
        f"data.simulate.workspace: only {count} of {_MAX_BATCHES * _BATCH} poses show all {len(P_W)} targets "
        "in both cameras; bring the targets nearer together or farther away, or lessen travel_m and angle_rad"
    )


def hand_guided_poses(
    rng: np.random.Generator,
    task: Task,
    where: Region,
    cameras: StereoCameras,
    size: tuple[int, int],
    P_W: Floats,
    n: int,
    rate_hz: float,
) -> tuple[Floats, Floats]:
    """Return n poses (n, 4, 4) of a smooth motion, and their times (n,) in s.

    The motion is a spline through random poses biased to the start, as when a person moves an arm by hand
    and keeps the targets in the middle of the images. Frames that lose a target do not count.
    """
    way = where.start[None]
    more = int(np.ceil(n / rate_hz / _WAYPOINT_S)) + 1
    for _ in range(_MAX_BATCHES):
        # One spline through all way points so far: a longer one is drawn anew, for pieces would not join.
        way = np.concatenate([way, visible_poses(rng, task, where, cameras, size, P_W, more)])
        knots: Floats = _WAYPOINT_S * np.arange(len(way), dtype=float)
        t = np.arange(0.0, knots[-1], 1.0 / rate_hz)
        E = _spline(task, where, knots, way, t)
        seen = sees(cameras, size, E, P_W)
        if seen.sum() >= n:
            return E[seen][:n], t[seen][:n]
        more = len(way)
    raise InputError("data.simulate.workspace: a smooth motion hardly ever shows all targets")


def _spline(task: Task, where: Region, knots: Floats, E: Floats, t: Floats) -> Floats:
    if task.name == "pan_tilt":
        p = task.world().coordinates(E, where.start)
        return task.world().motion(CubicSpline(knots, p)(t), where.start)
    translation = CubicSpline(knots, E[:, :3, 3])(t)
    R = RotationSpline(knots, Rotation.from_matrix(E[:, :3, :3]))(t).as_matrix()
    return from_rotation_translation(R, translation)
