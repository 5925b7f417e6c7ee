"""Every registered approximator has a model in the spec, and both mean the same."""

from __future__ import annotations

import inspect
import typing
from typing import Any, Literal, get_args

import numpy as np
import pytest
from pydantic import BaseModel

from vmf.approximate import APPROXIMATORS, make_approximator
from vmf.approximate.kaczmarz import TRAININGS
from vmf.errors import InputError
from vmf.experiment.build import build_learner
from vmf.spec import loads
from vmf.spec.approximators import AnyApproximator, Training

BASE = "task: translation\ndata: {simulate: {}}\n"
MODELS: dict[str, type[BaseModel]] = {
    model.model_fields["kind"].default: model for model in get_args(get_args(AnyApproximator)[0])
}
APART = {"kind", "gauge"}


def test_the_registry_and_the_spec_name_the_same() -> None:
    assert list(MODELS) == list(APPROXIMATORS)
    assert list(get_args(Training)) == list(TRAININGS)


@pytest.mark.parametrize("kind", APPROXIMATORS)
def test_what_the_spec_leaves_out_is_what_the_constructor_takes(kind: str) -> None:
    ours = {name: field.default for name, field in MODELS[kind].model_fields.items() if name not in APART}
    theirs = {name: p.default for name, p in inspect.signature(APPROXIMATORS[kind]).parameters.items()}
    assert ours == theirs


@pytest.mark.parametrize("kind", [kind for kind in APPROXIMATORS if kind != "none"])
def test_every_one_that_learns_has_a_gauge(kind: str) -> None:
    field = MODELS[kind].model_fields["gauge"]
    assert (field.default, get_args(field.annotation)) == ("unit_depth", ("unit_depth", "thesis"))
    for gauge in ("unit_depth", "thesis"):
        spec = loads(
            f"{BASE}learner: {{kind: transport}}\napproximator: {{kind: {kind}, gauge: {gauge}}}"
        ).spec
        assert typing.cast(Any, build_learner(spec)).gauge == gauge


def extreme(model: type[BaseModel], which: Literal["ge", "le"]) -> dict[str, Any]:
    """The least or the greatest values that a model accepts, where it says so."""
    found = {}
    for name, field in model.model_fields.items():
        for constraint in field.metadata:
            bound = getattr(constraint, which, None)
            if bound is not None:
                found[name] = bound
    return found


@pytest.mark.parametrize("which", ["ge", "le"])
@pytest.mark.parametrize("kind", [kind for kind in APPROXIMATORS if kind != "none"])
def test_extreme_settings_answer_or_refuse(kind: str, which: Literal["ge", "le"]) -> None:
    """Nothing that the spec lets through ends in a failure of linear algebra or a warning."""
    options = extreme(MODELS[kind], which)
    rng = np.random.default_rng(1)
    codes = rng.uniform(0.0, 640.0, (60, 4))
    # Codes next to each other, and parameters of any size.
    codes[30:] = codes[:30] + rng.normal(0.0, 1e-6, (30, 4))
    theta = rng.normal(size=(60, 3)) * [1e-9, 1.0, 1e9]
    approximator = make_approximator(kind, **options)
    with np.errstate(all="raise", under="ignore"):
        approximator.partial_fit(codes, theta, rng.uniform(1e-9, 1.0, 60))
        prediction = approximator.predict(np.concatenate([codes, rng.uniform(-640.0, 1280.0, (60, 4))]))
    answered = prediction.parameters[~prediction.refused]
    assert np.isfinite(answered).all()
    assert np.isfinite(prediction.support).all()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            ("learner={kind: pipeline, readout: pooled}", "approximator.kind=lwr"),
            "learner.readout: pooled joins the tiles of approximator.kind: cmac, found lwr",
        ),
        (
            (
                "learner={kind: pipeline, engine: sequential, readout: kaczmarz}",
                "approximator.kind=cmac_linear",
            ),
            "learner.readout: kaczmarz joins the tiles of approximator.kind: cmac, found cmac_linear",
        ),
        (
            ("learner.kind=pipeline", "approximator={kind: cmac, training: randomised}"),
            "approximator.training: randomised needs learner.kind: transport; the tiles of the pipeline hold "
            "equations of their own",
        ),
        (("approximator={kind: cmac_multires, tiles_px: []}",), "approximator.tiles_px: found []"),
        (
            ("approximator={kind: rbf, max_centres: 3}",),
            "approximator.max_centres: found 3, a whole number of",
        ),
        (("approximator={kind: knn, k: 3}",), "approximator.k: unknown key"),
    ],
)
def test_what_does_not_go_together_is_refused_in_one_line(override: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as caught:
        loads(BASE, "q.yaml", override)
    (line,) = caught.value.lines
    assert message in line


@pytest.mark.parametrize("kind", APPROXIMATORS)
@pytest.mark.parametrize("learner", ["transport", "pipeline"])
def test_every_approximator_goes_with_both_learners(kind: str, learner: str) -> None:
    spec = loads(BASE, overrides=[f"learner.kind={learner}", f"approximator.kind={kind}"]).spec
    assert build_learner(spec).tracks is None
