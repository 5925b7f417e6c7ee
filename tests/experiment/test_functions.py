"""Functions beside the spec's own learn from the same draws and are asked the same questions."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest
from pydantic import ValidationError

from vmf.experiment.functions import functions
from vmf.experiment.trial import simulated_trial
from vmf.spec import Spec

THESIS = {
    "name": "thesis",
    "learner": {"kind": "pipeline"},
    "approximator": {"kind": "cmac", "gauge": "thesis"},
    "solver": {"cost": "algebraic", "start": "zero", "cameras": "left"},
}
KEYS = ["trial", "frame", "protocol", "component", "case", "query"]


def spec(**more: Any) -> Spec:
    return Spec.model_validate(
        {
            "task": "translation",
            "data": {"simulate": {"frames": 60, "targets": 3, "seed": 5}},
            "calibration_sweep": None,
            "evaluate": {"queries": 10, "curve_points": 12},
            **more,
        }
    )


def rows(errors: pd.DataFrame, method: str) -> pd.DataFrame:
    return errors[errors["method"] == method].set_index(KEYS).sort_index()


def test_another_function_answers_as_it_would_alone() -> None:
    both = simulated_trial(spec(also=[THESIS]), 0, False).errors
    assert list(dict.fromkeys(both["method"]))[:2] == ["vmf", "vmf[thesis]"]
    alone = {key: value for key, value in THESIS.items() if key != "name"}
    theirs = rows(simulated_trial(spec(**alone), 0, False).errors, "vmf")
    ours = rows(simulated_trial(spec(), 0, False).errors, "vmf")
    compared = ["truth", "estimate", "abs_error", "status"]
    pd.testing.assert_frame_equal(rows(both, "vmf[thesis]")[compared], theirs[compared])
    pd.testing.assert_frame_equal(rows(both, "vmf")[compared], ours[compared])


def test_with_fewer_points_it_is_asked_some_of_the_same_questions() -> None:
    errors = simulated_trial(spec(also=[{**THESIS, "curve_points": 3}]), 0, False).errors
    main, other = rows(errors, "vmf"), rows(errors, "vmf[thesis]")
    trained = other.loc[other.index.get_level_values("protocol") == "trained_code"]
    frames = trained.index.get_level_values("frame")
    assert 0 < frames.nunique() < 5
    assert 60 in frames
    assert other.index.isin(main.index).all()
    pd.testing.assert_series_equal(other["truth"], main.loc[other.index, "truth"])


def test_a_rival_with_fewer_points_answers_some_questions_as_it_would_all() -> None:
    def asked(**more: Any) -> pd.DataFrame:
        rival = {"method": "triangulate_arun", **more}
        return rows(simulated_trial(spec(rivals=[rival]), 0, True).errors, "triangulate_arun")

    every, some = asked(), asked(curve_points=3)
    trained = some.index.get_level_values("protocol") == "trained_code"
    assert some.index[trained].get_level_values("frame").nunique() == 3
    assert (~trained).sum() == (every.index.get_level_values("protocol") == "held_out").sum()
    compared = ["truth", "estimate", "abs_error", "status"]
    pd.testing.assert_frame_equal(some[compared], every.loc[some.index, compared])


def test_the_last_frames_are_asked_of_everyone() -> None:
    asked = {"queries": 10, "curve_points": 12, "curve_last": 7}
    rival = {"method": "triangulate_arun", "curve_points": 2}
    errors = simulated_trial(
        spec(evaluate=asked, also=[{**THESIS, "curve_points": 3}], rivals=[rival]), 0, True
    ).errors
    errors = errors[errors["protocol"] == "trained_code"]
    asked_of = errors.groupby("method", observed=True)["frame"].agg(set)
    assert {"vmf", "vmf[thesis]", "triangulate_arun"} <= set(asked_of.index)
    assert all(set(range(54, 61)) <= frames for frames in asked_of)
    assert len(asked_of["triangulate_arun"]) == 9


def test_what_is_left_out_is_as_in_the_rest_of_the_spec() -> None:
    one = spec(also=[{"name": "left", "solver": {"cameras": "left"}}], learner={"kind": "transport"})
    left = functions(one)["vmf[left]"]
    assert left.learner == one.learner
    assert left.solver.cameras == "left"
    assert left.evaluate == one.evaluate
    assert left.also == ()


POOLED = {
    "name": "rbf",
    "learner": {"kind": "pipeline", "readout": "pooled"},
    "approximator": {"kind": "rbf"},
}


@pytest.mark.parametrize(
    ("also", "said"),
    [
        ([{"name": "a"}, {"name": "a"}], "'a' twice"),
        ([{"name": "a b"}], "pattern"),
        ([POOLED], "also, rbf: learner.readout: pooled"),
    ],
)
def test_impossible_ones_are_refused(also: list[Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        spec(also=also)
