"""Pictures for simulated surfaces: random textures, coloured discs, tags, boards."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.data.images import Image

Floats = NDArray[np.float64]

TILE_PX = 256
TAG_CELLS = 8  # six of the marker, and a white margin of one all around
_CELL_PX = TILE_PX // TAG_CELLS
BOARD = (9, 6)
_SQUARE_PX = 24

_COARSEST, _SMALLEST_PX, _SHAPES_PER_MEGAPIXEL = 4, 6.0, 1500


def random_texture(rng: np.random.Generator, size_px: int, dark: int, bright: int) -> Image:
    """Return a grey texture (size, size, 3) with detail at every scale: noise in octaves, and shapes."""
    picture = np.zeros((size_px, size_px), np.float32)
    cells = _COARSEST
    while cells <= size_px // 2:
        octave = rng.standard_normal((cells, cells)).astype(np.float32)
        picture += cv2.resize(octave, (size_px, size_px), interpolation=cv2.INTER_CUBIC)
        cells *= 2
    grey = np.clip(127 + 30 * picture, 0, 255).astype(np.uint8)
    shapes = grey.copy()
    smallest, largest = np.log([_SMALLEST_PX, max(size_px / 12, 2 * _SMALLEST_PX)])
    for _ in range(max(20, round(_SHAPES_PER_MEGAPIXEL * size_px**2 / 2**20))):
        reach = np.exp(rng.uniform(smallest, largest))
        corners = rng.uniform(0, size_px, 2) + reach * rng.standard_normal((4, 2))
        outline = cv2.convexHull(corners.astype(np.float32)).astype(np.int32)
        cv2.fillConvexPoly(shapes, outline, (int(rng.integers(0, 256)),))
    grey = np.asarray(cv2.addWeighted(shapes, 0.7, grey, 0.3, 0.0), np.uint8)
    scaled = dark + grey.astype(np.float32) * ((bright - dark) / 255)
    return np.repeat(np.rint(scaled).astype(np.uint8)[..., None], 3, axis=2)


def plain(shade: int) -> Image:
    """Return an even grey picture."""
    return np.full((16, 16, 3), shade, np.uint8)


def blob(hue: float) -> tuple[Image, Floats]:
    """Return a disc of one hue (0 to 1) on a grey plate, and its centre (1, 2) in pixels."""
    colour = cv2.cvtColor(np.array([[[round(179 * hue), 230, 220]]], np.uint8), cv2.COLOR_HSV2RGB)[0, 0]
    middle = (TILE_PX - 1) / 2
    v, u = np.mgrid[:TILE_PX, :TILE_PX] - middle
    inside = np.hypot(u, v) <= 0.42 * TILE_PX
    picture = np.where(inside[..., None], colour, np.uint8(170))
    return picture.astype(np.uint8), np.array([[middle, middle]])


def tag(number: int) -> tuple[Image, Floats]:
    """Return an ArUco marker (4x4_50) with a white margin, and its corners (4, 2) in pixels.

    The corners go around clockwise from the top left, as OpenCV reports them.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    inner_px = (TAG_CELLS - 2) * _CELL_PX
    picture = np.full((TILE_PX, TILE_PX), 230, np.uint8)
    marker = cv2.aruco.generateImageMarker(dictionary, number, inner_px)
    picture[_CELL_PX : _CELL_PX + inner_px, _CELL_PX : _CELL_PX + inner_px] = np.where(marker > 0, 230, 20)
    # Edges lie between pixels.
    low, high = _CELL_PX - 0.5, _CELL_PX + inner_px - 0.5
    corners = np.array([[low, low], [high, low], [high, high], [low, high]])
    return np.repeat(picture[..., None], 3, axis=2), corners


def chessboard() -> tuple[Image, Floats]:
    """Return a board with a white margin, and its inner corners (rows · columns, 2) in pixels, row by row."""
    columns, rows = BOARD
    squares = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    board = np.kron(np.where(squares == 0, 20, 230), np.ones((_SQUARE_PX, _SQUARE_PX))).astype(np.uint8)
    margin = _SQUARE_PX
    side = board.shape[1] + 2 * margin
    picture = np.full((side, side), 230, np.uint8)
    top = (side - board.shape[0]) // 2
    picture[top : top + board.shape[0], margin : margin + board.shape[1]] = board
    u = margin + _SQUARE_PX * np.arange(1, columns + 1) - 0.5
    v = top + _SQUARE_PX * np.arange(1, rows + 1) - 0.5
    corners = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return np.repeat(picture[..., None], 3, axis=2), corners
