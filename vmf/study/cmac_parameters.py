"""A CMAC's approximation of analytic visuomotor parameters (§5.4.2, Figs. A.1–A.18)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vmf.approximate import Cmac
from vmf.errors import Loss
from vmf.estimate import in_gauge
from vmf.geometry import in_view, stereo_code
from vmf.spec.studies import CmacParametersStudy, Surface
from vmf.study.result import Quantity, StudyResult, mean_quantity
from vmf.study.rig import rig_cameras
from vmf.tasks import make_task

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# A parameter whose range over the surface is this small beside its size is a constant, but for rounding.
_CONSTANT = 1e-9
# Parameters a row of `a, b, c`, in the order of Eq. 3.18.
_PER_ROW = 13


@dataclass(frozen=True)
class Approximation:
    """Parameters of all test points and of a grid, in one gauge.

    Attributes
    ----------
    gauge, new_tiles : which.
    true, found : (M, 39) at the test points, NaN where the CMAC refuses.
    true_grid, found_grid : (G, G, 39) on the surface, by Z and X.
    constant : (39,) which do not vary over the surface.
    """

    gauge: str
    new_tiles: str
    true: Floats
    found: Floats
    true_grid: Floats
    found_grid: Floats
    constant: Bools

    @property
    def relative_error(self) -> Floats:
        """Errors (M', 39) over the true values, at the test points that have an answer."""
        answered = ~np.isnan(self.found).any(axis=1)
        true, found = self.true[answered], self.found[answered]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.abs(found - true) / np.abs(true))

    @property
    def constant_error(self) -> Floats:
        """Largest errors (39,) at the test points that have an answer, NaN for what varies."""
        worst = np.nanmax(np.abs(self.found - self.true), axis=0, initial=0.0)
        return np.where(self.constant, worst, np.nan)


@dataclass(frozen=True)
class Scene:
    """Points of the surface, the codes that both cameras have of them, and unit-depth parameters.

    Attributes
    ----------
    train, test, grid : codes (N, 4), (M, 4), (G², 4) in px.
    rows : of each, parameters (·, 3, 13) of the left camera, unit-depth gauge.
    x_m, z_m : (M,) where the test points are.
    visible_share : share of the training points that both images show.
    """

    train: tuple[Floats, Floats]
    test: tuple[Floats, Floats]
    grid: tuple[Floats, Floats]
    x_m: Floats
    z_m: Floats
    visible_share: float


def cmac_parameters(settings: CmacParametersStudy) -> StudyResult:
    """Train a CMAC with analytic parameters of random points of a surface, and ask it about others."""
    from vmf.study.figures.cmac_parameters import draw_parameters

    scene = make_scene(settings, settings.tilt_deg)
    found = list(approximations(settings, scene))
    quantities = [Quantity("visible_share", scene.visible_share, n=settings.points)]
    for one in found:
        quantities += _quantities(settings, one, "")
    losses = [loss for one in found for loss in _unanswered(one, "")]
    if settings.other_tilt_deg is not None:
        for one in approximations(settings, make_scene(settings, settings.other_tilt_deg)):
            quantities += _quantities(settings, one, ", other rig")
            losses += _unanswered(one, ", other rig")
    drawn = [one for one in found if one.new_tiles == settings.new_tiles[0]]
    drawings = {
        f"parameters_{'_'.join(map(str, group))}": partial(draw_parameters, settings, scene, drawn, group)
        for group in _groups(settings.parameters)
    }
    tables = {"parameters": _table(settings, scene, found)}
    return StudyResult(tuple(quantities), tables, drawings, losses=tuple(losses))


def make_scene(settings: CmacParametersStudy, tilt_deg: tuple[float, float, float]) -> Scene:
    """Return random points of the surface, and a grid over it, as a rig sees them."""
    rng = np.random.default_rng(settings.seed)
    cameras, task = rig_cameras(settings.rig, tilt_deg), make_task("six_dof")
    surface, G = settings.surface, settings.grid

    def seen(P: Floats) -> tuple[Floats, Floats]:
        codes, _ = stereo_code(cameras, P)
        return codes, task.parameters(cameras.left, P)

    P_train, P_test = (_random_points(surface, n, rng) for n in (settings.points, settings.tests))
    x, z = np.meshgrid(*(np.linspace(0.0, 1.0, G),) * 2)
    P_grid = _points(surface, x.ravel(), z.ravel())
    size = (settings.rig.width_px, settings.rig.height_px)
    visible = in_view(*stereo_code(cameras, P_train), size)
    share = float(np.mean(visible))
    return Scene(seen(P_train), seen(P_test), seen(P_grid), P_test[:, 0], P_test[:, 2], share)


def _random_points(surface: Surface, n: int, rng: np.random.Generator) -> Floats:
    return _points(surface, *rng.random((2, n)))


def _points(surface: Surface, across: Floats, ahead: Floats) -> Floats:
    """Return points (n, 3) of the surface from shares of its width and depth."""
    x = surface.width_m * (across - 0.5)
    z = surface.near_m + surface.depth_m * ahead
    return np.stack([x, np.full_like(x, surface.y_m), z], axis=-1)


def approximations(settings: CmacParametersStudy, scene: Scene) -> Iterator[Approximation]:
    """Yield what CMACs make of the scene, one for each way to begin a tile and each gauge."""
    rest = make_task("six_dof").identity_lift
    for new_tiles in settings.new_tiles:
        for gauge in settings.gauges:
            train, test, grid = (
                in_gauge(rows, gauge, rest).reshape(len(rows), -1)
                for _, rows in (scene.train, scene.test, scene.grid)
            )
            cmac = Cmac(**settings.cmac.model_dump(), new_tiles=new_tiles)
            cmac.partial_fit(scene.train[0], train)
            shape = (settings.grid, settings.grid, -1)
            yield Approximation(
                gauge,
                new_tiles,
                test,
                cmac.predict(scene.test[0]).parameters,
                grid.reshape(shape),
                cmac.predict(scene.grid[0]).parameters.reshape(shape),
                np.ptp(train, axis=0) <= _CONSTANT * np.abs(train).max(axis=0),
            )


def _unanswered(one: Approximation, suffix: str) -> list[Loss]:
    """Return the loss of all test points, if none of them has an answer."""
    if len(one.relative_error):
        return []
    why = "no test point has an answer: none is near enough to those of training"
    return [Loss(_case(one) + suffix, why, len(one.true))]


def _case(one: Approximation) -> str:
    return one.gauge if one.new_tiles == "first_visit" else f"{one.gauge}, {one.new_tiles} tiles"


def _quantities(settings: CmacParametersStudy, one: Approximation, suffix: str) -> list[Quantity]:
    case, n = _case(one) + suffix, settings.tests
    error, constant = one.relative_error, one.constant_error
    answered = len(error)
    found = [
        Quantity("answered_share", answered / n, case, n=n),
        Quantity("constant_parameters", float(one.constant.sum()), case, n=len(constant)),
    ]
    if answered and one.constant.any():
        found.append(Quantity("constant_error_max", float(np.nanmax(constant)), case, n=answered))
    for k in settings.parameters if answered else ():
        component = f"theta_{k}"
        if one.constant[k - 1]:
            found.append(Quantity("constant_error", float(constant[k - 1]), case, component, n=answered))
            continue
        mine = error[:, k - 1]
        found.append(mean_quantity("relative_error_mean", mine, case, component))
        for name, share in (("relative_error_median", 0.5), ("relative_error_p95", 0.95)):
            found.append(Quantity(name, float(np.quantile(mine, share)), case, component, n=answered))
    return found


def _table(settings: CmacParametersStudy, scene: Scene, found: list[Approximation]) -> pd.DataFrame:
    """Return one row per test point, gauge and parameter shown."""
    parts = []
    for one in found:
        for k in settings.parameters:
            true, value = one.true[:, k - 1], one.found[:, k - 1]
            columns = {"case": _case(one), "parameter": k, "x_m": scene.x_m, "z_m": scene.z_m}
            parts.append(pd.DataFrame({**columns, "analytic": true, "cmac": value}))
    return pd.concat(parts, ignore_index=True)


def _groups(parameters: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Return at most three parameters a figure, as the thesis shows them."""
    return [parameters[k : k + 3] for k in range(0, len(parameters), 3)]
