"""A CMAC against analytic parameters: their numbering, which are constant, and how exact those are."""

from __future__ import annotations

import numpy as np
import pytest

from vmf.geometry import project
from vmf.spec.studies import CmacParametersStudy, StudiedCmac
from vmf.study import carry_out
from vmf.study.cmac_parameters import approximations, make_scene
from vmf.study.rig import rig_cameras

SMALL = CmacParametersStudy(points=300, tests=40, grid=4)
# The thesis prints this of constant parameters.
EXACT = 1e-10


def test_parameters_are_numbered_as_in_the_thesis() -> None:
    scene = make_scene(SMALL, SMALL.tilt_deg)
    (one, *_) = approximations(SMALL, scene)
    assert one.gauge == "thesis"
    M = rig_cameras(SMALL.rig, SMALL.tilt_deg).left
    for k in range(5):
        P = np.array([scene.x_m[k], SMALL.surface.y_m, scene.z_m[k]])
        x, y, z = M @ [*P, 1.0]
        # Eq. 3.8 and 3.15.
        N = np.stack([z * M[0] - x * M[2], z * M[1] - y * M[2], z * M[2]])
        o = N / N[2, 3]
        # Eq. 3.18.
        theta = [o[row, column] * P[axis] for row in range(3) for axis in range(3) for column in range(3)]
        blocks = [[*theta[9 * row : 9 * row + 9], *o[row]] for row in range(3)]
        np.testing.assert_allclose(one.true[k], np.concatenate(blocks), rtol=1e-10)


@pytest.mark.parametrize("gauge", ["thesis", "unit_depth"])
@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (5.0, 5.0, 5.0)], ids=["aligned", "tilted"])
def test_constant_parameters_are_exact_where_tiles_begin_with_a_visitor(
    gauge: str, tilt: tuple[float, float, float]
) -> None:
    scene = make_scene(SMALL, tilt)
    for one in approximations(SMALL, scene):
        if (one.gauge, one.new_tiles) != (gauge, "first_visit"):
            continue
        # Rows of c in the thesis gauge are camera entries: θ30–32 (Y = 1 m) and θ36–39 are always constant.
        if gauge == "thesis":
            assert one.constant[[29, 30, 31, 35, 36, 37, 38]].all()
        answered = ~np.isnan(one.found).any(axis=1)
        assert answered.sum() > 30
        assert np.abs(one.found - one.true)[answered][:, one.constant].max(initial=0.0) < EXACT


def test_what_is_listed_as_varying_varies_with_a_tilted_rig_and_not_with_an_aligned_one() -> None:
    listed = np.array(SMALL.parameters) - 1
    tilted, aligned = (
        next(approximations(SMALL, make_scene(SMALL, tilt))).constant[listed]
        for tilt in ((5.0, 5.0, 5.0), (0.0, 0.0, 0.0))
    )
    assert not tilted.any()
    zero = {2, 8, 14, 20, 27, 28, 33, 34}
    assert {k for k, constant in zip(SMALL.parameters, aligned, strict=True) if constant} == zero


def test_points_are_on_the_surface_and_seen_where_they_are() -> None:
    scene = make_scene(SMALL, SMALL.tilt_deg)
    surface = SMALL.surface
    assert np.abs(scene.x_m).max() <= surface.width_m / 2
    assert surface.near_m <= scene.z_m.min()
    assert scene.z_m.max() <= surface.near_m + surface.depth_m
    P = np.stack([scene.x_m, np.full_like(scene.x_m, surface.y_m), scene.z_m], axis=-1)
    for side, M in enumerate(rig_cameras(SMALL.rig, SMALL.tilt_deg).M):
        pixels, _ = project(M, P)
        np.testing.assert_allclose(scene.test[0][:, 2 * side : 2 * side + 2], pixels)


def test_a_cmac_of_one_pixel_knows_only_where_it_has_been() -> None:
    few = SMALL.model_copy(update={"points": 3, "cmac": StudiedCmac(overlays=1, tile_px=1.0)})
    found = {(q.quantity, q.case): q.value for q in carry_out(few).quantities}
    assert found["answered_share", "thesis"] == 0.0
    assert not any(name.startswith("relative_error") for name, _ in found)


def test_finer_overlays_come_closer() -> None:
    def median(cmac: StudiedCmac) -> float:
        result = carry_out(SMALL.model_copy(update={"cmac": cmac, "points": 2000}))
        return next(
            q.value
            for q in result.quantities
            if (q.quantity, q.case, q.component) == ("relative_error_median", "unit_depth", "theta_1")
        )

    assert median(StudiedCmac()) < 0.5 * median(StudiedCmac(overlays=2, tile_px=128.0))


def test_histograms_say_how_many_errors_lie_beyond_their_ends() -> None:
    more = {"points": 1000, "tests": 100, "parameters": (1, 2, 3), "other_tilt_deg": None}
    settings = SMALL.model_copy(update=more)
    result = carry_out(settings)
    table = result.tables["parameters"]
    drawn = table[table["case"].isin(settings.gauges)]
    error = np.abs(drawn["cmac"] - drawn["analytic"]) / np.abs(drawn["analytic"])
    low, high = int((error < 1e-5).sum()), int((error > 10).sum())
    assert min(low, high) > 0
    (figure,) = (draw() for draw in result.drawings.values())
    said = figure.get_supxlabel().replace("\n", " ")
    assert f"first bins also hold {low} errors below 1e-05, their last {high} above 10." in said
