"""The tidy table of errors, against a literal recomputation with scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vmf.data import Query
from vmf.experiment.errors_table import COLUMNS, Asked, error_rows, no_motion_rows
from vmf.geometry import inverse
from vmf.tasks import make_task

Floats = NDArray[np.float64]
TASKS = ("pan_tilt", "translation", "planar", "six_dof")
UNIT = {"translation": ["m"] * 3, "planar": ["rad", "m", "m"], "six_dof": ["rad"] * 3 + ["m"] * 3}
UNIT["pan_tilt"] = ["rad", "rad"]


def asked(name: str, rng: np.random.Generator, n: int = 8, reach: float = 0.4) -> tuple[Asked, Floats]:
    """Questions with their true motions, and answered motions near them."""
    task = make_task(name, "general")
    E_initial = task.motion(rng.uniform(-reach, reach, (n, task.n_motion)), np.eye(4))
    p = rng.uniform(-reach, reach, (n, task.n_motion))
    truth = task.motion(p, E_initial)
    answered = task.motion(p + rng.normal(0, 0.05, p.shape), E_initial)
    nothing = np.zeros((n, 1, 4))
    query = Query(nothing, nothing, E_initial, truth @ E_initial)
    return Asked("held_out", 3, np.arange(n) + 10, np.array(["gap=5"] * n), query), answered


def literal(E: Floats, name: str) -> list[float]:
    """The components of one motion, by name."""
    turn_z, turn_y, turn_x = Rotation.from_matrix(E[:3, :3]).as_euler("ZYX")
    t = list(E[:3, 3])
    return {
        "translation": t,
        "planar": [turn_z, t[0], t[1]],
        "six_dof": [turn_x, turn_y, turn_z, *t],
    }[name]


SIX_DOF = ["rot_x", "rot_y", "rot_z", "t_x", "t_y", "t_z"]


@pytest.mark.parametrize("name", ["translation", "planar", "six_dof"])
def test_components_are_those_of_scipys_rotations(name: str, rng: np.random.Generator) -> None:
    questions, E = asked(name, rng)
    task = make_task(name, "general")
    rows = error_rows(task, questions, "vmf", E, np.full(len(E), "ok"))
    own = SIX_DOF if name == "six_dof" else [c for c, _ in task.components]
    for q in range(len(E)):
        mine = rows[rows["query"] == q].set_index("component")
        assert set(mine.index) == {*own, "angle", "distance"}
        assert list(mine.loc[[*own, "angle", "distance"], "unit"]) == [*UNIT[name], "rad", "m"]
        true, found = literal(questions.query.truth[q], name), literal(E[q], name)
        np.testing.assert_allclose(mine.loc[own, "truth"], true, rtol=0, atol=1e-12)
        np.testing.assert_allclose(mine.loc[own, "estimate"], found, rtol=0, atol=1e-12)
        np.testing.assert_allclose(mine.loc[own, "abs_error"], np.abs(np.subtract(found, true)), atol=1e-12)


@pytest.mark.parametrize("name", TASKS)
def test_angle_and_distance_are_geodesic_and_norm(name: str, rng: np.random.Generator) -> None:
    questions, E = asked(name, rng)
    rows = error_rows(make_task(name, "general"), questions, "vmf", E, np.full(len(E), "ok"))
    true = questions.query.truth
    between = Rotation.from_matrix(true[:, :3, :3]).inv() * Rotation.from_matrix(E[:, :3, :3])
    # An angle near 0 comes from a cosine or a quaternion: half the digits.
    angle = rows[rows["component"] == "angle"]
    np.testing.assert_allclose(angle["abs_error"], between.magnitude(), rtol=0, atol=1e-7)
    size = Rotation.from_matrix(true[:, :3, :3]).magnitude()
    np.testing.assert_allclose(angle["truth"], size, rtol=0, atol=1e-7)
    distance = rows[rows["component"] == "distance"]
    gap = np.linalg.norm(E[:, :3, 3] - true[:, :3, 3], axis=1)
    np.testing.assert_allclose(distance["abs_error"], gap, rtol=0, atol=1e-12)
    np.testing.assert_allclose(distance["truth"], np.linalg.norm(true[:, :3, 3], axis=1), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("true", "found", "error"),
    [(3.1, -3.1, 2 * np.pi - 6.2), (-3.1, 3.1, 2 * np.pi - 6.2), (0.1, -0.2, 0.3), (np.pi, -np.pi, 0.0)],
)
def test_angles_are_compared_around_the_circle(true: float, found: float, error: float) -> None:
    task = make_task("planar", "general")
    E_true, E = (task.motion(np.array([[turn, 0.5, 0.0]]), np.eye(4)[None]) for turn in (true, found))
    nothing = np.zeros((1, 1, 4))
    query = Query(nothing, nothing, np.eye(4)[None], E_true)
    questions = Asked("held_out", 0, np.array([1]), np.array(["gap=1"]), query)
    rows = error_rows(task, questions, "vmf", E, np.array(["ok"])).set_index("component")
    assert rows.loc["heading", "abs_error"] == pytest.approx(error, abs=1e-12)
    assert rows.loc["angle", "abs_error"] == pytest.approx(error, abs=1e-7)
    assert rows.loc["t_x", "abs_error"] < 1e-12


@pytest.mark.parametrize("name", TASKS)
def test_no_answer_has_a_truth_and_a_status_and_no_number(name: str, rng: np.random.Generator) -> None:
    questions, E = asked(name, rng)
    status = np.array(["ok", "refused", "diverged", "ok"] * 2)
    E[status != "ok"] = np.nan
    rows = error_rows(make_task(name, "general"), questions, "vmf", E, status)
    assert list(rows)[: len(COLUMNS)] == list(COLUMNS)
    assert rows["truth"].notna().all()
    assert (rows["estimate"].notna() == (rows["status"] == "ok")).all()
    assert (rows["abs_error"].notna() == (rows["status"] == "ok")).all()
    for q, said in enumerate(status):
        mine = rows[rows["query"] == q]
        assert set(mine["status"]) == {said}
        assert set(mine["frame"]) == {q + 10}
    assert set(rows["trial"]) == {3}
    assert set(rows["case"]) == {"gap=5"}


@pytest.mark.parametrize("name", TASKS)
def test_no_motion_is_wrong_by_the_whole_motion(name: str, rng: np.random.Generator) -> None:
    questions, _ = asked(name, rng)
    rows = no_motion_rows(make_task(name, "general"), questions)
    assert set(rows["method"]) == {"no_motion"}
    assert (rows["status"] == "ok").all()
    np.testing.assert_allclose(rows["abs_error"], rows["truth"].abs(), rtol=0, atol=1e-12)
    overall = rows["component"].isin(["angle", "distance"])
    np.testing.assert_allclose(rows.loc[overall, "estimate"], 0.0, atol=1e-12)


@pytest.mark.parametrize("name", TASKS)
def test_the_truth_has_no_error(name: str, rng: np.random.Generator) -> None:
    questions, _ = asked(name, rng)
    truth = questions.query.truth
    rows = error_rows(make_task(name, "general"), questions, "vmf", truth, np.full(len(truth), "ok"))
    assert (rows["abs_error"] < 1e-7).all()


def test_what_a_car_does_out_of_the_plane_is_no_error(rng: np.random.Generator) -> None:
    task = make_task("planar", "general")
    questions, _ = asked("planar", rng)
    pitched = np.array(questions.query.E_desired)
    pitched[:, :3, :3] = Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix() @ pitched[:, :3, :3]
    pitched[:, 2, 3] += 0.05
    query = Query(questions.query.initial, questions.query.desired, questions.query.E_initial, pitched)
    recorded = Asked("held_out", 0, questions.frame, questions.case, query)
    best = task.motion(task.coordinates(query.truth, query.E_initial), query.E_initial)
    assert np.abs(best - pitched @ inverse(query.E_initial)).max() > 0.01
    rows = error_rows(task, recorded, "vmf", best, np.full(len(best), "ok"))
    assert (rows["abs_error"] < 1e-7).all()
