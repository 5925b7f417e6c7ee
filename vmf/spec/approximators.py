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
    tile_px: TilePx = 32.0
    step: Step = 1.0
    displacement: Displacement = "diagonal"
    table_size: PositiveInt = 65536
    epochs: PositiveInt = 1
    min_support: Ratio = 0.25
    training: Literal["albus", "moving_average", "maximum_error", "partial_gram_schmidt", "randomised"] = (
        "albus"
    )
    window: PositiveInt = 8
    seed: Annotated[int, Field(ge=0)] = 1
    new_tiles: NewTiles = "zero"
    gauge: Gauge = "unit_depth"


class CmacLinearApproximator(Model):
    """A CMAC whose cells are affine functions of the code: wide tiles without a bias of first order."""

    kind: Literal["cmac_linear"] = "cmac_linear"
    overlays: PositiveInt = 32
    tile_px: TilePx = 192.0
    step: Step = 0.5
    displacement: Displacement = "uniform"
    table_size: PositiveInt = 65536
    epochs: PositiveInt = 4
    min_support: Ratio = 0.25
    new_tiles: NewTiles = "first_visit"
    gauge: Gauge = "unit_depth"


class CmacMultiresApproximator(Model):
    """CMACs of several tile widths, of which the finest that has been trained enough answers.

    That is one with `min_visits` pairs in at least a share `min_trained` of the code's tiles.
    """

    kind: Literal["cmac_multires"] = "cmac_multires"
    overlays: PositiveInt = 32
    tiles_px: Annotated[tuple[TilePx, ...], Field(min_length=1)] = (32.0, 64.0, 128.0)
    step: Step = 0.5
    displacement: Displacement = "diagonal"
    table_size: PositiveInt = 65536
    epochs: PositiveInt = 2
    min_support: Ratio = 0.25
    new_tiles: NewTiles = "first_visit"
    min_visits: NonNegative = 8.0
    min_trained: Ratio = 0.75
    gauge: Gauge = "unit_depth"


class KnnApproximator(Model):
    """The mean of the nearest visited codes' parameters, within `radius_px`.

    More than `max_pairs` visited codes are joined to means of cells of the stereo space.
    """

    kind: Literal["knn"] = "knn"
    neighbours: PositiveInt = 4
    averaging: Literal["inverse_distance", "uniform"] = "inverse_distance"
    radius_px: Positive = 64.0
    max_pairs: Capacity = 65536
    gauge: Gauge = "unit_depth"


class LwrApproximator(Model):
    """Locally weighted regression: an affine fit through the nearest visited codes, within `radius_px`.

    `bandwidth_px` is the standard deviation of the Gaussian weights; slopes in directions in which the
    neighbours spread by less than `ridge_px` are taken as zero. `max_pairs` is as of `knn`.
    """

    kind: Literal["lwr"] = "lwr"
    neighbours: PositiveInt = 64
    bandwidth_px: WidthPx = 64.0
    radius_px: Positive = 128.0
    ridge_px: Annotated[float, Field(ge=0.01)] = 0.3
    max_pairs: Capacity = 65536
    gauge: Gauge = "unit_depth"


class RbfApproximator(Model):
    """A network of Gaussian kernels at the means of the visited cells of the stereo space.

    `width_px` is the standard deviation of the kernels, `smoothing` the variance of a pair's noise over that
    of the function.
    """

    kind: Literal["rbf"] = "rbf"
    width_px: WidthPx = 256.0
    smoothing: Annotated[float, Field(ge=1e-6)] = 1e-3
    max_centres: Capacity = 1024
    gauge: Gauge = "unit_depth"


class PolynomialApproximator(Model):
    """A polynomial in the stereo code, by recursive least squares."""

    kind: Literal["polynomial"] = "polynomial"
    degree: Literal[1, 2, 3] = 2
    gauge: Gauge = "unit_depth"


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
