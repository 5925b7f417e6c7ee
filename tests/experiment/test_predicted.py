"""Where targets are expected after a motion: where they are seen, if neither data nor motion err."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vmf.data.simulate import held_out_queries, simulate, trial_streams
from vmf.experiment.asking import answer
from vmf.experiment.build import build_learner
from vmf.experiment.predicted import predicted_pixels
from vmf.learn import StructuredLearner
from vmf.spec import loads

NOISE_FREE = "noise: {pixel_px: 0}\nevaluate: {queries: 12}\n"


def trained(task: str, learner: str, mounting: str = "eye_in_hand"):  # type: ignore[no-untyped-def]
    spec = loads(
        f"task: {task}\nmounting: {mounting}\ndata: {{simulate: {{frames: 60, seed: 3}}}}\n"
        f"learner: {learner}\n{NOISE_FREE}",
        "spec",
    ).spec
    training, queries = trial_streams(spec, 0)
    model = build_learner(spec)
    model.partial_fit(simulate(spec, training).tracks)
    return spec, model, held_out_queries(spec, queries)


@pytest.mark.parametrize(
    ("task", "mounting"),
    [("translation", "eye_in_hand"), ("planar", "eye_in_hand"), ("six_dof", "eye_to_hand")],
)
def test_targets_are_expected_where_they_should_be(task: str, mounting: str) -> None:
    spec, learner, query = trained(task, "{kind: structured}", mounting)
    solutions = answer(spec, learner, query)
    assert (solutions.status == "ok").all()
    predicted = predicted_pixels(learner, query, solutions)
    # Without noise only the solvers' last steps are left, far below what a screen shows.
    assert np.abs(predicted - query.desired).max() < 1e-3
    assert np.abs(query.initial - query.desired).max() > 30.0


def test_nothing_is_expected_without_a_motion_or_a_code_to_start_from() -> None:
    spec, learner, query = trained("translation", "{kind: structured}")
    initial = query.initial.copy()
    initial[1, 0, 2:] = np.nan
    query = replace(query, initial=initial)
    solutions = answer(spec, learner, query)
    reason = solutions.reason.copy()
    reason[0] = next(r for r in type(reason[0]) if r.status == "refused")
    predicted = predicted_pixels(learner, query, replace(solutions, reason=reason))
    assert np.isnan(predicted[0]).all()
    assert np.isnan(predicted[1, 0]).all()
    assert np.isfinite(predicted[2:]).all()


def test_a_learned_lens_is_looked_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """A function in ideal pixels expects targets at pixels that become its own once rectified."""
    spec, learner, query = trained("translation", "{kind: structured}")
    solutions = answer(spec, learner, query)
    straight = predicted_pixels(learner, query, solutions)

    def rectified(_: StructuredLearner, pixels: np.ndarray) -> np.ndarray:
        offset = (pixels.reshape(*pixels.shape[:-1], 2, 2) - 320.0) / 500.0
        r2 = (offset**2).sum(axis=-1, keepdims=True)
        return np.asarray((offset * (1 + 0.1 * r2) * 500.0 + 320.0).reshape(pixels.shape))

    monkeypatch.setattr(StructuredLearner, "rectified", rectified)
    bent = replace(query, initial=_inverse(rectified, query.initial))
    predicted = predicted_pixels(learner, bent, solutions)
    np.testing.assert_allclose(rectified(learner, predicted), straight, atol=1e-2)
    assert np.abs(predicted - straight).max() > 1.0


def _inverse(rectified, pixels: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    found = pixels
    for _ in range(200):
        found = found + pixels - rectified(None, found)
    return found
