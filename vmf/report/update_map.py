"""Where in both images tiles were updated (Figs. 5.6, 5.12)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from vmf.report.style import DOUBLE_IN, GREY, TEXT_PT, dress, footnote, message_figure, new_figure, styled

Counts = NDArray[np.int64]
Floats = NDArray[np.float64]

_WIDE = 2.0


@styled
def update_map(
    pixels: ArrayLike, image_size: tuple[int, int], tile_px: float, overlays: int | None = None
) -> Figure:
    """Draw how many times a tile covering each pixel was updated, for the left and the right image.

    Parameters
    ----------
    pixels : (M, 4) `x_L, y_L, x_R, y_R` (px); a row with a NaN is no stereo code and updates nothing.
    image_size : (width, height) in px.
    tile_px : width of a tile (px).
    overlays : number of overlays, displaced along the diagonal; by default one per pixel of a tile.
    """
    seen = np.asarray(pixels, dtype=np.float64).reshape(-1, 4)
    codes = seen[np.isfinite(seen).all(axis=1)]
    if len(codes) == 0:
        return message_figure("No target was seen by both cameras: no tile was updated.")
    maps = [update_counts(codes[:, c : c + 2], image_size, tile_px, overlays) for c in (0, 2)]
    width, height = image_size
    # Images much wider than high stand above each other: beside each other they are too low for a bar.
    if width > _WIDE * height:
        figure = new_figure(DOUBLE_IN, 1.6 + 2 * 5.2 * height / width)
        axes = [figure.add_subplot(2, 1, i) for i in (1, 2)]
    else:
        figure = new_figure(DOUBLE_IN, 1.0 + 2.66 * height / width)
        axes = [figure.add_subplot(1, 2, i) for i in (1, 2)]
    top = max(1, *(int(m.max()) for m in maps))
    for ax, counts, side in zip(axes, maps, ("left", "right"), strict=True):
        _show(ax, counts, top)
        ax.set_title(f"{side} image", fontsize=TEXT_PT)
        ax.set_xlabel(f"$x_{side[0].upper()}$ (px)")
        ax.set_ylabel(f"$y_{side[0].upper()}$ (px)")
    # An inset keeps the bar as high as the image, whatever its aspect.
    bar = figure.colorbar(axes[1].images[0], cax=axes[1].inset_axes((1.03, 0.0, 0.035, 1.0)))
    bar.set_label("count (updates)")
    bar.ax.tick_params(labelsize=7, width=0.6, length=3)
    bar.outline.set_visible(False)
    _note(figure, len(codes), len(seen) - len(codes), tile_px, overlays)
    return figure


def update_counts(
    points: ArrayLike, image_size: tuple[int, int], tile_px: float, overlays: int | None = None
) -> Counts:
    """Count, for every pixel (height, width), the updates of tiles over it made by points (M, 2).

    Overlay k of T is a grid of `tile_px` squares displaced by k·tile_px/T along both axes; a point updates
    the one square of each overlay that it lies in, and with it every pixel whose centre the square holds.
    """
    width, height = image_size
    xy = np.asarray(points, dtype=np.float64)
    n = overlays if overlays is not None else max(1, round(tile_px))
    total = np.zeros((height, width), dtype=np.int64)
    for k in range(n):
        shift = k * tile_px / n
        column, row = (_tile(np.arange(size, dtype=np.float64), shift, tile_px) for size in (width, height))
        at = _tile(xy, shift, tile_px) - (column[0], row[0])
        n_columns, n_rows = column[-1] - column[0] + 1, row[-1] - row[0] + 1
        inside = ((at >= 0) & (at < (n_columns, n_rows))).all(axis=1)
        flat = at[inside, 1] * n_columns + at[inside, 0]
        tiles = np.bincount(flat, minlength=n_rows * n_columns).reshape(n_rows, n_columns)
        total += tiles[(row - row[0])[:, None], column - column[0]]
    return total


def _tile(coordinate: Floats, shift: float, tile_px: float) -> Counts:
    return np.floor((coordinate - shift) / tile_px).astype(np.int64)


def _show(ax: Axes, counts: Counts, top: int) -> None:
    dress(ax, grid="none")
    ax.spines[:].set_visible(True)
    ax.imshow(counts, cmap="viridis", vmin=0, vmax=top, interpolation="nearest", origin="upper")
    ax.tick_params(color=GREY)


def _note(figure: Figure, n_codes: int, n_lost: int, tile_px: float, overlays: int | None) -> None:
    n = overlays if overlays is not None else max(1, round(tile_px))
    lost = f"; {n_lost:,} more were seen by one camera only and updated none" if n_lost else ""
    footnote(figure, f"{n_codes:,} stereo points, each in one tile of {tile_px:g} px of {n} overlays{lost}.")
