"""Studies as a file names them: what is shown about the method itself, without training and asking."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PositiveInt

from vmf.spec.approximators import Displacement, Gauge, NewTiles, Step, TilePx
from vmf.spec.base import Model, Positive, Ratio
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


AnyStudy = Annotated[StereoCodesStudy | CmacParametersStudy, Field(discriminator="kind")]


class StudySpec(Model):
    """A study, complete: what a file leaves out takes the defaults written here."""

    name: str | None = None
    study: AnyStudy
