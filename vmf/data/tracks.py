"""What the learner sees: motions of S and the pixels of tracked targets in both cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Tracks:
    """Tracked targets over N frames, M observations of K targets, sorted by target, then by frame.

    Attributes
    ----------
    times_ns : (N,) int64, frame times.
    E_S_from_W : (N, 4, 4) world to S at each frame (m).
    frame : (M,) int, frame index of each observation.
    target : (M,) int, target index of each observation.
    pixels : (M, 4) `x_L, y_L, x_R, y_R` (px); NaN in a camera that did not see the target.
    ids : (K,) names of the targets.
    image_size : (width, height) in px, or None when the data does not say.
    exact : (M, 4) the same pixels without noise, which only a simulation knows (px); None elsewhere. They
        are for learners that are asked what noise does (`learner.matrices`), no other looks at them.
    """

    times_ns: NDArray[np.int64]
    E_S_from_W: Floats
    frame: NDArray[np.int64]
    target: NDArray[np.int64]
    pixels: Floats
    ids: tuple[str, ...]
    image_size: tuple[int, int] | None = None
    exact: Floats | None = None

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.times_ns)

    @property
    def n_targets(self) -> int:
        """Number of targets."""
        return len(self.ids)

    def select_frames(self, first: int, last: int) -> Tracks:
        """Return the frames `first` .. `last` − 1 alone, with the targets' numbering kept."""
        return self.select(np.arange(first, min(last, self.n_frames)))

    def select(self, frames: NDArray[np.int64]) -> Tracks:
        """Return some frames (increasing indices), renumbered from 0, with the targets' numbering kept."""
        new = np.full(self.n_frames, -1)
        new[frames] = np.arange(len(frames))
        keep = new[self.frame] >= 0
        return Tracks(
            self.times_ns[frames],
            self.E_S_from_W[frames],
            new[self.frame[keep]],
            self.target[keep],
            self.pixels[keep],
            self.ids,
            self.image_size,
            None if self.exact is None else self.exact[keep],
        )


def from_dense(
    times_ns: NDArray[np.int64],
    E_S_from_W: Floats,
    pixels: Floats,
    ids: tuple[str, ...] | None = None,
    image_size: tuple[int, int] | None = None,
    exact: Floats | None = None,
) -> Tracks:
    """Build tracks from pixels (N, K, 4), NaN where a target is not seen, and the same without noise."""
    by_target = np.swapaxes(np.asarray(pixels, float), 0, 1)
    seen = ~np.isnan(by_target).all(axis=-1)
    target, frame = np.nonzero(seen)
    if ids is None:
        ids = tuple(str(i) for i in range(by_target.shape[0]))
    without = None if exact is None else np.swapaxes(exact, 0, 1)[seen]
    return Tracks(times_ns, E_S_from_W, frame, target, by_target[seen], ids, image_size, without)


@dataclass(frozen=True)
class TargetBatch:
    """B targets with up to m observations each, padded.

    Attributes
    ----------
    target : (B,) target indices.
    frame : (B, m) frame of each observation, −1 in the padding.
    pixels : (B, m, 4) px, NaN in the padding.
    """

    target: NDArray[np.int64]
    frame: NDArray[np.int64]
    pixels: Floats


def target_batches(tracks: Tracks, most_rows: int = 100_000) -> Iterator[TargetBatch]:
    """Yield all targets in batches of similar track length, of at most about `most_rows` observations."""
    targets, start, length = np.unique(tracks.target, return_index=True, return_counts=True)
    size = 2 ** np.ceil(np.log2(length)).astype(int)
    for m in np.unique(size):
        chosen = np.nonzero(size == m)[0]
        step = max(most_rows // int(m), 1)
        for begin in range(0, len(chosen), step):
            part = chosen[begin : begin + step]
            longest = int(length[part].max())
            column = np.arange(longest)
            padding = column >= length[part, None]
            index = np.where(padding, 0, start[part, None] + column)
            frame = np.where(padding, -1, tracks.frame[index])
            pixels = np.where(padding[..., None], np.nan, tracks.pixels[index])
            yield TargetBatch(targets[part], frame, pixels)
