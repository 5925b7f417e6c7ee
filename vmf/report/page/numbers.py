"""Numbers as a reader wants them."""

from __future__ import annotations

import math
from collections.abc import Sequence


def short(value: float | None) -> str:
    """Return three significant digits, all of a whole number, a power of ten if tiny, a dash for none."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == int(value) and abs(value) < 1e12:
        return f"{int(value):,}".replace(",", "\u202f")
    if abs(value) < 1e-4:
        mantissa, exponent = f"{value:.1e}".split("e")
        return f"{mantissa}·10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    if abs(value) >= 1000:
        return f"{round(value):,}".replace(",", "\u202f")
    return f"{value:#.3g}".rstrip(".")


_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_unit(value: float | None, unit: str) -> str:
    """Return the number and its unit, kept on one line."""
    return f"{short(value)}\u00a0{unit}" if unit and value is not None else short(value)


def printed(value: float) -> str:
    """Return a number with the digits that the thesis printed it with."""
    if value >= 1000:
        return short(value)
    return short(value) if value < 1e-4 else f"{value:g}"


def listed(items: Sequence[str]) -> str:
    """Return `a, b and c`."""
    return " and ".join([*([", ".join(items[:-1])] if len(items) > 1 else []), *items[-1:]])
