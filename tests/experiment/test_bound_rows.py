"""The Cramér–Rao bound as rows of the error table: what an efficient estimator makes of the same noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vmf.data import Truth
from vmf.data.simulate import disturbed_views, simulate, trial_streams
from vmf.experiment import protocols
from vmf.experiment.bound import bound_rows, mean_norm
from vmf.experiment.build import build_task, rig_model
from vmf.experiment.errors_table import COLUMNS, error_rows
from vmf.experiment.trial import held_out_asked, trained_code_asked
from vmf.reconstruct import cramer_rao
from vmf.spec import Spec

TASKS = ("pan_tilt", "translation", "planar", "six_dof")


def make_spec(task: str = "six_dof", noise: float = 0.1, point_m: float = 0.0, **more: object) -> Spec:
    return Spec.model_validate(
        {
            "task": task,
            "data": {"simulate": {"frames": 60, "targets": 6}},
            "noise": {"pixel_px": noise, "point_m": point_m},
            "evaluate": {"queries": 300, "query_targets": 6},
            **more,
        }
    )


def held_out(spec: Spec):
    return held_out_asked(spec, 0, trial_streams(spec, 0)[1])


def trained_code(spec: Spec):
    rng = trial_streams(spec, 0)[0]
    simulation = simulate(spec, rng)
    view = protocols.first_view(simulation.tracks, 1)
    disturbed = disturbed_views(simulation, spec, rng) if spec.noise.point_m else None
    assert view is not None
    return trained_code_asked(view, np.arange(2, 61), simulation, disturbed)


@pytest.mark.parametrize("question", [held_out, trained_code])
@pytest.mark.parametrize("task", TASKS)
def test_rows_are_those_of_the_motion_with_the_efficient_error(task, question) -> None:
    spec = make_spec(task)
    asked, space = question(spec), build_task(spec)
    rows = bound_rows(spec, asked)
    model = rig_model(spec)
    assert model is not None
    points_known = question is trained_code
    bound = cramer_rao(space, model.cameras(), asked.query, asked.truth, 0.1, points_known=points_known)
    E = space.motion(bound.p + bound.error, asked.query.E_initial)
    literal = error_rows(space, asked, "cramer_rao", E, np.full(len(E), "ok"))
    assert list(rows) == [*COLUMNS, "case", "query", "expected_error"]
    for column in ("trial", "frame", "protocol", "method", "component", "unit", "case", "query", "status"):
        assert (rows[column] == literal[column]).all(), column
    np.testing.assert_allclose(rows["truth"], literal["truth"], rtol=0, atol=1e-9)
    # The same to first order; a rotation vector of 0.1 rad misses by its square.
    change = np.abs(rows["abs_error"] - literal["abs_error"])
    assert (change <= 1e-9 + np.square(literal["abs_error"]) + 0.05 * literal["abs_error"]).all()
    np.testing.assert_allclose(rows["estimate"], literal["estimate"], rtol=0, atol=2e-2)


@pytest.mark.parametrize("question", [held_out, trained_code])
@pytest.mark.parametrize("point_m", [0.0, 0.02])
def test_errors_spread_as_the_bound_says(question, point_m) -> None:
    spec = make_spec("translation", noise=1.0, point_m=point_m)
    rows = bound_rows(spec, question(spec))
    scaled = rows["abs_error"] / rows["expected_error"]
    for component in ("t_x", "t_y", "t_z"):
        mine = scaled[rows["component"] == component]
        # |normal| over its mean: variance π/2 − 1.
        assert mine.mean() == pytest.approx(1.0, abs=4 * np.sqrt((np.pi / 2 - 1) / len(mine)))
    distance = scaled[rows["component"] == "distance"]
    # A length varies no more than the |normal| of a single direction.
    assert distance.mean() == pytest.approx(1.0, abs=4 * np.sqrt((np.pi / 2 - 1) / len(distance)))


def test_moved_targets_leave_less_to_know() -> None:
    still, moved = (
        bound_rows(spec, trained_code(spec))["expected_error"]
        for spec in (make_spec(noise=1.0), make_spec(noise=1.0, point_m=0.05))
    )
    assert (moved > still).all()


def test_angles_of_an_error_larger_than_a_turn_go_around_the_circle() -> None:
    spec = make_spec("planar", noise=500.0)
    rows = bound_rows(spec, held_out(spec))
    angles = rows[rows["unit"] == "rad"]
    assert (angles["abs_error"] <= np.pi).all()
    assert (angles["expected_error"] > np.pi).any()


def test_no_noise_no_error() -> None:
    for question in (held_out, trained_code):
        spec = make_spec(noise=0.0)
        rows = bound_rows(spec, question(spec))
        assert (rows["status"] == "ok").all()
        assert rows[["abs_error", "expected_error"]].to_numpy().max() < 1e-12


def test_one_camera_and_a_known_rotation_count() -> None:
    def mean(**solver: str) -> float:
        spec = make_spec(noise=1.0, solver=solver)
        rows = bound_rows(spec, held_out(spec))
        return float(rows.loc[rows["component"] == "distance", "expected_error"].median())

    assert mean(known="rotation") < mean() < mean(cameras="left")


def test_what_cannot_be_known_is_refused() -> None:
    spec = make_spec(noise=1.0, evaluate={"queries": 5, "query_targets": 2})
    rows = bound_rows(spec, held_out(spec))
    assert (rows["status"] == "refused").all()
    assert rows[["estimate", "abs_error", "expected_error"]].isna().all(axis=None)
    assert rows["truth"].notna().all()


def test_without_a_truth_there_is_no_bound() -> None:
    spec = make_spec()
    with pytest.raises(ValueError, match="only simulated"):
        bound_rows(spec, replace(held_out(spec), truth=None))


def test_mean_length_is_that_of_many_draws() -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 3, 3)) * [[[1.0]], [[0.1]], [[3.0]], [[1.0]], [[1.0]], [[1.0]]]
    A[3, :, 0] = 0.0
    A[4, :, :2] = 0.0
    A[5] = 0.0
    drawn = np.linalg.norm(A @ rng.standard_normal((6, 3, 100_000)), axis=1)
    error = 4 * drawn.std(axis=1) / np.sqrt(drawn.shape[1])
    C = A @ np.swapaxes(A, -1, -2)
    assert (np.abs(mean_norm(C) - drawn.mean(axis=1)) <= error + 1e-12).all()
    # Of one direction it is that of a normal number, of three equal ones that of Maxwell's distribution.
    assert mean_norm(np.diag([4.0, 0.0, 0.0])) == pytest.approx(2 * np.sqrt(2 / np.pi))
    assert mean_norm(np.eye(3)) == pytest.approx(np.sqrt(8 / np.pi))
    assert np.isnan(mean_norm(np.full((3, 3), np.nan)))


def test_the_truth_is_not_part_of_what_is_asked() -> None:
    asked = held_out(make_spec())
    assert isinstance(asked.truth, Truth)
    assert not any(isinstance(value, Truth) for value in vars(asked.query).values())
