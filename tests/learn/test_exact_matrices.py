"""Noise isolated to the right-hand sides: the equations as they are written, and what they are good for."""

from __future__ import annotations

from dataclasses import replace

import learner_scenes as scenes
import numpy as np
import pytest

from vmf.approximate import Lookup
from vmf.geometry import inverse
from vmf.learn import SequentialPipeline


def learner(task, **options):
    return SequentialPipeline(task, None, Lookup, exact_matrices=True, gauge="thesis", **options)


def noisy(scene, rng, noise_px):
    """The scene's tracks with noise, and the pixels without beside them."""
    t = scene.tracks
    return replace(t, pixels=t.pixels + noise_px * rng.normal(size=t.pixels.shape), exact=t.pixels)


def literal(case, tracks, centre, camera):
    """Eq. 3.46 of all pairs of one target with one centre, exact on the left and noisy on the right."""
    k = case.task.n_lift
    A, b = [], []
    E = tracks.E_S_from_W[tracks.frame]
    u, v = (p[:, 2 * camera : 2 * camera + 2] for p in (tracks.exact, tracks.pixels))
    for i in range(len(E)):
        x_bar = case.task.lift(E[i] @ inverse(E[centre]))
        for axis in range(2):
            row = np.zeros(3 * k + 2)
            row[axis * (k + 1) : (axis + 1) * (k + 1)] = x_bar
            row[2 * (k + 1) :] = -(u[i, axis] - u[centre, axis]) * x_bar[:-1]
            A.append(row)
            b.append(v[i, axis] - v[centre, axis])
    return np.array(A), np.array(b)


@pytest.mark.parametrize("name", ["translation", "planar", "six_dof"])
def test_parameters_are_the_least_squares_solution_of_the_literal_equations(cases, name):
    case = cases[name]
    rng = np.random.default_rng(7)
    tracks = noisy(scenes.make_scene(case, rng, frames=30, targets=1), rng, 1.0)
    one = learner(case.task)
    for block in scenes.blocks(tracks, [1, 12, 17]):
        one.partial_fit(block)
    rows = one.parameters(tracks.pixels[:1]).rows[0]
    for camera in range(2):
        A, b = literal(case, tracks, 0, camera)
        theta, *_ = np.linalg.lstsq(A, b, rcond=None)
        # Backward stable solvers of one problem differ by its condition number in rounding.
        tolerance = 1e3 * scenes.EPS * np.linalg.cond(A) * np.linalg.norm(theta)
        np.testing.assert_allclose(
            np.append(rows[camera].ravel()[:-1], 1.0)[: len(theta)], theta, atol=tolerance
        )
        assert rows[camera, 2, -1] == pytest.approx(1.0)


@pytest.mark.parametrize("tiling", [scenes.TILING, None], ids=["tiles", "codes"])
@pytest.mark.parametrize("length", [None, 3, 90])
def test_without_noise_nothing_changes(cases, tiling, length):
    case = cases["translation"]
    rng = np.random.default_rng(3)
    # More pairs than are taken in at once.
    tracks = noisy(scenes.make_scene(case, rng, frames=150, targets=2, lost=0.05), rng, 0.0)
    one, other = (
        scenes.sequential(case.task, tiling, length=length, exact_matrices=e) for e in (True, False)
    )
    for block in scenes.blocks(tracks, [1, 79, 70]):
        one.partial_fit(block)
        other.partial_fit(block)
        tiles = one.tiles(scenes.stereo_codes(tracks))
        assert tiles.slot.tolist() == other.tiles(scenes.stereo_codes(tracks)).slot.tolist()
        A, B = (np.swapaxes(R, -1, -2) @ R for R in (one._factors(tiles), other._factors(tiles)))
        size = np.maximum(np.sqrt(np.einsum("...ii->...i", B)), 1.0)
        assert (np.abs(A - B) <= scenes.GRAM * size[..., :, None] * size[..., None, :]).all()


def test_what_was_asked_before_changes_nothing(cases):
    case = cases["planar"]
    rng = np.random.default_rng(5)
    tracks = noisy(scenes.make_scene(case, rng, frames=150, targets=2), rng, 1.0)
    one, other = (scenes.sequential(case.task, exact_matrices=True) for _ in range(2))
    for block in scenes.blocks(tracks, [10, 60, 33, 47]):
        one.partial_fit(block)
        one.parameters(tracks.pixels[:1])
    other.partial_fit(tracks)
    np.testing.assert_array_equal(one.parameters(tracks.pixels).rows, other.parameters(tracks.pixels).rows)


def test_isolated_noise_leaves_no_attenuation(cases):
    """Noise in the matrices shrinks θ by a share that data do not cure; on the right it averages out."""
    case = cases["translation"]
    rng = np.random.default_rng(11)
    sizes = {}
    for exact in (True, False):
        ratios = []
        for _ in range(12):
            scene = scenes.make_scene(case, rng, frames=60, targets=1)
            tracks = noisy(scene, rng, 3.0)
            one = SequentialPipeline(case.task, None, Lookup, gauge="thesis", exact_matrices=exact)
            one.partial_fit(tracks)
            found = one.parameters(tracks.pixels[:1]).rows[0, 0, 2, :-1]
            true = scenes.analytic(case, scene)[0, 0, 0, 2]
            # How much of c's direction of depth is found: 1 without bias.
            ratios.append(found @ (true[:-1] / true[-1]) / np.sum((true[:-1] / true[-1]) ** 2))
        sizes[exact] = np.array(ratios)
    n = len(sizes[True])
    isolated, observed = sizes[True], sizes[False]
    assert abs(isolated.mean() - 1.0) < 4 * isolated.std(ddof=1) / np.sqrt(n)
    assert abs(isolated.mean() - 1.0) < abs(observed.mean() - 1.0)


def test_a_stored_learner_answers_the_same(cases):
    case = cases["planar"]
    rng = np.random.default_rng(5)
    tracks = noisy(scenes.make_scene(case, rng, frames=20, targets=2), rng, 1.0)
    one, again = learner(case.task), learner(case.task)
    one.partial_fit(tracks)
    again.restore(one.state())
    np.testing.assert_array_equal(again.parameters(tracks.pixels).rows, one.parameters(tracks.pixels).rows)


def test_who_does_not_know_pixels_without_noise_cannot_ask_for_them(cases):
    case = cases["translation"]
    scene = scenes.make_scene(case, np.random.default_rng(1), frames=5, targets=1)
    with pytest.raises(ValueError, match="only a simulation knows"):
        learner(case.task).partial_fit(scene.tracks)
