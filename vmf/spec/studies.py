"""Studies as a file names them: what is shown about the method itself, without training and asking."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PositiveInt, model_validator

from vmf.spec.approximators import (
    AnyApproximator,
    CmacApproximator,
    CmacLinearApproximator,
    CmacMultiresApproximator,
    Displacement,
    Gauge,
    KnnApproximator,
    LwrApproximator,
    NewTiles,
    PolynomialApproximator,
    RbfApproximator,
    Step,
    TilePx,
)
from vmf.spec.base import Drift, Model, NonNegative, Positive, Ratio
from vmf.spec.images import Blur, ImageNoise, TargetWidth
from vmf.spec.model import Rig, Vector3

Frames = Annotated[int, Field(ge=2, le=20_000)]
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Seed = Annotated[int, Field(ge=0)]
Angle = Annotated[float, Field(gt=-180.0, le=180.0)]
# Line cameras see less than half of the plane.
FieldOfView = Annotated[float, Field(gt=0.0, lt=180.0)]


def _distinct(values: Sequence[Any]) -> Sequence[Any]:
    """Refuse what is there twice: two results would have one name."""
    names = [getattr(value, "name", value) for value in values]
    for place, name in enumerate(names):
        if name in names[:place]:
            shown = name if isinstance(name, str | int | float) else dict(name)
            raise ValueError(f"found {shown} twice, values of their own are accepted")
    return values


Distinct = AfterValidator(_distinct)


class LineCamera(Model):
    """A camera of the plane: where it is, and where its axis points (90° is straight ahead)."""

    x_m: float
    """Where it is, across."""
    z_m: float = 0.0
    """Where it is, ahead."""
    heading_deg: Angle = 90.0
    """Where it looks."""


class LineRig(Model):
    """Two line cameras, of which the thesis draws three pairs (Figs. 4.1–4.3)."""

    name: Annotated[str, Field(min_length=1)]
    """Its name in tables and figures."""
    left: LineCamera
    """The left camera."""
    right: LineCamera
    """The right camera."""


class ImageSize(Model):
    """Width and height of both images, and overlays of their own if they have others than the rest."""

    width_px: Annotated[int, Field(ge=1, le=20_000)]
    """Width."""
    height_px: Annotated[int, Field(ge=1, le=20_000)]
    """Height."""
    overlays: Annotated[int, Field(ge=1, le=1024)] | None = None
    """By default the study's."""
    tile_px: TilePx | None = None
    """By default the study's."""


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
    """Pixels of a line camera."""
    field_of_view_deg: FieldOfView = 60.0
    """Angle that a line camera sees."""
    rigs: Annotated[tuple[LineRig, ...], Field(min_length=1, max_length=6), Distinct] = _THREE_RIGS
    """Pairs of line cameras."""
    images: Annotated[tuple[ImageSize, ...], Field(min_length=1), Distinct] = (
        ImageSize(width_px=320, height_px=240),
        ImageSize(width_px=640, height_px=480),
        ImageSize(width_px=20, height_px=20, overlays=4, tile_px=4.0),
    )
    """Sizes of images that are counted."""
    overlays: Annotated[int, Field(ge=1, le=1024)] = 32
    """Grids over each other, T."""
    tile_px: TilePx = 32.0
    """Width of a tile."""
    view_m: Positive = 2.0
    """How far ahead figures are drawn."""


class Surface(Model):
    """A horizontal rectangle in S: X across, Z ahead from `near_m` on, at one Y (camera axes: y is down)."""

    width_m: Positive = 3.0
    """Across."""
    depth_m: Positive = 3.0
    """Ahead."""
    near_m: Positive = 3.0
    """Where it begins, ahead."""
    y_m: float = 1.0
    """Its height, downwards."""


class StudiedCmac(Model):
    """The CMAC of a study: see `approximator: {kind: cmac}`."""

    overlays: PositiveInt = 32
    """As of `cmac`."""
    tile_px: TilePx = 32.0
    """As of `cmac`."""
    step: Step = 1.0
    """As of `cmac`."""
    displacement: Displacement = "diagonal"
    """As of `cmac`."""
    table_size: PositiveInt = 1 << 20
    """As of `cmac`."""
    epochs: PositiveInt = 1
    """As of `cmac`."""
    min_support: Ratio = 0.25
    """As of `cmac`."""


# θ1–3, 7–9, 14–16, 20–22, 27–29, 33–35 (Figs. A.1–A.18).
Parameter = Annotated[int, Field(ge=1, le=39)]
_SHOWN = tuple(first + k for first in (1, 7, 14, 20, 27, 33) for k in range(3))


class CmacParametersStudy(Model):
    """Analytic parameters of a surface's points against what a CMAC makes of them (§5.4.2, Figs. A.1–A.18).

    The rig is turned against S by `tilt_deg` (about x, then y, then z); once more, for the numbers alone, by
    `other_tilt_deg`. The first of `new_tiles` is drawn.
    """

    kind: Literal["cmac_parameters"] = "cmac_parameters"
    rig: Rig = Rig()
    """The cameras."""
    tilt_deg: Vector3 = (5.0, 5.0, 5.0)
    """How the cameras are turned against S."""
    other_tilt_deg: Vector3 | None = (0.0, 0.0, 0.0)
    """The same once more; `null` is not."""
    surface: Surface = Surface()
    """Where points lie."""
    points: Annotated[int, Field(ge=1, le=100_000)] = 1000
    """Points that are learned from."""
    tests: Annotated[int, Field(ge=1, le=100_000)] = 100
    """Points that are asked about."""
    cmac: StudiedCmac = StudiedCmac()
    """The CMAC."""
    new_tiles: Annotated[tuple[NewTiles, ...], Field(min_length=1), Distinct] = ("first_visit", "zero")
    """What a tile holds before its first update, each of these."""
    gauges: Annotated[tuple[Gauge, ...], Field(min_length=1), Distinct] = ("thesis", "unit_depth")
    """Scales of parameters, each of these."""
    parameters: Annotated[tuple[Parameter, ...], Field(min_length=1), Distinct] = _SHOWN
    """Numbers of the parameters that are shown, from 1."""
    grid: Annotated[int, Field(ge=2, le=200)] = 31
    """Points of a drawn surface, each way."""
    seed: Seed = 1
    """Of all random numbers."""


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
    """The cameras."""
    area_m: tuple[Positive, Positive] = (3.0, 4.0)
    """Size of where the base is driven, ahead and to the left."""
    heading_rad: Positive = 0.5
    """Largest heading while driven by hand."""
    posters: Annotated[int, Field(ge=1, le=200)] = 30
    """How many there are."""
    poster_m: TargetWidth = 0.6
    """Width of a poster."""
    blur_px: Blur = 1.0
    """Standard deviation of the blur of images."""
    image_noise: ImageNoise = 8.0
    """Standard deviation of the noise of images, in grey levels."""
    posters_low_m: Vector3 = (3.0, -4.0, -0.8)
    """Corner of the box of posters: ahead, left, up."""
    posters_high_m: Vector3 = (6.0, 4.0, 0.8)
    """The opposite corner."""
    frames: Annotated[int, Field(ge=2, le=100_000)] = 300
    """Views that are learned from."""
    frames_per_leg: Annotated[int, Field(ge=2)] = 25
    """Views from one place to the next."""
    drift_m_per_sqrt_m: Drift = 0.01
    """Random walk of positions by odometry."""
    drift_rad_per_sqrt_m: Drift = 0.01
    """Random walk of headings by odometry."""
    features: Annotated[int, Field(ge=10, le=10_000)] = 200
    """SIFT features of an image at most."""
    ratio: Annotated[float, Field(gt=0.0, le=1.0)] = 0.8
    """Lowe's ratio: the second-best match has to be so much worse."""
    void_after_m: Positive = 3.0
    """Features not seen for so much travel are void (the thesis took 3 m)."""
    runs: Annotated[int, Field(ge=1, le=1000)] = 8
    """How often it parks."""
    goal_m: tuple[float, float] = (-0.5, -1.5)
    """How far the base has to go, ahead and to the left."""
    goal_heading_rad: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    """How far it has to turn."""
    stop_m: Positive = 0.025
    """How near to the command it stops."""
    stop_rad: Positive = 0.025
    """The same, of its heading."""
    looks: Annotated[int, Field(ge=2, le=1000)] = 20
    """Views on the way of the first run."""
    seed: Seed = 1
    """Of all random numbers."""

    @model_validator(mode="after")
    def _goal_is_in_the_area(self) -> PlanarSiftStudy:
        if any(abs(go) >= side for go, side in zip(self.goal_m, self.area_m, strict=True)):
            raise ValueError(f"goal_m {self.goal_m} leaves an area of {self.area_m} from any start")
        if any(a > b for a, b in zip(self.posters_low_m, self.posters_high_m, strict=True)):
            raise ValueError("posters_low_m lies above posters_high_m")
        return self


class Box(Model):
    """Where points are drawn, in S (camera axes: x right, y down, z ahead)."""

    low_m: Vector3 = (-0.5, -0.5, 1.5)
    """Its lowest corner."""
    high_m: Vector3 = (0.5, 0.5, 2.5)
    """Its highest corner."""

    @model_validator(mode="after")
    def _low_is_below_high(self) -> Box:
        if any(low >= high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise ValueError(f"found low_m {self.low_m} not below high_m {self.high_m}")
        return self


class ApproximatorsStudy(Model):
    """Ways to make Θ_S out of visited codes, compared (§4.2): accuracy, memory, time and growth.

    They learn analytic parameters at codes of random points, the parameters with Gaussian noise of a share of
    their spread; the codes are exact. Errors are of parameters, and of pixels after motions of up to `move_m`
    and `turn_rad` on each axis. Times are ratios to the first approximator's, at `timed` codes; 0 takes none.
    """

    kind: Literal["approximators"] = "approximators"
    rig: Rig = Rig()
    """The cameras."""
    box: Box = Box()
    """Where points lie."""
    approximators: Annotated[tuple[AnyApproximator, ...], Field(min_length=1, max_length=12), Distinct] = (
        CmacApproximator(gauge="thesis"),
        CmacApproximator(new_tiles="first_visit"),
        CmacLinearApproximator(),
        CmacMultiresApproximator(),
        KnnApproximator(),
        LwrApproximator(),
        RbfApproximator(),
        PolynomialApproximator(),
    )
    """Who learns."""
    codes: Annotated[tuple[Count, ...], Field(min_length=1), Distinct] = (100, 300, 1000, 3000)
    """How many pairs they learn, each of these."""
    tests: Annotated[int, Field(ge=2, le=100_000)] = 400
    """Codes that are asked about."""
    noise: Annotated[tuple[NonNegative, ...], Field(min_length=1), Distinct] = (0.0, 0.05)
    """On the parameters, as a share of their spread, each of these."""
    move_m: Positive = 0.1
    """Largest translation on each axis."""
    turn_rad: Positive = 0.1
    """Largest rotation about each axis."""
    timed: Annotated[int, Field(ge=0, le=100_000)] = 1000
    """Codes at which times are taken; 0 takes none."""
    repeats: PositiveInt = 3
    """Times are medians of so many."""
    seed: Seed = 1
    """Of all random numbers."""


class Lattice(Model):
    """Codes of which B is made: `codes` drawn in a cube of `span_px`, of 1 to 4 dimensions."""

    dimensions: Literal[1, 2, 3, 4]
    """Of the codes."""
    span_px: Positive
    """Width of the cube."""
    codes: Annotated[int, Field(ge=1, le=20_000)]
    """How many."""


class KaczmarzStudy(Model):
    """The order in which a CMAC sees its pairs, and the rank of its equations (§4.2.4, §4.3.2).

    A CMAC learns the parameters of `points` random points, each visited `visits` times, again and again: in
    the order of their left pixel, in one random order, in a new one every time, and drawn at random.
    Targets are some that it can take on, or those with Gaussian noise of a share of their spread at every
    visit, which it cannot.
    """

    kind: Literal["kaczmarz"] = "kaczmarz"
    rig: Rig = Rig()
    """The cameras."""
    box: Box = Box()
    """Where points lie."""
    points: Annotated[int, Field(ge=2, le=10_000)] = 100
    """How many."""
    visits: Annotated[int, Field(ge=1, le=100)] = 3
    """How often each is seen."""
    noise: Positive = 0.1
    """On the parameters, as a share of their spread."""
    cmac: StudiedCmac = StudiedCmac()
    """The CMAC."""
    epochs: Annotated[int, Field(ge=2, le=10_000)] = 60
    """Passes over all pairs."""
    orders: Annotated[int, Field(ge=2, le=100)] = 4
    """Random orders that are tried."""
    lattices: Annotated[tuple[Lattice, ...], Field(min_length=1)] = (
        Lattice(dimensions=1, span_px=64.0, codes=400),
        Lattice(dimensions=2, span_px=32.0, codes=3000),
        Lattice(dimensions=4, span_px=12.0, codes=6000),
    )
    """Codes of which B is made."""
    rank_overlays: Annotated[tuple[PositiveInt, ...], Field(min_length=1), Distinct] = (2, 4, 8)
    """Overlays for ranks, each of these."""
    rank_tile_px: TilePx = 8.0
    """Width of a tile for ranks."""
    rank_displacement: Displacement = "diagonal"
    """How grids are shifted for ranks."""
    seed: Seed = 1
    """Of all random numbers."""

    @model_validator(mode="after")
    def _one_lattice_per_dimension(self) -> KaczmarzStudy:
        _distinct([f"dimensions: {lattice.dimensions}" for lattice in self.lattices])
        return self


class Training(Model):
    """What a function is learned from: simulated frames of random targets, of the same rig and box."""

    frames: Annotated[int, Field(ge=3, le=10_000)] = 300
    """Views that are learned from."""
    targets: Annotated[int, Field(ge=3, le=1000)] = 12
    """Targets in them."""
    travel_m: Vector3 = (0.5, 0.5, 0.5)
    """Half the width of where S moves, each axis."""
    angle_rad: Positive = 0.6
    """Largest rotation on each axis."""
    pixel_px: NonNegative = 3.0
    """Gaussian noise on every pixel coordinate."""


Source = Literal["analytic", "structured", "transport"]


class FeedbackStudy(Model):
    """The function used as feedback: its derivative at no motion is an interaction matrix (Ch. 6, §2.4.2).

    From `starts` poses within `travel_m` and `turn_rad` of the goal, velocities `λ J⁺ (s* − s)` are applied
    for `duration_s`, with parameters that are exact (`analytic`) or learned from noisy images (`structured`,
    `transport`). Images of the loop have the noises of `pixel_px`.
    """

    kind: Literal["feedback"] = "feedback"
    rig: Rig = Rig()
    """The cameras."""
    box: Box = Box()
    """Where targets lie."""
    targets: Annotated[int, Field(ge=3, le=100)] = 6
    """How many."""
    starts: Annotated[int, Field(ge=1, le=1000)] = 40
    """From how many poses."""
    travel_m: Positive = 0.3
    """How far from the goal these are, each axis."""
    turn_rad: Positive = 0.3
    """How far turned, each axis."""
    gains_per_s: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=6), Distinct] = (
        0.5,
        1.0,
        2.0,
    )
    """λ, each of these."""
    rate_hz: Positive = 20.0
    """Velocities per second."""
    duration_s: Positive = 8.0
    """How long."""
    pixel_px: Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=3), Distinct] = (0.0, 1.0)
    """Gaussian noise on every pixel coordinate, each of these."""
    sources: Annotated[tuple[Source, ...], Field(min_length=1), Distinct] = (
        "analytic",
        "structured",
        "transport",
    )
    """Where parameters are from."""
    training: Training = Training()
    """What learned parameters are learned from."""
    seed: Seed = 1
    """Of all random numbers."""


class Link(Model):
    """A link and the revolute joint before it, by Denavit and Hartenberg: R_z(q) T_z(d) T_x(a) R_x(α)."""

    d_m: float = 0.0
    """Along the joint's axis."""
    a_m: float = 0.0
    """To the next axis."""
    alpha_deg: Angle = 0.0
    """Twist to the next axis."""


class KinematicsError(Model):
    """What is wrong with the kinematics that a function over SE(3) is given; a function over joints has none.

    Every link's a and d are off by `length_m`, every twist by `twist_deg` and every joint's zero by
    `zero_rad`, all with alternating signs; `tool_m` moves S by as much on each axis. In training and after
    it, or, with `after_training`, only then: as when a tool has been changed or an arm calibrated anew.
    """

    name: Annotated[str, Field(min_length=1)]
    """Its name in tables and figures."""
    length_m: float = 0.0
    """Of every d and a."""
    twist_deg: float = 0.0
    """Of every twist."""
    zero_rad: float = 0.0
    """Of every joint's zero."""
    tool_m: float = 0.0
    """Of S, each axis."""
    after_training: bool = False
    """Whether training was without it."""


_THREE_LINKS = (
    Link(d_m=0.4, a_m=0.1, alpha_deg=-90.0),
    Link(d_m=0.1, a_m=0.35, alpha_deg=90.0),
    Link(d_m=0.15, a_m=0.2, alpha_deg=90.0),
)


class JointSpaceStudy(Model):
    """Parameters over the joint angles of an arm instead of SE(3): no kinematics needs to be known (Ch. 6).

    An arm carries the rig. Its joints move within `reach_rad` of `home_rad`, where they are in the first
    `home_visits` of the frames; `targets` points of the box (in S at home) are seen. Asked is which joint
    motion from home makes `question_targets` targets appear where they are seen: those of training, and
    others.
    """

    kind: Literal["joint_space"] = "joint_space"
    rig: Rig = Rig()
    """The cameras."""
    box: Box = Box()
    """Where targets lie."""
    links: Annotated[tuple[Link, ...], Field(min_length=1, max_length=4)] = _THREE_LINKS
    """The arm."""
    home_rad: tuple[float, ...] = (0.3, -1.3, 0.2)
    """Where questions start."""
    reach_rad: Annotated[float, Field(gt=0.0, le=3.0)] = 0.4
    """How far joints move from home."""
    targets: Annotated[int, Field(ge=1, le=200)] = 30
    """How many are learned from."""
    home_visits: PositiveInt = 20
    """Views at home."""
    frames: Annotated[tuple[Frames, ...], Field(min_length=1), Distinct] = (100, 300, 1000)
    """Views that are learned from, each of these."""
    pixel_px: NonNegative = 3.0
    """Gaussian noise on every pixel coordinate."""
    questions: Annotated[int, Field(ge=2, le=10_000)] = 200
    """How many are asked."""
    question_targets: PositiveInt = 2
    """Targets of each."""
    wrong: Annotated[tuple[KinematicsError, ...], Distinct] = (
        KinematicsError(name="lengths off by 5 cm", length_m=0.05),
        KinematicsError(name="zeros off by 0.1 rad", zero_rad=0.1),
        KinematicsError(name="tool changed by 10 cm", tool_m=0.1, after_training=True),
        KinematicsError(name="zeros changed by 0.1 rad", zero_rad=0.1, after_training=True),
    )
    """Errors of the kinematics for functions over SE(3)."""
    seed: Seed = 1
    """Of all random numbers."""

    @model_validator(mode="after")
    def _one_angle_per_link(self) -> JointSpaceStudy:
        if len(self.home_rad) != len(self.links):
            n = len(self.links)
            raise ValueError(f"home_rad: found {len(self.home_rad)} angles, {n} are accepted, one per link")
        return self

    @model_validator(mode="after")
    def _enough_of_each(self) -> JointSpaceStudy:
        if self.question_targets > self.targets:
            found = f"question_targets: found {self.question_targets}"
            raise ValueError(f"{found}, at most as many as targets ({self.targets}) are accepted")
        if self.home_visits >= min(self.frames):
            found = f"home_visits: found {self.home_visits}"
            raise ValueError(f"{found}, fewer than frames ({min(self.frames)}) are accepted")
        return self


AnyStudy = Annotated[
    StereoCodesStudy
    | CmacParametersStudy
    | ApproximatorsStudy
    | KaczmarzStudy
    | FeedbackStudy
    | JointSpaceStudy
    | PlanarSiftStudy,
    Field(discriminator="kind"),
]


class StudySpec(Model):
    """A study, complete: what a file leaves out takes the defaults written here."""

    name: str | None = None
    """Name of the run directory; by default the file's."""
    study: AnyStudy
    """What is shown."""
