"""Questions are answered alike however many are asked at once, and from visited codes without their noise."""

import numpy as np
import pytest

from vmf.data import Query, join
from vmf.data.simulate import held_out_queries, simulate, trial_streams
from vmf.experiment.asking import answer
from vmf.experiment.build import build_learner
from vmf.geometry import inverse
from vmf.reconstruct import bundle
from vmf.spec import Spec

FRAMES = 120


@pytest.fixture(scope="module", params=["planar", "six_dof"])
def taught(request):
    """A spec, a learner taught frames of six targets, and queries from the first of them to later ones."""
    spec = Spec.model_validate(
        {
            "task": request.param,
            "data": {"simulate": {"frames": FRAMES, "targets": 6}},
            "noise": {"pixel_px": 3.0},
            "evaluate": {"queries": 10, "query_targets": 6},
        }
    )
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    learner = build_learner(spec)
    learner.partial_fit(simulation.tracks)
    pixels = np.full((FRAMES, 6, 4), np.nan)
    pixels[simulation.tracks.frame, simulation.tracks.target] = simulation.tracks.pixels
    E = simulation.tracks.E_S_from_W
    later = np.arange(1, FRAMES)
    first = np.zeros_like(later)
    return spec, learner, Query(pixels[first], pixels[later], E[first], E[later])


def test_one_at_a_time_is_all_at_once(taught):
    spec, learner, visited = taught
    held_out = held_out_queries(spec, trial_streams(spec, 0)[1])
    some = visited.select(np.arange(10))
    # Visited and new codes in turns.
    turns = np.arange(20).reshape(2, 10).T.ravel()
    query = join([some, Query(*(getattr(held_out, f) for f in some.__dataclass_fields__))]).select(turns)
    at_once = answer(spec, learner, query)
    for i in range(len(query)):
        alone = answer(spec, learner, query.select(np.array([i])))
        np.testing.assert_array_equal(alone.p[0], at_once.p[i])
        np.testing.assert_array_equal(alone.weights[0], at_once.weights[i])
        assert alone.reason[0] == at_once.reason[i]


def test_visited_codes_are_known_better_than_one_look_says(taught):
    """Two views alone suffer from the noise of both; a code that was visited has none of its own."""
    spec, learner, query = taught

    def off(solutions):
        between = query.E_desired @ inverse(query.E_initial)
        return np.median(np.linalg.norm((solutions.E_to_from - between)[:, :3, 3], axis=1))

    two_views = bundle(learner.task, learner.cameras, query, noise=learner.noise)
    assert off(answer(spec, learner, query)) < off(two_views)


def test_no_questions_no_answers(taught):
    spec, learner, query = taught
    assert len(answer(spec, learner, query.select(np.zeros(0, int)))) == 0
