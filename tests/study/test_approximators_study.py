"""Approximators compared: errors in pixels against projection, growth of memory, ratios of times."""

from __future__ import annotations

import numpy as np
import pytest

from vmf.errors import InputError
from vmf.geometry import stereo_code
from vmf.spec.approximators import CmacApproximator, KnnApproximator, PolynomialApproximator
from vmf.spec.model import Rig
from vmf.spec.studies import ApproximatorsStudy, Box
from vmf.study import carry_out
from vmf.study.approximators import _pixels, labels
from vmf.study.rig import rig_cameras, visible_points
from vmf.tasks import make_task

SMALL = ApproximatorsStudy(codes=(60, 240), tests=40, timed=0)


Values = dict[tuple[str, str, str], float]


def values(settings: ApproximatorsStudy) -> Values:
    return {(q.quantity, q.case, q.component): q.value for q in carry_out(settings).quantities}


@pytest.fixture(scope="module")
def found() -> Values:
    return values(SMALL)


def test_predicted_pixels_are_those_of_moved_points(rng: np.random.Generator) -> None:
    cameras, task = rig_cameras(Rig()), make_task("six_dof")
    P = visible_points(Box(), Rig(), 10, rng)
    E = task.motion(rng.uniform(-0.1, 0.1, (10, 6)), np.eye(4))
    moved = np.einsum("nij,nj->ni", E[:, :3, :3], P) + E[:, :3, 3]
    expected = (stereo_code(cameras, moved)[0] - stereo_code(cameras, P)[0])[:, :2]
    rows = task.parameters(cameras.left, P)
    np.testing.assert_allclose(_pixels(rows.reshape(10, -1), task.lift(E)), expected, atol=1e-8)


def test_what_is_a_polynomial_is_found_by_it_and_by_no_other(found: Values) -> None:
    exact = 1e-6
    assert found["prediction_error_median", "polynomial", "codes=240"] < exact
    for label in ("cmac_linear", "knn", "lwr", "rbf"):
        assert found["prediction_error_median", label, "codes=240"] > 1e3 * exact
    # Noise cannot make anyone better than exact, and averaging more of it helps.
    noisy = [found["prediction_error_median", "polynomial, noise 5 %", f"codes={n}"] for n in SMALL.codes]
    assert noisy[0] > noisy[1] > exact


def test_memory_of_neighbours_grows_with_the_codes_and_that_of_a_polynomial_does_not(found: Values) -> None:
    assert found["memory_growth_exponent", "polynomial", ""] == 0.0
    assert found["memory_growth_exponent", "knn", ""] == pytest.approx(1.0, abs=0.01)
    cmac = [case for name, case, _ in found if name == "memory_growth_exponent" and case.startswith("cmac")]
    assert len(cmac) == 4
    # Codes share tiles, the more so the more there are.
    assert all(0.0 < found["memory_growth_exponent", case, ""] < 0.9 for case in cmac)


def test_more_codes_answer_more_and_better(found: Values) -> None:
    for label in labels(SMALL.approximators):
        few, many = (found["answered_share", label, f"codes={n}"] for n in SMALL.codes)
        assert many >= few
    # The others first answer what is near, and then what is farther away.
    for label in ("knn", "lwr", "rbf", "polynomial"):
        few, many = (found["parameter_error", label, f"codes={n}"] for n in SMALL.codes)
        assert many < few


def test_times_are_ratios_to_the_first() -> None:
    models = (CmacApproximator(), KnnApproximator())
    small = {"codes": (20,), "tests": 5, "noise": (0.0,), "timed": 20, "repeats": 1}
    timed = SMALL.model_copy(update={"approximators": models, **small})
    found = values(timed)
    for quantity in ("time_training_ratio", "time_asking_ratio"):
        ratios = {case: v for (name, case, _), v in found.items() if name == quantity}
        assert list(ratios) == ["cmac", "knn"]
        assert ratios["cmac"] == 1.0
        assert min(ratios.values()) > 0.0


def test_labels_tell_approximators_of_one_kind_apart() -> None:
    models = (CmacApproximator(), CmacApproximator(tile_px=16.0), PolynomialApproximator())
    assert list(labels(models)) == ["cmac (32.0)", "cmac (16.0)", "polynomial"]


def test_a_box_that_no_image_shows_is_an_input_error() -> None:
    behind = Box(low_m=(-1.0, -1.0, -3.0), high_m=(1.0, 1.0, -2.0))
    with pytest.raises(InputError, match=r"study\.box: found 0 of"):
        carry_out(SMALL.model_copy(update={"box": behind}))
