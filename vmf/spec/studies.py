"""Studies as a file names them: what is shown about the method itself, without training and asking."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, PositiveInt, model_validator

from vmf.spec.approximators import Displacement, Gauge, NewTiles, Step, TilePx
from vmf.spec.base import Model, NonNegative, Positive, Ratio
from vmf.spec.model import Rig, Vector3

Seed = Annotated[int, Field(ge=0)]
Angle = Annotated[float, Field(gt=-180.0, le=180.0)]
# Line cameras see less than half of the plane.
FieldOfView = Annotated[float, Field(gt=0.0, lt=180.0)]


class LineCamera(Model):
    """A camera of the plane: where it is, and where its axis points (90° is straight ahead)."""

    x_m: float
    z_m: float = 0.0
    heading_deg: Angle = 90.0


class LineRig(Model):
    """Two line cameras, of which the thesis draws three pairs (Figs. 4.1–4.3)."""

    name: Annotated[str, Field(min_length=1)]
    left: LineCamera
    right: LineCamera


class ImageSize(Model):
    """Width and height of both images."""

    width_px: PositiveInt
    height_px: PositiveInt


_THREE_RIGS = (
    LineRig(name="identical", left=LineCamera(x_m=0.0), right=LineCamera(x_m=0.0)),
    LineRig(name="translated", left=LineCamera(x_m=-0.1), right=LineCamera(x_m=0.1)),
    LineRig(
        name="verged",
        left=LineCamera(x_m=-0.5, heading_deg=45.0),
        right=LineCamera(x_m=0.5, heading_deg=135.0),
    ),
)


class StereoCodesStudy(Model):
    """How many stereo codes two cameras can see, and how many tiles stand for them (§4.1, §5.1).

    Line cameras of `pixels` pixels are counted one by one; images of `images` have the bounds of §4.1 and
    the tiles of `overlays` overlays of `tile_px` squares.
    """

    kind: Literal["stereo_codes"] = "stereo_codes"
    pixels: Annotated[int, Field(ge=1, le=64)] = 4
    field_of_view_deg: FieldOfView = 60.0
    rigs: Annotated[tuple[LineRig, ...], Field(min_length=1, max_length=6)] = _THREE_RIGS
    images: Annotated[tuple[ImageSize, ...], Field(min_length=1)] = (
        ImageSize(width_px=320, height_px=240),
        ImageSize(width_px=640, height_px=480),
    )
    overlays: PositiveInt = 32
    tile_px: Annotated[float, Field(ge=1.0)] = 32.0
    view_m: Positive = 2.0


class Surface(Model):
    """A horizontal rectangle in S: X across, Z ahead from `near_m` on, at one Y (camera axes: y is down)."""

    width_m: Positive = 3.0
    depth_m: Positive = 3.0
    near_m: Positive = 3.0
    y_m: float = 1.0


class StudiedCmac(Model):
    """The CMAC of a study: see `approximator: {kind: cmac}`."""

    overlays: PositiveInt = 32
    tile_px: TilePx = 32.0
    step: Step = 1.0
    displacement: Displacement = "diagonal"
    table_size: PositiveInt = 1 << 20
    epochs: PositiveInt = 1
    min_support: Ratio = 0.25


# θ1–3, 7–9, 14–16, 20–22, 27–29, 33–35 (Figs. A.1–A.18).
_SHOWN = tuple(first + k for first in (1, 7, 14, 20, 27, 33) for k in range(3))


class CmacParametersStudy(Model):
    """Analytic parameters of a surface's points against what a CMAC makes of them (§5.4.2, Figs. A.1–A.18).

    The rig is turned against S by `tilt_deg` (about x, then y, then z); once more, for the numbers alone, by
    `other_tilt_deg`. The first of `new_tiles` is drawn.
    """

    kind: Literal["cmac_parameters"] = "cmac_parameters"
    rig: Rig = Rig()
    tilt_deg: Vector3 = (5.0, 5.0, 5.0)
    other_tilt_deg: Vector3 | None = (0.0, 0.0, 0.0)
    surface: Surface = Surface()
    points: Annotated[int, Field(ge=1, le=100_000)] = 1000
    tests: Annotated[int, Field(ge=1, le=100_000)] = 100
    cmac: StudiedCmac = StudiedCmac()
    new_tiles: Annotated[tuple[NewTiles, ...], Field(min_length=1)] = ("first_visit", "zero")
    gauges: Annotated[tuple[Gauge, ...], Field(min_length=1)] = ("thesis", "unit_depth")
    parameters: Annotated[tuple[Annotated[int, Field(ge=1, le=39)], ...], Field(min_length=1)] = _SHOWN
    grid: Annotated[int, Field(ge=2, le=200)] = 31
    seed: Seed = 1


class PlanarSiftStudy(Model):
    """A base that learns from SIFT features, then drives to a desired view in one command (§5.5).

    In its `area_m` (x ahead, y to the left, around the origin of W, as all places here) it sees square
    `posters` of `poster_m` with random textures between two corners, and a wall behind them, in images with
    `blur_px` and `image_noise` (grey levels). It is driven
    by hand for `frames`, `frames_per_leg` from one random place to the next, with headings up to
    `heading_rad`. In each of `runs` it stands at a random place, and has to go by `goal_m` and turn by
    `goal_heading_rad`; it stops where odometry is within `stop_m` and `stop_rad` of the command. Odometry
    drifts as with `noise` in an experiment. On the way of the first run it looks around `looks` times.
    """

    kind: Literal["planar_sift"] = "planar_sift"
    rig: Rig = Rig(width_px=320, height_px=240, fx_px=234.5, fy_px=236.0, cx_px=172.0, cy_px=127.5)
    area_m: tuple[Positive, Positive] = (3.0, 4.0)
    heading_rad: Positive = 0.5
    posters: Annotated[int, Field(ge=1, le=200)] = 30
    poster_m: Positive = 0.6
    blur_px: NonNegative = 1.0
    image_noise: NonNegative = 8.0
    posters_low_m: Vector3 = (3.0, -4.0, -0.8)
    posters_high_m: Vector3 = (6.0, 4.0, 0.8)
    frames: Annotated[int, Field(ge=2, le=100_000)] = 300
    frames_per_leg: Annotated[int, Field(ge=2)] = 25
    drift_m_per_sqrt_m: NonNegative = 0.01
    drift_rad_per_sqrt_m: NonNegative = 0.01
    features: Annotated[int, Field(ge=10, le=10_000)] = 200
    ratio: Annotated[float, Field(gt=0.0, le=1.0)] = 0.8
    void_after_m: Positive = 3.0
    runs: Annotated[int, Field(ge=1, le=1000)] = 8
    goal_m: tuple[float, float] = (-0.5, -1.5)
    goal_heading_rad: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    stop_m: Positive = 0.025
    stop_rad: Positive = 0.025
    looks: Annotated[int, Field(ge=2, le=1000)] = 20
    seed: Seed = 1

    @model_validator(mode="after")
    def _goal_is_in_the_area(self) -> PlanarSiftStudy:
        if any(abs(go) >= side for go, side in zip(self.goal_m, self.area_m, strict=True)):
            raise ValueError(f"goal_m {self.goal_m} leaves an area of {self.area_m} from any start")
        if any(a > b for a, b in zip(self.posters_low_m, self.posters_high_m, strict=True)):
            raise ValueError("posters_low_m lies above posters_high_m")
        return self


AnyStudy = Annotated[StereoCodesStudy | CmacParametersStudy | PlanarSiftStudy, Field(discriminator="kind")]


class StudySpec(Model):
    """A study, complete: what a file leaves out takes the defaults written here."""

    name: str | None = None
    study: AnyStudy
