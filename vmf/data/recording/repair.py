"""Cut the ids of frozen tracks: pixels repeated exactly while the robot moves, then another point.

A tracker that re-detects may report the last pixels once more under an id it then gives to another point.
The repeated observation is false, and what follows belongs to a new target.
"""

from __future__ import annotations

from itertools import count

import numpy as np
from numpy.typing import NDArray

from vmf.data.tracks import Tracks
from vmf.geometry import motion

STILL_M = 1e-3
STILL_RAD = 1e-3
# A track that usually moves less than this many steps of the pixel grid may well repeat by chance.
GRID_STEPS = 4
GRID_PARTS = np.arange(1, 21)
# Recordings round centroids such as 1/3 px to four decimals.
ROUNDING_PX = 6e-5


def cut_frozen(tracks: Tracks, mounting: str) -> tuple[Tracks, int]:
    """Return tracks with frozen observations dropped and a new id (`12#1`) behind each, and their number.

    An observation is frozen if it repeats the one of the frame before exactly although the robot moved, and
    although the track itself moves, before and after the repetition, by more than `GRID_STEPS` steps of the
    grid its pixels lie on (coarse pixels repeat honestly).
    """
    frozen = _frozen(tracks, mounting)
    if not frozen.any():
        return tracks, 0
    cuts = np.cumsum(frozen)
    frame, target = tracks.frame[~frozen], tracks.target[~frozen]
    # Observations are sorted by target, then frame: each piece between cuts is a run of one (target, cuts).
    begins = np.ones(len(frame), bool)
    begins[1:] = (np.diff(target) != 0) | (np.diff(cuts[~frozen]) != 0)
    piece = np.cumsum(begins) - 1
    owner = target[begins]
    names = _names(owner, tracks)
    order = np.lexsort((owner, frame[begins]))  # by first appearance, as the reader numbers targets
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    by_target = np.argsort(rank[piece], kind="stable")
    return (
        Tracks(
            tracks.times_ns,
            tracks.E_S_from_W,
            frame[by_target],
            rank[piece][by_target],
            tracks.pixels[~frozen][by_target],
            tuple(names[i] for i in order),
            tracks.image_size,
        ),
        int(frozen.sum()),
    )


def _frozen(tracks: Tracks, mounting: str) -> NDArray[np.bool_]:
    """Return which observations (M,) are frozen."""
    frozen = np.zeros(len(tracks.frame), bool)
    if len(frozen) < 2 or tracks.n_frames < 2:
        return frozen
    follows = (np.diff(tracks.target) == 0) & (np.diff(tracks.frame) == 1)
    before, after = tracks.pixels[:-1], tracks.pixels[1:]
    same = ((before == after) | (np.isnan(before) & np.isnan(after))).all(axis=1)
    repeats = follows & same
    step_px = np.abs(after - before)
    step_px = np.where(np.isnan(step_px), -np.inf, step_px).max(axis=1)
    step_px = np.where(follows & np.isfinite(step_px), step_px, np.nan)
    usual_px = np.fmin(*_steps_around(step_px, repeats))
    robot_moves = _robot_moves(tracks.E_S_from_W, mounting)[tracks.frame[:-1].clip(max=tracks.n_frames - 2)]
    suspect = np.flatnonzero(repeats & robot_moves)
    moves = usual_px[suspect] > GRID_STEPS * _grid_px(after[suspect])
    frozen[1 + suspect[moves]] = True
    return frozen


def _steps_around(
    step_px: NDArray[np.float64], repeats: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return for each step (n,) the last and the next one that is no repetition, NaN if unknown."""
    n = len(repeats)
    at = np.arange(1, n + 1)
    padded = np.concatenate([[np.nan], step_px, [np.nan]])
    last = np.maximum.accumulate(np.where(repeats, 0, at))
    following = np.minimum.accumulate(np.where(repeats, n + 1, at)[::-1])[::-1]
    return padded[last], padded[following]


def _robot_moves(E_S_from_W: NDArray[np.float64], mounting: str) -> NDArray[np.bool_]:
    """Return whether the robot moves (N−1,) between one frame and the next."""
    T = E_S_from_W if mounting == "eye_to_hand" else motion.inverse(E_S_from_W)
    step = motion.inverse(T[:-1]) @ T[1:]
    travel = np.linalg.norm(step[:, :3, 3], axis=1)
    return np.asarray((travel > STILL_M) | (motion.rotation_angle(step) > STILL_RAD))


def _grid_px(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the step (n,) of the grid, 1/1 to 1/20 px, on which the finest coordinate of pixels (n, 4) lies.

    It is 0 where a coordinate lies on none. The grid belongs to the observation, not to the recording: the
    centroid of a blob of two pixels lies on halves, that of a big one practically anywhere.
    """
    cells = pixels[..., None] * GRID_PARTS
    on = np.abs(cells - np.round(cells)) / GRID_PARTS < ROUNDING_PX
    grid = np.where(on.any(axis=-1), 1.0 / GRID_PARTS[on.argmax(axis=-1)], 0.0)
    return np.asarray(np.where(np.isnan(pixels), np.inf, grid).min(axis=-1))


def _names(owner: NDArray[np.int64], tracks: Tracks) -> list[str]:
    """Name the pieces (P,) of targets: the first keeps the id, the next are `id#1`, `id#2`, never taken."""
    taken = set(tracks.ids)
    names: list[str] = []
    numbers = count(1)
    for i, target in enumerate(owner):
        name = tracks.ids[target]
        if i == 0 or owner[i - 1] != target:
            numbers = count(1)
        else:
            name = next(new for k in numbers if (new := f"{tracks.ids[target]}#{k}") not in taken)
            taken.add(name)
        names.append(name)
    return names
