"""What the figures of several studies share: lines of many sorts that stay apart in print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from vmf.report.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION

_COLORS = (VERMILLION, ORANGE, SKY, GREEN, PURPLE, BLACK, GREY, BLUE)
_MARKERS = ("s", "P", "X", "^", "D", "v", "h", "o")
_DASHES: tuple[Any, ...] = ((0, (6, 1.5)), (0, (4, 1.5)), (0, (2, 1)), "-")


def line_styles(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return keyword arguments of `Axes.plot` for each name; the last one is a thick line."""
    styles: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(names):
        last = k == len(names) - 1
        place = len(_COLORS) - 1 if last else k % (len(_COLORS) - 1)
        styles[name] = {
            "color": _COLORS[place],
            "marker": _MARKERS[place],
            "markersize": 3.6,
            "linestyle": "-" if last else _DASHES[k % len(_DASHES)],
            "linewidth": 2.0 if last else 1.1,
        }
    return styles
