"""Studies as a file names them: what is shown about the method itself, without training and asking."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PositiveInt

from vmf.spec.base import Model, Positive

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


AnyStudy = Annotated[StereoCodesStudy, Field(discriminator="kind")]


class StudySpec(Model):
    """A study, complete: what a file leaves out takes the defaults written here."""

    name: str | None = None
    study: AnyStudy
