"""The epipolar geometry of a rig that nobody calibrated, learned from the matches themselves."""

from __future__ import annotations

import cv2
import numpy as np

from vmf.track.base import Bools, Floats

# A fundamental matrix has seven unknowns; this many matches, most of which agree, leave little to chance.
_LEAST, _SHARE = 30, 0.6
_MOST = 800
# Matches of one place in both images say the same thing again.
_CELL_PX = 12.0


class EpipolarGate:
    """Says which matches contradict the fundamental matrix that most matches so far agree on.

    The cameras of a rig do not move against each other, so that matches of all frames count. Nothing is
    assumed about rows of the images. Until enough is known no match contradicts.
    """

    def __init__(self, tolerance_px: float) -> None:
        """Accept matches up to `tolerance_px` from their epipolar lines, in either image."""
        self._tolerance_px = tolerance_px
        self._matches: dict[tuple[int, ...], Floats] = {}
        self._due = _LEAST
        self._F: Floats | None = None

    def learn(self, matches: Floats) -> None:
        """Take in matches (n, 4), right or wrong."""
        for match in matches[np.isfinite(matches).all(axis=1)]:
            cell = tuple(np.floor(match / _CELL_PX).astype(int).tolist())
            self._matches.pop(cell, None)
            self._matches[cell] = match
        while len(self._matches) > _MOST:
            del self._matches[next(iter(self._matches))]
            self._due -= 1
        if len(self._matches) >= self._due:
            self._due = len(self._matches) * 5 // 4
            self._estimate()

    @property
    def known(self) -> bool:
        """Whether enough is known to contradict anything."""
        return self._F is not None

    def agree(self, matches: Floats) -> Bools:
        """Return which of the matches (n, 4) do not contradict; one camera alone never does."""
        if self._F is None or not len(matches):
            return np.ones(len(matches), bool)
        return ~(distance_px(self._F, matches) > self._tolerance_px)

    def _estimate(self) -> None:
        known = np.array(list(self._matches.values()))
        F = fundamental(known, self._tolerance_px)
        if F is not None and np.mean(distance_px(F, known) <= self._tolerance_px) >= _SHARE:
            self._F = F


def fundamental(matches: Floats, tolerance_px: float) -> Floats | None:
    """Return the fundamental matrix (3, 3) that most matches (n, 4) agree on, None if there is none."""
    if len(matches) < 8:
        return None
    left, right = np.ascontiguousarray(matches[:, :2]), np.ascontiguousarray(matches[:, 2:])
    try:
        F, _ = cv2.findFundamentalMat(left, right, cv2.USAC_MAGSAC, tolerance_px, 0.999, 2000)
    except cv2.error:
        # OpenCV fails where next to no match is within the tolerance, instead of returning none.
        return None
    return None if F is None or F.shape != (3, 3) else np.asarray(F, float)


def distance_px(F: Floats, matches: Floats) -> Floats:
    """Return how far matches (n, 4) are from their epipolar lines, in the image where it is more (px)."""
    one = np.ones(len(matches))
    left = np.column_stack([matches[:, :2], one])
    right = np.column_stack([matches[:, 2:], one])
    in_right, in_left = left @ F.T, right @ F
    off = np.abs((right * in_right).sum(axis=1))
    lengths = np.linalg.norm(in_right[:, :2], axis=1), np.linalg.norm(in_left[:, :2], axis=1)
    return np.asarray(off / np.maximum(np.minimum(*lengths), 1e-12))
