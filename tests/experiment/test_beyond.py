"""Answers after more than so many frames as one case, and the small tables beside the errors."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from vmf.data.simulate import held_out_questions, trial_streams
from vmf.errors import InputError
from vmf.experiment import protocols
from vmf.experiment.build import rig_model
from vmf.experiment.statistics import beyond, question_clusters, summarise
from vmf.experiment.system import condition_table, point_errors, reconstructed_off
from vmf.spec import Spec


def make_spec(**evaluate: object) -> Spec:
    data = {"simulate": {"frames": 100}}
    return Spec.model_validate({"task": "translation", "data": data, "evaluate": evaluate})


def table(trials: int, frames: int, rng: np.random.Generator) -> pd.DataFrame:
    trial, frame = (a.ravel() for a in np.meshgrid(range(trials), range(1, frames + 1), indexing="ij"))
    error = rng.exponential(size=len(trial))
    status = np.where(rng.random(len(trial)) < 0.1, "diverged", "ok")
    rows = pd.DataFrame(
        {"trial": trial, "frame": frame, "abs_error": np.where(status == "ok", error, np.nan)}
    )
    rows = rows.assign(status=status, protocol="trained_code", method="vmf", component="t_x", unit="m")
    rows["case"] = [f"frame={f}" for f in frame]
    held = rows.iloc[:5].assign(protocol="held_out", frame=frames, case=f"frame={frames}")
    return pd.concat([rows, held], ignore_index=True)


@pytest.mark.parametrize("trials", [1, 4])
def test_all_answers_at_trained_codes_beyond_a_frame_are_counted(trials: int) -> None:
    errors = table(trials, 300, np.random.default_rng(0))
    later, cases = beyond(errors, [50, 200])
    assert cases == ("frame>50", "frame>200")
    rows = summarise(later, cases, 1, 200).set_index("case")
    for count in (50, 200):
        part = errors[(errors["protocol"] == "trained_code") & (errors["frame"] > count)]
        row = rows.loc[f"frame>{count}"]
        assert row["n"] + row["n_diverged"] == len(part) == trials * (300 - count)
        good = part.loc[part["status"] == "ok", "abs_error"]
        assert row["mean"] == pytest.approx(good.mean())
        assert row["std"] == pytest.approx(good.std())
        assert row["ci_low"] < row["mean"] < row["ci_high"]


def test_nothing_asked_beyond_is_no_case() -> None:
    errors = table(1, 10, np.random.default_rng(0))
    assert beyond(errors, [])[0].empty
    assert beyond(errors, [10])[0].empty


def test_frames_of_one_trial_are_clustered_in_time_and_of_several_by_trial() -> None:
    frame = np.arange(200)
    one = question_clusters(np.zeros(200, np.int64), frame, "frame>20")
    assert len(np.unique(one)) == 4
    assert (np.diff(one) >= 0).all()
    several = question_clusters(np.repeat([0, 1], 100), frame, "frame>20")
    assert several.tolist() == [0] * 100 + [1] * 100


@pytest.mark.parametrize("frames", [[100], [5, 2000]])
def test_there_must_be_frames_beyond(frames: list[int]) -> None:
    with pytest.raises(InputError, match=rf"evaluate\.beyond: found {frames[-1]}, .* from 1 to 99"):
        protocols.beyond(make_spec(beyond=frames), 100)
    assert protocols.beyond(make_spec(beyond=[99, 5, 5]), 100) == (5, 99)


def test_an_even_curve_has_equal_steps_and_the_checkpoints() -> None:
    spec = make_spec(curve_points=8, curve_spacing="even", checkpoints=[50])
    frames = protocols.curve_frames(spec, 100)
    assert frames.tolist() == [2, 16, 30, 44, 50, 58, 72, 86, 100]
    every = protocols.curve_frames(make_spec(curve_points=500, curve_spacing="even"), 100)
    assert every.tolist() == list(range(2, 101))


def test_condition_numbers_are_counted_with_the_singular_ones() -> None:
    condition = np.array([[np.inf, 4.0, 2.0], [np.nan, 8.0, 2.0], [np.inf, 6.0, 2.0]])
    rows = condition_table(np.array([2, 10, 20]), condition)
    assert rows["frame"].tolist() == [2, 10, 20]
    assert rows["n"].tolist() == [0, 3, 3]
    assert rows["n_singular"].tolist() == [3, 0, 0]
    assert np.isnan(rows["median"][0])
    assert rows["median"].tolist()[1:] == [6.0, 2.0]


def test_reconstructed_points_are_off_by_the_noise_alone() -> None:
    exact = make_spec(queries=10).model_copy(
        update={"noise": make_spec().noise.model_copy(update={"pixel_px": 0.0})}
    )
    query, truth = held_out_questions(exact, trial_streams(exact, 0)[1])
    rig = rig_model(exact)
    assert rig is not None
    off = reconstructed_off(rig, query, truth)
    assert off.shape == (20, 3)
    # The minimisation ends at a relative change of 1e-8 or so of metres.
    assert np.abs(off).max() < 1e-6
    assert point_errors([]) is None
    rows = point_errors([np.array([[1.0, -2.0, 3.0]]), np.array([[-3.0, 2.0, 3.0]])])
    assert rows is not None
    assert rows["component"].tolist() == ["x", "y", "z"]
    assert rows["mean"].tolist() == [2.0, 2.0, 3.0]
    assert rows["n"].tolist() == [2, 2, 2]
