"""Approximators of Θ_S, from visited codes to all codes (Chapter 4)."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from vmf.approximate.base import Approximator, Prediction
from vmf.approximate.cmac import Cmac
from vmf.approximate.none import Lookup
from vmf.approximate.polynomial import Polynomial
from vmf.approximate.tiling import Collisions, SlotTable, Tiling

APPROXIMATORS: Mapping[str, Callable[..., Approximator]] = MappingProxyType(
    {"none": Lookup, "cmac": Cmac, "polynomial": Polynomial}
)


def make_approximator(kind: str, **options: Any) -> Approximator:
    """Return a new approximator by name, with the options of its constructor."""
    return APPROXIMATORS[kind](**options)


__all__ = [
    "APPROXIMATORS",
    "Approximator",
    "Cmac",
    "Collisions",
    "Lookup",
    "Polynomial",
    "Prediction",
    "SlotTable",
    "Tiling",
    "make_approximator",
]
