"""Approximators of Θ_S, from visited codes to all codes (Chapter 4)."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from vmf.approximate.base import Approximator, Prediction
from vmf.approximate.cmac import Cmac
from vmf.approximate.cmac_linear import CmacLinear
from vmf.approximate.cmac_multires import CmacMultires
from vmf.approximate.knn import NearestNeighbours
from vmf.approximate.lwr import LocallyWeightedRegression
from vmf.approximate.none import Lookup
from vmf.approximate.polynomial import Polynomial
from vmf.approximate.rbf import RadialBasis
from vmf.approximate.tiling import Collisions, SlotTable, Tiling

APPROXIMATORS: Mapping[str, Callable[..., Approximator]] = MappingProxyType(
    {
        "none": Lookup,
        "cmac": Cmac,
        "cmac_linear": CmacLinear,
        "cmac_multires": CmacMultires,
        "knn": NearestNeighbours,
        "lwr": LocallyWeightedRegression,
        "rbf": RadialBasis,
        "polynomial": Polynomial,
    }
)


def make_approximator(kind: str, **options: Any) -> Approximator:
    """Return a new approximator by name, with the options of its constructor."""
    return APPROXIMATORS[kind](**options)


__all__ = [
    "APPROXIMATORS",
    "Approximator",
    "Cmac",
    "CmacLinear",
    "CmacMultires",
    "Collisions",
    "LocallyWeightedRegression",
    "Lookup",
    "NearestNeighbours",
    "Polynomial",
    "Prediction",
    "RadialBasis",
    "SlotTable",
    "Tiling",
    "make_approximator",
]
