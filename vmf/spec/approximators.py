"""The approximators of Θ_S as a spec names them: one model each, with the options of the constructor."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PositiveInt

from vmf.spec.base import Model, NonNegative, Positive, Ratio

Gauge = Literal["unit_depth", "thesis"]
Displacement = Literal["diagonal", "uniform"]
NewTiles = Literal["zero", "first_visit"]
Training = Literal["albus", "moving_average", "maximum_error", "partial_gram_schmidt", "randomised"]
TilePx = Annotated[float, Field(ge=1.0)]
# Of kernels: wide ones are nearly constant over any image.
WidthPx = Annotated[float, Field(ge=1.0, le=1e4)]
# Cells of the stereo space that are kept at most.
Capacity = Annotated[int, Field(ge=16)]
# ε of Eq. 4.8.
Step = Annotated[float, Field(gt=0.0, lt=2.0)]


class NoApproximator(Model):
    """Answers only visited codes, with their own parameters."""

    kind: Literal["none"] = "none"


class CmacApproximator(Model):
    """Albus's CMAC over the 4-D stereo space.

    `training` is how its weights are learned (§4.2.4): `albus` takes one pair after the other,
    `moving_average`, `maximum_error` and `partial_gram_schmidt` look back on the last `window` pairs, and
    `randomised` draws from the pairs it is given, by `seed`. A tile starts from `zero`, as in the thesis, or
    from its share of the parameters of its `first_visit`.
    """

    kind: Literal["cmac"] = "cmac"
    overlays: PositiveInt = 32
    """How many grids lie over each other, T."""
    tile_px: TilePx = 32.0
    """Width of a tile in each of the 4 coordinates."""
    step: Step = 1.0
    """ε of Eq. 4.8: how far an update goes."""
    displacement: Displacement = "diagonal"
    """How the grids are shifted against each other: along the diagonal (thesis), or spread evenly."""
    table_size: PositiveInt = 65536
    """Tiles kept at most; all share these slots by a hash."""
    epochs: PositiveInt = 1
    """Passes over the pairs."""
    min_support: Ratio = 0.25
    """Codes of which a smaller share of tiles was trained are refused."""
    training: Literal["albus", "moving_average", "maximum_error", "partial_gram_schmidt", "randomised"] = (
        "albus"
    )
    """See above."""
    window: PositiveInt = 8
    """Pairs that are looked back on."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of `randomised`."""
    new_tiles: NewTiles = "zero"
    """What a tile holds before its first update."""
    gauge: Gauge = "unit_depth"
    """In which scale parameters are kept: depth ratio 1 at no motion, or the thesis's constant entry 1."""


class CmacLinearApproximator(Model):
    """A CMAC whose cells are affine functions of the code: wide tiles without a bias of first order."""

    kind: Literal["cmac_linear"] = "cmac_linear"
    overlays: PositiveInt = 32
    """As of `cmac`."""
    tile_px: TilePx = 192.0
    """As of `cmac`."""
    step: Step = 0.5
    """As of `cmac`."""
    displacement: Displacement = "uniform"
    """As of `cmac`."""
    table_size: PositiveInt = 65536
    """As of `cmac`."""
    epochs: PositiveInt = 4
    """As of `cmac`."""
    min_support: Ratio = 0.25
    """As of `cmac`."""
    new_tiles: NewTiles = "first_visit"
    """As of `cmac`."""
    gauge: Gauge = "unit_depth"
    """As of `cmac`."""


class CmacMultiresApproximator(Model):
    """CMACs of several tile widths, of which the finest that has been trained enough answers.

    That is one with `min_visits` pairs in at least a share `min_trained` of the code's tiles.
    """

    kind: Literal["cmac_multires"] = "cmac_multires"
    overlays: PositiveInt = 32
    """As of `cmac`, for each width."""
    tiles_px: Annotated[tuple[TilePx, ...], Field(min_length=1)] = (32.0, 64.0, 128.0)
    """The widths, finest first."""
    step: Step = 0.5
    """As of `cmac`."""
    displacement: Displacement = "diagonal"
    """As of `cmac`."""
    table_size: PositiveInt = 65536
    """As of `cmac`, for each width."""
    epochs: PositiveInt = 2
    """As of `cmac`."""
    min_support: Ratio = 0.25
    """As of `cmac`."""
    new_tiles: NewTiles = "first_visit"
    """As of `cmac`."""
    min_visits: NonNegative = 8.0
    """Pairs that make a tile trained enough."""
    min_trained: Ratio = 0.75
    """Share of a code's tiles that have to be."""
    gauge: Gauge = "unit_depth"
    """As of `cmac`."""


class KnnApproximator(Model):
    """The mean of the nearest visited codes' parameters, within `radius_px`.

    More than `max_pairs` visited codes are joined to means of cells of the stereo space.
    """

    kind: Literal["knn"] = "knn"
    neighbours: PositiveInt = 4
    """How many at most."""
    averaging: Literal["inverse_distance", "uniform"] = "inverse_distance"
    """How they are weighed."""
    radius_px: Positive = 64.0
    """Farther codes do not count; without any near, a code is refused."""
    max_pairs: Capacity = 65536
    """Codes kept at most."""
    gauge: Gauge = "unit_depth"
    """As of `cmac`."""


class LwrApproximator(Model):
    """Locally weighted regression: an affine fit through the nearest visited codes, within `radius_px`.

    `bandwidth_px` is the standard deviation of the Gaussian weights; slopes in directions in which the
    neighbours spread by less than `ridge_px` are taken as zero. `max_pairs` is as of `knn`.
    """

    kind: Literal["lwr"] = "lwr"
    neighbours: PositiveInt = 64
    """How many at most."""
    bandwidth_px: WidthPx = 64.0
    """How fast weights fall off."""
    radius_px: Positive = 128.0
    """Farther codes do not count."""
    ridge_px: Annotated[float, Field(ge=0.01)] = 0.3
    """Spread below which there is no slope."""
    max_pairs: Capacity = 65536
    """Codes kept at most."""
    gauge: Gauge = "unit_depth"
    """As of `cmac`."""


class RbfApproximator(Model):
    """A network of Gaussian kernels at the means of the visited cells of the stereo space.

    `width_px` is the standard deviation of the kernels, `smoothing` the variance of a pair's noise over that
    of the function.
    """

    kind: Literal["rbf"] = "rbf"
    width_px: WidthPx = 256.0
    """Standard deviation of a kernel."""
    smoothing: Annotated[float, Field(ge=1e-6)] = 1e-3
    """More of it: smoother, and farther from the pairs."""
    max_centres: Capacity = 1024
    """Kernels at most."""
    gauge: Gauge = "unit_depth"
    """As of `cmac`."""


class PolynomialApproximator(Model):
    """A polynomial in the stereo code, by recursive least squares."""

    kind: Literal["polynomial"] = "polynomial"
    degree: Literal[1, 2, 3] = 2
    """2 is exact for a parallel rig in the unit-depth gauge."""
    gauge: Gauge = "unit_depth"
    """As of `cmac`."""


AnyApproximator = Annotated[
    NoApproximator
    | CmacApproximator
    | CmacLinearApproximator
    | CmacMultiresApproximator
    | KnnApproximator
    | LwrApproximator
    | RbfApproximator
    | PolynomialApproximator,
    Field(discriminator="kind"),
]
