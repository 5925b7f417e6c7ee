"""Inner corners of a chessboard."""

from __future__ import annotations

import math
from itertools import count

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.spec.images import ChessboardTracker as Options
from vmf.track.base import Floats, Image, Sightings, Tracker, merged

_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE
# Detection takes some 40 bytes a pixel; beyond this it is done in a smaller image, and refined in the whole.
_MOST_PIXELS = 2**22
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-3)


class ChessboardTracker(Tracker):
    """Finds a board's inner corners, named `row/column`, in every image anew.

    The colours of its squares say which way round a board is whose numbers of columns and rows are one odd,
    one even. Another board looks the same turned by half; its corners keep their names while it is in sight,
    where it turns by less than a quarter between frames and from camera to camera. Lost and found again it
    has other names (`#1`, `#2`, … behind), for nothing proves which corner is which.
    """

    def __init__(self, options: Options) -> None:
        """Take the board that `options` describe."""
        super().__init__()
        self._size = options.columns, options.rows
        self._last: tuple[Floats | None, Floats | None] = (None, None)
        self._visits = count()
        self._suffix = ""

    def step(self, left: Image, right: Image) -> Sightings:
        first, second = self._both(self._board, (left, right))
        lost = self._last[0] is None and self._last[1] is None
        if lost and (first is not None or second is not None):
            visit = next(self._visits)
            self._suffix = f"#{visit}" if visit and self._ambiguous else ""
        before = self._last
        turned_left = self._turned(first, before[0], before[1])
        turned_right = self._turned(second, before[1], turned_left if before[0] is None else before[0])
        self._last = turned_left, turned_right
        return merged(self._named(turned_left, left), self._named(turned_right, right))

    @property
    def _ambiguous(self) -> bool:
        return sum(self._size) % 2 == 0

    def _board(self, image: Image) -> Floats | None:
        """Return the corners (rows, columns, 2) of a board that may be turned, None without one."""
        columns, rows = self._size
        corners = _detected(image, (columns, rows))
        if corners is None:
            return None
        board = corners.reshape(rows, columns, 2)
        across, down = board[0, -1] - board[0, 0], board[-1, 0] - board[0, 0]
        if across[0] * down[1] - across[1] * down[0] < 0.0:
            board = board[:, ::-1]  # nobody sees a board from behind
        if self._ambiguous:
            return board
        return board if _contrast(board, image) < 0.0 else board[::-1, ::-1]

    def _turned(self, board: Floats | None, *references: Floats | None) -> Floats | None:
        """Return a board with its corners in the order of the first reference there is."""
        if board is None:
            return None
        turns = [board, board[::-1, ::-1]] if self._ambiguous else [board]
        if self._ambiguous and self._size[0] == self._size[1]:
            turns += [np.rot90(turn) for turn in turns]
        reference = next((r for r in references if r is not None), None)
        # Without anything to go by the first row runs to the right.
        likeness = [
            _likeness(t, reference) if reference is not None else t[0, -1, 0] - t[0, 0, 0] for t in turns
        ]
        return turns[int(np.argmax(likeness))]

    def _named(self, board: Floats | None, image: Image) -> dict[str, tuple[Floats, float]]:
        if board is None:
            return {}
        quality = abs(_contrast(board, image))
        return {
            f"{row}/{column}{self._suffix}": (board[row, column], quality)
            for row in range(board.shape[0])
            for column in range(board.shape[1])
        }


def _detected(image: Image, size: tuple[int, int]) -> Floats | None:
    """Return the inner corners (columns · rows, 2) of a board, None without one."""
    smaller = math.ceil(math.sqrt(image.size / _MOST_PIXELS))
    if smaller == 1:
        found, corners = cv2.findChessboardCornersSB(image, size, flags=_FLAGS)
        return np.asarray(corners, float).reshape(-1, 2) if found else None
    # Sides of equal pieces, so that the middles of pixels can be told.
    shape = image.shape[1] // smaller, image.shape[0] // smaller
    whole = image[: shape[1] * smaller, : shape[0] * smaller]
    small = np.asarray(cv2.resize(whole, shape, interpolation=cv2.INTER_AREA), np.uint8)
    found, corners = cv2.findChessboardCornersSB(small, size, flags=_FLAGS)
    if not found:
        return None
    first = np.ascontiguousarray((np.asarray(corners) + 0.5) * smaller - 0.5, np.float32)
    reach = 2 * smaller, 2 * smaller
    return np.asarray(cv2.cornerSubPix(image, first, reach, (-1, -1), _STOP), float).reshape(-1, 2)


def _likeness(board: Floats, reference: Floats) -> float:
    """Return how much a board is turned like the reference, wherever they are."""
    a, b = board - board.mean(axis=(0, 1)), reference - reference.mean(axis=(0, 1))
    return float((a * b).sum())


def _contrast(board: Floats, image: Image) -> float:
    """Return how much a board (rows, columns, 2) looks like a white first square (1) or a black one (−1)."""
    rows, columns = board.shape[:2]
    across = np.gradient(board, axis=1) / 2
    down = np.gradient(board, axis=0) / 2
    around = np.stack(
        [board - across - down, board + across + down, board - across + down, board + across - down]
    )
    at = around.reshape(-1, 2).astype(np.float32)
    grey = cv2.remap(image, at[:, :1], at[:, 1:], cv2.INTER_LINEAR).astype(float).reshape(4, rows, columns)
    difference = grey[0] + grey[1] - grey[2] - grey[3]
    sign: NDArray[np.int64] = 1 - 2 * (np.add.outer(np.arange(rows), np.arange(columns)) % 2)
    return float((sign * difference).sum() / np.abs(difference).sum().clip(1e-12))
