"""Rivals with growing calibration errors: what is asked, and from where on they are behind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vmf.data.simulate import trial_streams
from vmf.experiment.build import build_task, rig_model
from vmf.experiment.calibration_sweep import (
    CROSSOVERS,
    CURVES,
    crossing,
    crossover,
    only_swept,
    steps,
    sweep_rows,
)
from vmf.experiment.errors_table import solution_rows
from vmf.experiment.statistics import resampled_medians
from vmf.experiment.trial import held_out_asked
from vmf.reconstruct import CalibrationError, disturb, reconstruct
from vmf.spec import Spec

SWEEP = {
    "focal_percent": [2.0, 1.0],
    "principal_px": [],
    "rotation_deg": [0.5],
    "baseline_percent": [],
    "questions": 5,
}


def make_spec(sweep: dict[str, Any] | None = SWEEP, **more: Any) -> Spec:
    return Spec.model_validate(
        {
            "task": "translation",
            "data": {"simulate": {"frames": 20}},
            "calibration_sweep": sweep,
            "evaluate": {"queries": 12},
            **more,
        }
    )


def held_out(spec: Spec):
    return held_out_asked(spec, 0, trial_streams(spec, 0)[1])


def test_every_kind_starts_with_exact_cameras_and_grows() -> None:
    found = [(s.kind, s.magnitude, s.label) for s in steps(make_spec())]
    assert found == [
        ("focal", 0.0, "bundle"),
        ("focal", 1.0, "bundle[focal=1%]"),
        ("focal", 2.0, "bundle[focal=2%]"),
        ("rotation", 0.0, "bundle"),
        ("rotation", 0.5, "bundle[rot=0.5deg]"),
    ]


def test_what_the_rivals_are_asked_anyway_is_not_asked_twice() -> None:
    assert only_swept(make_spec()) == ("bundle[focal=1%]", "bundle[focal=2%]", "bundle[rot=0.5deg]")
    rivals = [{"method": "pnp"}, {"method": "bundle", "error": {"focal_percent": 1.0}}]
    expected = ("bundle", "bundle[focal=2%]", "bundle[rot=0.5deg]")
    assert only_swept(make_spec(rivals=rivals)) == expected


@pytest.mark.parametrize(
    "spec",
    [
        make_spec(None),
        make_spec({**SWEEP, "methods": []}),
        make_spec(evaluate={"protocol": ["trained_code"]}),
        Spec.model_validate(
            {
                "task": "translation",
                "data": {"recording": {"path": "x", "pose": {"topic": "p"}, "tracks": {"topic": "t"}}},
            }
        ),
    ],
    ids=["null", "nobody", "nothing held out", "no calibration"],
)
def test_nothing_is_swept_where_there_is_nothing_to_sweep(spec: Spec) -> None:
    assert steps(spec) == []
    assert only_swept(spec) == ()
    if spec.data.simulate is not None:
        assert list(sweep_rows(spec, held_out(spec), None)) == []


def test_rows_are_those_of_the_rival_with_that_error_on_evenly_spread_questions() -> None:
    spec = make_spec()
    asked = held_out(spec)
    rows = {str(table["method"].iloc[0]): table for table in sweep_rows(spec, asked, None)}
    assert tuple(rows) == only_swept(spec)
    model = rig_model(spec)
    assert model is not None
    task = build_task(spec)
    cameras = disturb(model, CalibrationError(focal_percent=2.0))
    solutions = reconstruct("bundle", task, cameras, asked.query)
    every = solution_rows(task, asked, "bundle[focal=2%]", solutions)
    mine = rows["bundle[focal=2%]"]
    questions = mine["query"].unique()
    assert list(questions) == [0, 3, 6, 8, 11]
    same = every[every["query"].isin(questions)].reset_index(drop=True)
    numbers = ["truth", "estimate", "abs_error"]
    # Solved by themselves or among others, to the minimiser's rounding.
    np.testing.assert_allclose(mine[numbers], same[numbers], rtol=0, atol=1e-7)
    pd.testing.assert_frame_equal(mine.drop(columns=numbers), same.drop(columns=numbers))


@pytest.mark.parametrize(("trials", "n"), [(1, 5), (2, 3), (5, 1), (9, 1)])
def test_all_trials_share_the_questions(trials: int, n: int) -> None:
    spec = make_spec(evaluate={"queries": 12, "trials": trials})
    assert all(table["query"].nunique() == n for table in sweep_rows(spec, held_out(spec), None))


def test_questions_about_very_many_targets_are_fewer() -> None:
    spec = make_spec({**SWEEP, "questions": 12}, evaluate={"queries": 12, "query_targets": 600})
    assert all(table["query"].nunique() == 5 for table in sweep_rows(spec, held_out(spec), None))


def stays_behind(x: float, magnitudes: np.ndarray, difference: np.ndarray) -> bool:
    """Whether the broken line through the differences is above zero everywhere beyond x."""
    beyond = np.concatenate([np.linspace(x, magnitudes[-1], 400)[1:], magnitudes[magnitudes > x]])
    return bool((np.interp(beyond, magnitudes, difference) > -1e-9).all())


@given(arrays(float, 5, elements=st.floats(-1.0, 1.0).map(lambda v: round(v, 3))))
def test_a_crossover_is_where_the_rival_falls_behind_for_good(difference: np.ndarray) -> None:
    magnitudes = np.array([0.0, 0.5, 1.0, 2.0, 5.0])
    (x,) = crossover(magnitudes, difference[None])
    if difference[-1] <= 0:
        assert x == np.inf
    elif (difference > 0).all():
        assert x == 0.0
    else:
        assert 0.0 <= x < 5.0
        assert np.interp(x, magnitudes, difference) == pytest.approx(0.0, abs=1e-9)
        assert stays_behind(x, magnitudes, difference)


def test_crossovers_of_many_draws_are_those_of_each() -> None:
    rng = np.random.default_rng(0)
    magnitudes, difference = np.array([0.0, 1.0, 3.0]), rng.normal(size=(50, 3))
    each = [crossover(magnitudes, row[None])[0] for row in difference]
    np.testing.assert_array_equal(crossover(magnitudes, difference), each)


def test_resampled_medians_are_medians_of_whole_clusters() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(23, 3)).round(1)
    clusters = rng.integers(0, 4, 23)
    found = resampled_medians(values, np.random.default_rng(7), 40, clusters)
    drawn = np.random.default_rng(7).integers(0, 4, (40, 4))
    for medians, chosen in zip(found, drawn, strict=True):
        pool = np.concatenate([values[clusters == c] for c in chosen])
        np.testing.assert_allclose(medians, np.median(pool, axis=0), rtol=0, atol=1e-12)
    single = resampled_medians(values[:1], np.random.default_rng(7), 5, clusters[:1])
    np.testing.assert_array_equal(single, np.repeat(values[:1], 5, axis=0))


def table(errors: dict[str, np.ndarray], asked: dict[str, np.ndarray] | None = None) -> pd.DataFrame:
    """An error table of one case with the given distances; NaN is refused, what was not asked is left out."""
    parts = []
    for method, values in errors.items():
        part = pd.DataFrame({"query": np.arange(len(values)), "abs_error": values})
        part["status"] = np.where(np.isfinite(values), "ok", "refused")
        part["method"] = method
        parts.append(part if asked is None or method not in asked else part[asked[method]])
    rows = pd.concat(parts, ignore_index=True)
    rows = rows.assign(trial=0, frame=20, case="frame=20", protocol="held_out", unit="m", truth=1.0)
    return rows.assign(component="distance")


def test_curves_and_crossovers_are_medians_over_the_questions_that_vmf_answered() -> None:
    spec = make_spec()
    rng = np.random.default_rng(2)
    n = 40
    sizes = {"vmf": 1.0, "bundle": 0.9, "cramer_rao": 0.8, "no_motion": 9.0}
    sizes |= {"bundle[focal=1%]": 0.95, "bundle[focal=2%]": 1.2, "bundle[rot=0.5deg]": 0.7}
    noise = rng.uniform(0.5, 1.5, n)
    errors = {name: size * noise for name, size in sizes.items()}
    errors["vmf"][3] = np.nan
    asked = np.zeros(n, bool)
    asked[1::3] = asked[3] = True
    found = crossing(spec, table(errors, dict.fromkeys(only_swept(spec), asked)), seed=1)
    assert found is not None
    assert list(found.curves) == list(CURVES)
    assert list(found.crossovers) == list(CROSSOVERS)
    both = asked & np.isfinite(errors["vmf"])
    focal = found.crossovers.set_index("kind").loc["focal"]
    assert (focal["n"], focal["n_asked"], focal["largest"]) == (both.sum(), asked.sum(), 2.0)
    # All errors are multiples of the same: 0.95 at 1 % and 1.2 at 2 % are 1 at 1.2 %, in every resample.
    assert [focal["crossover"], focal["ci_low"], focal["ci_high"]] == pytest.approx([1.2] * 3)
    assert np.isnan(found.crossovers.set_index("kind").loc["rotation", "crossover"])
    curve = found.curves[found.curves["kind"] == "focal"]
    assert list(curve["method"]) == ["vmf", "bundle", "bundle", "bundle", "cramer_rao"]
    np.testing.assert_array_equal(curve["magnitude"], [np.nan, 0.0, 1.0, 2.0, np.nan])
    expected = np.array([1.0, 0.9, 0.95, 1.2, 0.8]) * np.median(noise[both])
    np.testing.assert_allclose(curve["median"], expected)
    assert (curve["ci_low"] <= curve["median"]).all()
    assert (curve["median"] <= curve["ci_high"]).all()


def test_a_rival_without_an_answer_is_behind() -> None:
    spec = make_spec()
    errors = {name: np.full(9, 0.5) for name in ("bundle", *only_swept(spec))} | {"vmf": np.ones(9)}
    errors["bundle[focal=2%]"][:] = np.nan
    found = crossing(spec, table(errors), seed=1)
    assert found is not None
    focal = found.crossovers.set_index("kind").loc["focal"]
    assert (focal["n"], focal["n_asked"]) == (9, 9)
    # The last error that it answered at is the last at which it is not behind.
    assert focal["crossover"] == pytest.approx(1.0)
    curve = found.curves[(found.curves["kind"] == "focal") & (found.curves["magnitude"] == 2.0)]
    assert curve["median"].isna().all()


def test_nothing_answered_is_said_and_nothing_swept_is_none() -> None:
    spec = make_spec()
    errors = {name: np.ones(6) for name in ("vmf", "bundle", *only_swept(spec))}
    errors["vmf"][:] = np.nan
    found = crossing(spec, table(errors), seed=1)
    assert found is not None
    assert found.curves.empty
    assert list(found.crossovers["n"]) == [0, 0]
    assert list(found.crossovers["n_asked"]) == [6, 6]
    assert crossing(spec, table({"vmf": np.ones(3), "bundle": np.ones(3)}), seed=1) is None
    still = table(errors).assign(truth=0.0)
    assert crossing(spec, still, seed=1) is None
