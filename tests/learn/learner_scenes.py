"""Tracks in front of the thesis's rig, learners by name, and the analytic truth, for tests of learners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.approximate import Lookup, Tiling
from vmf.data.tracks import Tracks, from_dense
from vmf.learn import CompressedPipeline, SequentialPipeline, TransportLearner

Floats = NDArray[np.float64]
EPS = np.finfo(float).eps
# Both engines and NumPy stack the same rows in other orders; QR is backward stable, a few hundred ε.
GRAM = 1e-12
IDS = ["translation", "planar", "six_dof", "pan_tilt", "pan_tilt_thesis"]
# Few and wide tiles, so that a handful of frames share some; a table large enough to keep them apart.
TILING = Tiling(4, 150.0, "diagonal", 1 << 20)


@dataclass(frozen=True)
class Scene:
    """What was simulated: tracks, and the truth behind them."""

    tracks: Tracks
    P_W: Floats
    dense: Floats


def make_scene(case, rng, frames=40, targets=2, noise=0.0, lost=0.0, reach=0.3):
    """Tracks over random poses; a share `lost` of the pixels is missing in each camera."""
    # Poses of the 8-entry form may tilt; only its centres must not (C3), and then all visited codes are.
    E = case.task.motion(case.unknowns(rng, frames, reach=reach), np.eye(4))
    P_W = case.points(rng, targets)
    moved = case.move(E, np.broadcast_to(P_W, (frames, targets, 3)))
    u = case.pixels(moved) + noise * rng.normal(size=(frames, targets, 2, 2))
    u[rng.random((frames, targets, 2)) < lost] = np.nan
    dense = u.reshape(frames, targets, 4)
    times = np.arange(frames, dtype=np.int64) * 33_333_333
    return Scene(from_dense(times, E, dense, image_size=(640, 480)), P_W, dense)


def analytic(case, scene):
    """Unit-depth parameters (N, K, 2, 3, k+1) of every target at every frame."""
    E = scene.tracks.E_S_from_W
    P = case.move(E, np.broadcast_to(scene.P_W, (len(E), *scene.P_W.shape)))
    return case.task.parameters(case.cameras.M, P[:, :, None])


def blocks(tracks, sizes):
    """The tracks in consecutive blocks of frames."""
    ends = np.cumsum(sizes)
    return [tracks.select_frames(int(end - n), int(end)) for n, end in zip(sizes, ends, strict=True)]


def compressed(task, tiling=TILING, **options):
    return CompressedPipeline(task, tiling, Lookup, **options)


def sequential(task, tiling=TILING, **options):
    return SequentialPipeline(task, tiling, Lookup, **options)


def transport(task, **options):
    return TransportLearner(task, Lookup, **options)


def stereo_codes(tracks):
    """All codes (V, 4) seen by both cameras."""
    return tracks.pixels[np.isfinite(tracks.pixels).all(axis=1)]


def predictions(rows, x_bar):
    """Errors (…, 2) in px that parameters (…, 3, k+1) predict for lifts (…, k+1)."""
    abc = (rows @ x_bar[..., None])[..., 0]
    return abc[..., :2] / abc[..., 2:]


def equilibrated_condition(R):
    """Condition number (…,) of the equations that are not rounding, columns of unit length."""
    A = R[..., :-1]
    size = np.linalg.norm(A, axis=-2, keepdims=True)
    s = np.linalg.svd(A / np.where(size > 0.0, size, 1.0), compute_uv=False)
    return np.asarray(s[..., 0] / np.where(s > 1e-7 * s[..., :1], s, np.inf).min(axis=-1))


def all_tiles(learner, tracks):
    """Every tile that holds data."""
    return learner.tiles(stereo_codes(tracks))


def least_unsafe(learner, tracks):
    """How far solutions may be apart when their Gram matrices agree to `GRAM`: κ² times that."""
    return GRAM * equilibrated_condition(learner._factors(all_tiles(learner, tracks))).max() ** 2


def assert_rows_agree(rows, expected, rtol):
    """Parameters as functions: entries weighed by the size that each can have in its row."""
    np.testing.assert_array_equal(np.isnan(rows), np.isnan(expected))
    known = np.isfinite(expected).all(axis=(1, 2, 3))
    assert known.any()
    size = np.linalg.norm(expected[known], axis=-1, keepdims=True)
    assert (np.abs(rows[known] - expected[known]) / size).max() <= rtol
