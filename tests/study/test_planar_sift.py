"""A base that parks by odometry: where it stops, how it may move, and what its features are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.errors import InputError
from vmf.geometry import inverse
from vmf.spec.model import Noise
from vmf.spec.studies import PlanarSiftStudy
from vmf.study.mobile_base import in_plane, park, planar_pose, wander
from vmf.study.planar_sift import planar_sift, snapshot, train

STILL = Noise(pixel_px=0.0)
SMALL = PlanarSiftStudy(frames=25, posters=8, runs=1, looks=2)
places = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3))


@given(places, places)
def test_poses_in_the_plane_are_a_group(a: tuple[float, ...], b: tuple[float, ...]) -> None:
    T = planar_pose(*a) @ planar_pose(*b)
    x, y, heading = in_plane(T)
    np.testing.assert_allclose(planar_pose(x, y, heading), T, rtol=0, atol=1e-14)
    np.testing.assert_allclose(in_plane(planar_pose(*a)), a, rtol=0, atol=1e-14)


@given(places, places)
def test_without_drift_it_stops_where_it_was_told_and_never_moves_sideways(
    start: tuple[float, ...], goal: tuple[float, ...]
) -> None:
    way = park(np.random.default_rng(0), planar_pose(*start), planar_pose(*goal), STILL, 0.025, 0.02)
    assert way.stopped
    np.testing.assert_array_equal(way.true, way.odometry)
    x, y, heading = in_plane(inverse(planar_pose(*goal)) @ way.true[-1])
    assert np.hypot(x, y) <= 0.025
    assert abs(heading) <= 0.02
    steps = inverse(way.true[:-1]) @ way.true[1:]
    assert np.abs(steps[:, 1, 3]).max(initial=0.0) < 1e-12


def test_drift_takes_the_base_elsewhere_and_odometry_does_not_see_it() -> None:
    noise = Noise(pixel_px=0.0, drift_m_per_sqrt_m=0.05, drift_rad_per_sqrt_m=0.05)
    start, goal = planar_pose(0.0, 0.0, 0.0), planar_pose(-0.5, -1.5, 0.0)
    ways = [park(np.random.default_rng(k), start, goal, noise, 0.025, 0.025) for k in range(40)]
    assert all(way.stopped for way in ways)
    believed = np.array([in_plane(inverse(goal) @ way.odometry[-1]) for way in ways])
    assert np.hypot(believed[:, 0], believed[:, 1]).max() <= 0.025
    true = np.array([in_plane(inverse(goal) @ way.true[-1]) for way in ways])
    length = np.mean([np.linalg.norm(np.diff(w.true[:, :2, 3], axis=0), axis=1).sum() for w in ways])
    # The heading of a walk of so many metres; a deviation of 40 values is known to 11 %.
    expected = 0.05 * np.sqrt(length)
    assert true[:, 2].std() == pytest.approx(expected, rel=4 / np.sqrt(80))


def test_a_tour_stays_in_its_area() -> None:
    way = in_plane(wander(np.random.default_rng(1), (1.5, 2.0, 0.4), 300, 25))
    assert way.shape == (300, 3)
    assert (np.abs(way) <= np.array([1.5, 2.0, 0.4]) + 1e-12).all()
    assert np.ptp(way[:, 1]) > 2.0


@pytest.fixture(scope="module")
def training():
    return train(SMALL)


def test_features_found_again_keep_their_names(training) -> None:
    tracks = training.tracks
    # Those that are found again belong together: at the true poses each is one point of the room.
    assert tracks.n_targets > 50
    assert np.bincount(tracks.target).min() >= 2
    assert (training.counts[:, 0] >= training.counts[:, 1]).all()
    assert training.counts[1:, 3].min() > 0
    off = [_off_its_point(training, k) for k in range(0, tracks.n_targets, 5)]
    # Matches are of a fraction of a pixel, and odometry of a few metres has drifted by some.
    assert np.median(off) < 2.0


def _off_its_point(training, k: int) -> float:
    """Largest reprojection error (px) of one target as one static point, with the true cameras and poses."""
    tracks = training.tracks
    mine = tracks.target == k
    M = training.film.simulation.world.cameras.M @ inverse(training.way[tracks.frame[mine]])[:, None]
    u = tracks.pixels[mine].reshape(-1, 2, 2)
    A = np.concatenate([M[..., :2, :] - u[..., None] * M[..., 2:, :]]).reshape(-1, 4)
    P = np.linalg.svd(A)[2][-1]
    p = M @ (P / P[3])
    return float(np.linalg.norm(p[..., :2] / p[..., 2:] - u, axis=-1).max())


def test_a_room_without_anything_to_find_again_is_one_line() -> None:
    with pytest.raises(InputError, match="no feature was found again"):
        planar_sift(SMALL.model_copy(update={"frames": 2, "features": 10}))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"goal_m": (-3.0, 0.0)}, "leaves an area"),
        ({"posters_low_m": (7.0, -4.0, -0.8)}, "lies above"),
    ],
)
def test_settings_that_contradict_each_other(settings: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        PlanarSiftStudy(**settings)


def test_features_that_two_views_share_show_the_same_points(training) -> None:
    """Seen 5 cm to the left, a point moves to the right by f · 0.05 m / Z, Z from 1.5 m on, and not down."""
    here, there = (
        snapshot(SMALL, *training.film.pair(inverse(planar_pose(0.0, y, 0.0))), training.gate)
        for y in (0.0, 0.05)
    )
    pairs = here.matches(there, SMALL.ratio)
    assert len(pairs) > 20
    moved = there.codes[pairs[:, 1]] - here.codes[pairs[:, 0]]
    right = np.median(moved, axis=0)
    assert (right[[0, 2]] > 0.0).all()
    assert (right[[0, 2]] < SMALL.rig.fx_px * 0.05 / 1.5).all()
    # Features are found to a fraction of a pixel.
    assert (np.abs(right[[1, 3]]) < 0.5).all()
    itself = here.matches(here, SMALL.ratio)
    assert (itself[:, 0] == itself[:, 1]).all()


def test_what_learned_nothing_or_never_drove_is_a_loss_and_says_so_in_the_figure() -> None:
    result = planar_sift(SMALL.model_copy(update={"frames": 2, "looks": 1}))
    lost = {loss.place: loss.what for loss in result.losses}
    assert lost["vmf"].startswith("nothing was learned: ")
    assert lost["vmf[thesis]"] == "none of the runs had a command"
    legend = result.drawings["robot_path"]().legends[0]
    labels = [text.get_text() for text in legend.get_texts()]
    assert {"vmf: not driven, no command", "vmf (thesis): not driven, no command"} <= set(labels)
    assert "exact command" in labels
