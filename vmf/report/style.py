"""One look for every figure: sizes for print, colours for colour-blind readers and for greyscale."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, ParamSpec, cast

import numpy as np
from matplotlib import rc_context, rcParamsDefault
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, NullFormatter
from numpy.typing import NDArray

SINGLE_IN = 3.4
DOUBLE_IN = 7.0
DPI = 200

TEXT_PT = 8.0
SMALL_PT = 7.0
INK = "#222222"
GREY = "#595959"

# Okabe & Ito's palette.
BLACK = "#000000"
BLUE = "#0072B2"
VERMILLION = "#D55E00"
GREEN = "#009E73"
PURPLE = "#CC79A7"
ORANGE = "#E69F00"
SKY = "#56B4E9"
# Of Tol's muted palette, and a brown dark enough to be told from orange.
OLIVE = "#999933"
WINE = "#882255"
TEAL = "#44AA99"
BROWN = "#7A4B12"

Dashes = str | tuple[float, tuple[float, ...]]

# Matplotlib's own defaults first: what the user's matplotlibrc says must not change a published figure.
_DRAWING = re.compile(
    r"(axes|figure|font|grid|image|legend|lines|markers|mathtext|patch|path|pdf|savefig|text|[xy]axis|[xy]tick)\."
)

RC: dict[str, Any] = {
    **{key: rcParamsDefault[key] for key in rcParamsDefault if _DRAWING.match(key)},
    "font.family": "DejaVu Sans",
    "font.size": TEXT_PT,
    "text.usetex": False,
    "mathtext.fontset": "dejavusans",
    "axes.titlesize": TEXT_PT,
    "axes.labelsize": TEXT_PT,
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.6,
    "axes.unicode_minus": True,
    "axes.facecolor": "white",
    "figure.facecolor": "white",
    "figure.titlesize": TEXT_PT,
    "legend.fontsize": SMALL_PT,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "legend.columnspacing": 1.4,
    "xtick.labelsize": SMALL_PT,
    "ytick.labelsize": SMALL_PT,
    "savefig.dpi": DPI,
    "savefig.bbox": None,
    "savefig.facecolor": "white",
    "path.simplify": True,
    "pdf.fonttype": 42,
    "pdf.compression": 6,
}

P = ParamSpec("P")


def look() -> AbstractContextManager[None]:
    """Return a context that draws and saves in this style, whatever the user's matplotlibrc says."""
    return rc_context(cast(Any, RC))


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Make a drawing function use this style."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with look():
            return draw(*args, **kwargs)

    return drawn


@dataclass(frozen=True)
class MethodStyle:
    """How a method looks in every figure."""

    label: str
    color: str
    linestyle: Dashes
    marker: str
    linewidth: float = 1.1
    filled: bool = True

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments of `Axes.plot` for a line with markers."""
        return {
            "color": self.color,
            "linestyle": self.linestyle,
            "linewidth": self.linewidth,
            **self.point,
        }

    @property
    def open(self) -> MethodStyle:
        """The same look with open markers."""
        return replace(self, filled=False)

    @property
    def point(self) -> dict[str, Any]:
        """Keyword arguments of `Axes.plot` for the marker alone."""
        return {
            "marker": self.marker,
            "markersize": 3.6,
            "markerfacecolor": self.color if self.filled else "white",
            "markeredgecolor": self.color,
            "markeredgewidth": 0.8,
        }


METHODS: dict[str, MethodStyle] = {
    "vmf": MethodStyle("vmf", BLUE, "-", "o", linewidth=2.2),
    "triangulate_arun": MethodStyle("triangulate + Arun", VERMILLION, (0, (6, 1.5)), "s"),
    "pnp": MethodStyle("PnP", GREEN, (0, (6, 1.5, 1, 1.5)), "^"),
    "bundle": MethodStyle("bundle", PURPLE, "-", "D"),
    "cramer_rao": MethodStyle("Cramér–Rao bound", BLACK, (0, (3, 2)), ""),
    "no_motion": MethodStyle("no motion", GREY, (0, (1, 1.6)), "", linewidth=0.8),
    "odometry": MethodStyle("odometry", BROWN, "-", "", linewidth=0.9),
}

# What nobody answers: what answers are held against.
REFERENCES = ("cramer_rao", "no_motion", "odometry")

# Methods this file does not know yet still get a look of their own.
_SPARE = (
    MethodStyle("", ORANGE, (0, (8, 2)), "P"),
    MethodStyle("", SKY, (0, (4, 1, 1, 1, 1, 1)), "X"),
    MethodStyle("", OLIVE, (0, (5, 1)), "<"),
    MethodStyle("", WINE, (0, (2, 1)), ">"),
    MethodStyle("", TEAL, (0, (6, 1, 2, 1)), "*"),
)
# A rival with a stated calibration error keeps its colour; dash and an open marker tell it apart.
_VARIANT = (((0, (4, 1.5)), "D"), ((0, (2, 1)), "v"), ((0, (8, 1.5, 1, 1.5)), "p"), ((0, (1, 1)), "h"))


def method_styles(methods: Iterable[str]) -> dict[str, MethodStyle]:
    """Return the style of each method in drawing order: vmf, the rivals, the bound, no motion."""
    found: dict[str, MethodStyle] = {}
    variants: dict[str, int] = {}
    spare = 0
    for method in sorted(set(methods), key=_method_order):
        base, error = split_method(method)
        style = METHODS.get(base)
        if style is None:
            style = _SPARE[spare % len(_SPARE)]
            spare += 1
        if error and base == "vmf":
            # Another learned function is another method: a colour of its own.
            other = _SPARE[spare % len(_SPARE)]
            spare += 1
            style = MethodStyle(f"vmf ({error})", other.color, other.linestyle, other.marker)
        elif error:
            dashes, marker = _VARIANT[variants.get(base, 0) % len(_VARIANT)]
            variants[base] = variants.get(base, 0) + 1
            label = f"{style.label or base} ({error})"
            style = MethodStyle(label, style.color, dashes, marker, linewidth=1.0, filled=False)
        elif not style.label:
            style = MethodStyle(base, style.color, style.linestyle, style.marker)
        found[method] = style
    return found


def split_method(method: str) -> tuple[str, str]:
    """Split `bundle[focal=1%,rot=0.5deg]` into `bundle` and `focal 1 %, rot 0.5°`."""
    base, _, error = method.partition("[")
    error = error.rstrip("]").replace("=", " ").replace(",", ", ").replace("%", " %")
    return base, error.replace("deg", "°")


def natural_key(text: str) -> tuple[tuple[int, float, str], ...]:
    """Return a sort key that puts `gap=5` before `gap=20`."""
    parts = re.split(r"(\d+(?:\.\d+)?)", text)
    return tuple((0, float(p), "") if i % 2 else (1, 0.0, p) for i, p in enumerate(parts))


def _method_order(method: str) -> tuple[int, int, tuple[tuple[int, float, str], ...]]:
    base, error = split_method(method)
    known = list(METHODS)
    if base in REFERENCES:
        return 2, known.index(base), natural_key(error)
    return (0, known.index(base), natural_key(error)) if base in known else (1, 0, natural_key(method))


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure with an Agg canvas and constrained layout."""
    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05, wspace=0.03, hspace=0.03)
    figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def message_figure(sentence: str) -> Figure:
    """Return a figure that says in one sentence why there is nothing to draw."""
    text = "\n".join(textwrap.wrap(sentence, 50, break_long_words=False))
    figure = new_figure(SINGLE_IN, 0.4 + 0.16 * (1 + text.count("\n")))
    figure.text(0.5, 0.5, text, ha="center", va="center", color=INK)
    return figure


def dress(ax: Axes, grid: str = "both") -> None:
    """Give axes the common ticks and light grid; ticks are explicit because they are made when drawn."""
    ax.tick_params(which="both", labelsize=SMALL_PT, color=GREY, labelcolor=INK, width=0.6)
    ax.tick_params(which="major", length=3.0)
    ax.tick_params(which="minor", length=1.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    if grid in ("both", "x"):
        ax.xaxis.grid(True, which="major", color="#dddddd", linewidth=0.5)
    if grid in ("both", "y"):
        ax.yaxis.grid(True, which="major", color="#dddddd", linewidth=0.5)


def footnote(figure: Figure, text: str) -> None:
    """Write what the reader must know to read the figure below it, wrapped to its width."""
    figure.supxlabel(wrap(text, figure.get_figwidth()), x=0.01, ha="left", fontsize=SMALL_PT, color=GREY)


def wrap(text: str, width_in: float) -> str:
    """Break text at spaces so that it fits the width in the small font."""
    return "\n".join(textwrap.wrap(text, int(width_in * 18.5), break_long_words=False))


def heading(figure: Figure, text: str, handles: Sequence[Artist] = ()) -> None:
    """Write one line above the figure and, under it, one legend for all panels, outside every axes."""
    if not handles:
        figure.suptitle(text, x=0.01, ha="left", fontsize=TEXT_PT, color=INK)
        return
    longest = max(len(str(handle.get_label())) for handle in handles)
    columns = int((figure.get_figwidth() - 0.1) // (0.058 * longest + 0.52))
    columns = max(1, min(columns, len(handles)))
    rows = math.ceil(len(handles) / columns)
    box = figure.legend(
        handles=list(handles),
        title=text,
        title_fontsize=TEXT_PT,
        alignment="left",
        loc="outside upper left",
        ncols=math.ceil(len(handles) / rows),
        borderaxespad=0.3,
        borderpad=0.2,
    )
    box.get_title().set_color(INK)


def method_handle(style: MethodStyle) -> Line2D:
    """Return the legend entry of a method: line and marker as drawn."""
    return Line2D([], [], label=style.label, **style.line)


def log_limits(values: NDArray[np.float64], pad: float = 0.05) -> tuple[float, float] | None:
    """Return limits that hold every positive value and span at least half a decade, or None without any."""
    positive = values[np.isfinite(values) & (values > 0)]
    if positive.size == 0:
        return None
    low, high = math.log10(positive.min()), math.log10(positive.max())
    margin = max(pad * (high - low), (0.5 - (high - low)) / 2, 0.02)
    return 10 ** (low - margin), 10 ** (high + margin)


def log_axis(axis: Axis, limits: tuple[float, float], max_labels: int) -> None:
    """Make an axis logarithmic with the densest round labels that fit, whether it spans 0.5 or 12 decades."""
    ax = axis.axes
    if axis is ax.xaxis:
        ax.set_xscale("log")
        ax.set_xlim(limits)
    else:
        ax.set_yscale("log")
        ax.set_ylim(limits)
    ticks = log_ticks(*limits, max_labels)
    low, high = (math.floor(math.log10(v)) for v in limits)
    minor = [m * 10.0**e for e in range(low, high + 1) for m in range(1, 10)] if high - low <= 8 else []
    axis.set_major_locator(FixedLocator(ticks))
    axis.set_major_formatter(FixedFormatter(_tick_labels(ticks)))
    axis.set_minor_locator(FixedLocator([m for m in minor if limits[0] <= m <= limits[1] and m not in ticks]))
    axis.set_minor_formatter(NullFormatter())


def log_ticks(low: float, high: float, max_labels: int) -> list[float]:
    """Return at most `max_labels` round numbers in [low, high], the densest usual series that fits."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    best: list[float] = []
    for steps in ((1, 2, 3, 4, 5, 6, 7, 8, 9), (1, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        ticks = [float(f"{m}e{e}") for e in range(first, last + 1) for m in steps]
        best = [t for t in ticks if low <= t <= high]
        if len(best) <= max_labels:
            return best
    every = math.ceil(len(best) / max_labels)
    return [t for t in best if round(math.log10(t)) % every == 0]


def _tick_labels(ticks: Sequence[float]) -> list[str]:
    plain = all(1e-4 <= t < 1e5 for t in ticks)
    return [f"{t:g}" if plain else _power(t) for t in ticks]


def _power(value: float) -> str:
    exponent = math.floor(math.log10(value) + 1e-9)
    mantissa = round(value / 10.0**exponent)
    times = "" if mantissa == 1 else rf"{mantissa}{{\cdot}}"
    return rf"${times}10^{{{exponent}}}$"
