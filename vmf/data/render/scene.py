"""What simulated cameras look at: a surface for every target, and a background."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vmf.data.images import Image
from vmf.data.render import texture
from vmf.data.render.surface import Surface, make_surface
from vmf.data.simulate import Simulation, rig_axes
from vmf.errors import InputError
from vmf.geometry import inverse
from vmf.spec.images import RenderedImages

Floats = NDArray[np.float64]

_TILT_RAD = 0.25
_BEHIND_M = 1.5
_BACKGROUND_PX, _MOST_BACKGROUND_M = 3072, 40.0
# As far from straight ahead as a camera may look: half its field of view, and what it turns.
_HALF_VIEW_RAD, _MOST_VIEW_RAD = 0.75, 1.25
_MOST_TAGS = 50
# Of a target's distance from the cameras, and of the distance to the nearest other target as they see it.
_LARGEST, _SMALLEST, _OF_GAP = 0.15, 0.04, 0.9


@dataclass(frozen=True)
class Scene:
    """Surfaces and the points on them that are tracked.

    Attributes
    ----------
    surfaces : one a target, in the frame W of the targets.
    background : behind them, in W or (eye-to-hand) in S.
    ids, on, points : names of the tracked points, which surface each is on, and where (n, 3) in W (m).
    """

    surfaces: tuple[Surface, ...]
    background: Surface
    background_moves: bool
    ids: tuple[str, ...]
    on: NDArray[np.int64]
    points: Floats


def make_scene(rng: np.random.Generator, simulation: Simulation, images: RenderedImages) -> Scene:
    """Return the scene of a simulation.

    Raises
    ------
    InputError : more targets than there are tags, or more than one chessboard.
    """
    world, targets = simulation.world, simulation.targets_W
    n = len(targets)
    if images.targets == "tag" and n > _MOST_TAGS:
        raise InputError(f"data.simulate.targets: found {n}, with tags at most {_MOST_TAGS} are accepted")
    if images.targets == "chessboard" and n > 1:
        raise InputError(f"data.simulate.targets: found {n}, with a chessboard 1 is accepted")
    start = world.region.start
    across, down, ahead = rig_axes(world.task) @ start[:3, :3]
    sizes = np.full(n, images.size_m) if images.size_m else _sizes_m(targets, start, rig_axes(world.task))
    surfaces: list[Surface] = []
    ids: list[str] = []
    points: list[Floats] = []
    for k, target in enumerate(targets):
        tilt = Rotation.from_rotvec(
            across * rng.uniform(-1, 1) * _TILT_RAD + down * rng.uniform(-1, 1) * _TILT_RAD
        )
        picture, pixels, names = _picture(rng, images.targets, k, n)
        surface = make_surface(
            picture, target, tilt.apply(sizes[k] * across), tilt.apply(sizes[k] * down), False
        )
        surfaces.append(surface)
        ids += names
        points.append(surface.points(pixels))
    counts = [len(p) for p in points]
    background, moves = _background(rng, simulation, images.background, ahead)
    on = np.repeat(np.arange(n), counts)
    return Scene(tuple(surfaces), background, moves, tuple(ids), on, np.concatenate(points))


def _picture(rng: np.random.Generator, kind: str, k: int, n: int) -> tuple[Image, Floats, list[str]]:
    """Return a target's picture, its tracked points (m, 2) in pixels, and their names."""
    if kind == "blob":
        return *texture.blob(k / n), [str(k)]
    if kind == "tag":
        return *texture.tag(k), [f"{k}/{corner}" for corner in range(4)]
    if kind == "chessboard":
        columns, rows = texture.BOARD
        return *texture.chessboard(), [f"{r}/{c}" for r in range(rows) for c in range(columns)]
    picture = texture.random_texture(rng, texture.TILE_PX, 0, 255)
    return picture, np.full((1, 2), (texture.TILE_PX - 1) / 2), [str(k)]


def _background(
    rng: np.random.Generator, simulation: Simulation, kind: str, ahead: Floats
) -> tuple[Surface, bool]:
    """Return the background, and whether it moves with the targets' frame W past the cameras."""
    world = simulation.world
    moves = world.mounting == "eye_in_hand"
    axes = rig_axes(world.task)
    targets_S = simulation.targets_W @ world.region.start[:3, :3].T + world.region.start[:3, 3]
    depth = float((targets_S @ axes[2]).max()) + float(np.max(world.region.travel)) + _BEHIND_M
    if kind == "texture":
        picture = texture.random_texture(rng, _BACKGROUND_PX, 50, 190)
    else:
        picture = texture.plain(120)
    E = inverse(world.region.start) if moves else np.eye(4)
    R, origin = E[:3, :3], E[:3, :3] @ (depth * axes[2]) + E[:3, 3]
    view = min(_HALF_VIEW_RAD + (world.region.angle or 0.0), _MOST_VIEW_RAD) if moves else _HALF_VIEW_RAD
    reach = float(np.max(world.region.travel)) if moves else 0.0
    side = min(2.0 * (depth * np.tan(view) + reach), _MOST_BACKGROUND_M)
    across, down = side * (R @ axes[0]), side * (R @ axes[1])
    return make_surface(picture, origin, across, down, endless=True), moves


def _sizes_m(targets: Floats, start: Floats, axes: Floats) -> Floats:
    """Return sizes (n,) at which the targets do not hide each other at the start."""
    P = (targets @ start[:3, :3].T + start[:3, 3]) @ axes.T
    depth = P[:, 2]
    direction = P[:, :2] / depth[:, None]
    apart = np.linalg.norm(direction[:, None] - direction[None], axis=-1)
    apart[np.diag_indices(len(apart))] = np.inf
    gap = _OF_GAP / np.sqrt(2) * apart.min(axis=1)
    return np.asarray(np.clip(gap, _SMALLEST, _LARGEST) * depth)
