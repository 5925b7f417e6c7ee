"""Images in a spec: which topics carry them, who tracks what they show, and how simulated ones look."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field, PositiveInt

from vmf.spec.base import Model, NonNegative, Positive, Ratio

# x, y of the top-left corner, width and height, in pixels of the left image.
# No image is larger than this on a side, and no tracker follows more targets than this.
_LARGEST_PX, _MOST_TARGETS = 16_384.0, 10_000
_Place = Annotated[float, Field(ge=-_LARGEST_PX, le=_LARGEST_PX)]
# Residuals of pixels are not known better than to the lower one; no match is off by more than the upper one.
_Tolerance = Annotated[float, Field(ge=0.01, le=_LARGEST_PX)]
_Size = Annotated[Positive, Field(le=_LARGEST_PX)]
_Targets = Annotated[PositiveInt, Field(le=_MOST_TARGETS)]
Region = tuple[_Place, _Place, _Size, _Size]
# How images are drawn, wherever a spec says so.
TargetWidth = Annotated[Positive, Field(le=1000.0)]
Blur = Annotated[NonNegative, Field(le=100.0)]
ImageNoise = Annotated[NonNegative, Field(le=255.0)]
ArucoDictionary = Literal[
    "4x4_50",
    "4x4_100",
    "4x4_250",
    "4x4_1000",
    "5x5_50",
    "5x5_100",
    "5x5_250",
    "5x5_1000",
    "6x6_50",
    "6x6_100",
    "6x6_250",
    "6x6_1000",
    "7x7_50",
    "7x7_100",
    "7x7_250",
    "7x7_1000",
    "original",
    "mip_36h12",
]


class _Coloured(Model):
    """A target of one colour, told from the rest by its histogram of hue and saturation.

    `regions` (in the left image's first frame) show one target each; without any, the `targets` most
    conspicuous blobs that both images show are taken. A target lost in both images and found again by its
    colour alone is a new id, or the same if `refound: same_id` vouches for it.
    """

    regions: tuple[Region, ...] = ()
    """x, y, width and height of each target."""
    targets: _Targets = 1
    """How many blobs, without regions."""
    min_similarity: Ratio = 0.6
    """Below this likeness of colours, a target is lost."""
    epipolar_px: _Tolerance = 6.0
    """How far matches may be off the epipolar line."""
    refound: Literal["new_id", "same_id"] = "new_id"
    """Id of what was lost and found again."""


class MeanshiftTracker(_Coloured):
    """Mean shift of a window of constant size over the colour's back-projection: the thesis's tracker."""

    kind: Literal["meanshift"] = "meanshift"


class CamshiftTracker(_Coloured):
    """Mean shift with a window that follows the target's size."""

    kind: Literal["camshift"] = "camshift"


class KltTracker(Model):
    """Corners followed by Lucas and Kanade's method, each aligned with its first look in both images."""

    kind: Literal["klt"] = "klt"
    regions: tuple[Region, ...] = ()
    """Where corners are looked for, as x, y, width and height; by default everywhere."""
    corners: _Targets = 80
    """How many are followed at most."""
    spacing_px: _Size = 12.0
    """Least distance between corners."""
    round_trip_px: Positive = 0.7
    """Followed there and back, a corner may be off by so much."""
    min_similarity: Ratio = 0.85
    """Least correlation with its first look."""
    epipolar_px: _Tolerance = 1.5
    """How far matches may be off the epipolar line."""


class SiftTracker(Model):
    """SIFT features matched between the images wherever they lie, and over time by their descriptors.

    A feature not seen for more than `memory_frames` frames is forgotten: what looks like it later is new.
    With `void_after_m` it is kept instead until the robot has travelled so far since it was last seen, and
    found again by its look (the thesis's keypoint database, which took 3 m); of more than 5000 features,
    those not seen for longest are forgotten.
    """

    kind: Literal["sift"] = "sift"
    regions: tuple[Region, ...] = ()
    """Where features are looked for, as x, y, width and height; by default everywhere."""
    features: _Targets = 400
    """How many at most."""
    ratio: Ratio = 0.8
    """Lowe's ratio: the second-best match has to be so much worse."""
    min_similarity: Ratio = 0.8
    """Least correlation with its first look."""
    epipolar_px: _Tolerance = 1.5
    """How far matches may be off the epipolar line."""
    memory_frames: PositiveInt = 30
    """See above."""
    void_after_m: Positive | None = None
    """See above."""


class ArucoTracker(Model):
    """Corners of ArUco tags, named `tag/corner`; `ids` keeps only some of the tags."""

    kind: Literal["aruco"] = "aruco"
    dictionary: ArucoDictionary = "4x4_50"
    """Which tags."""
    ids: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    """By default all."""
    min_similarity: Ratio = 0.5
    """Least likeness of a tag with its pattern."""


class AprilTagTracker(Model):
    """Corners of AprilTags, named `tag/corner`; `ids` keeps only some of the tags."""

    kind: Literal["apriltag"] = "apriltag"
    family: Literal["36h11", "36h10", "25h9", "16h5"] = "36h11"
    """Which tags."""
    ids: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    """By default all."""
    min_similarity: Ratio = 0.6
    """Least likeness of a tag with its pattern."""


class ChessboardTracker(Model):
    """Inner corners of a chessboard, named `row/column`; `columns` and `rows` count inner corners."""

    kind: Literal["chessboard"] = "chessboard"
    columns: Annotated[int, Field(ge=3, le=100)] = 9
    """Inner corners across."""
    rows: Annotated[int, Field(ge=3, le=100)] = 6
    """Inner corners down."""


Tracker = Annotated[
    MeanshiftTracker
    | CamshiftTracker
    | KltTracker
    | SiftTracker
    | ArucoTracker
    | AprilTagTracker
    | ChessboardTracker,
    Field(discriminator="kind"),
]
# Those whose targets a simulation knows the points of.
TargetTracker = Annotated[
    MeanshiftTracker | CamshiftTracker | ArucoTracker | ChessboardTracker,
    Field(discriminator="kind"),
]
# What they follow, as `RenderedImages.targets` names it.
FOLLOWED: dict[str, str] = {
    "meanshift": "blob",
    "camshift": "blob",
    "aruco": "tag",
    "chessboard": "chessboard",
}
TRACKER_MODELS: dict[str, type[Model]] = {
    str(model.model_fields["kind"].default): model for model in get_args(get_args(Tracker)[0])
}


class ImageSource(Model):
    """The image topics of a stereo pair and the tracker that turns them into tracks.

    A topic left out is found where the recording leaves no doubt. Images are paired by their time stamps,
    each with the nearest of the other camera within `pair_tolerance_s`.
    """

    left: str | None = None
    """Topic of the left camera."""
    right: str | None = None
    """Topic of the right camera."""
    tracker: Tracker = KltTracker()
    """Who finds and follows the targets."""
    pair_tolerance_s: Annotated[Positive, Field(le=3600.0)] = 0.01
    """Between two images of a pair."""


class RenderedImages(Model):
    """How `vmf simulate --images` draws what the cameras see.

    Every target is a flat square of `size_m` (left out: as large as the targets' distances allow) that faces
    the cameras at the start pose. It shows one coloured `blob`, an ArUco `tag` (4x4_50, the target's number),
    a random `texture`, or a `chessboard` of 9 by 6 inner corners. `distortion` is radial, k1 and k2.
    Brightness is multiplied by `exposure`, and by a random walk over time with steps of `exposure_drift`;
    `noise` is in grey levels.
    """

    targets: Literal["blob", "tag", "texture", "chessboard"] = "texture"
    """What a target looks like."""
    background: Literal["texture", "plain"] = "texture"
    """What is behind them."""
    size_m: TargetWidth | None = None
    """Width of a target."""
    distortion: tuple[float, float] = (0.0, 0.0)
    """k1 and k2 of both lenses."""
    blur_px: Blur = 0.5
    """Standard deviation of the blur."""
    noise: ImageNoise = 2.0
    """Standard deviation of the noise, in grey levels."""
    exposure: Annotated[Positive, Field(le=255.0)] = 1.0
    """Factor on the brightness."""
    exposure_drift: Ratio = 0.0
    """Step of its random walk, each frame."""
    format: Literal["jpeg", "png"] = "jpeg"
    """How images are compressed."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] = 95
    """Of `jpeg`."""
