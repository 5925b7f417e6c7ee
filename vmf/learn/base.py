"""What every learner of the visuomotor function offers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate import Prediction
from vmf.data.track_log import TrackLog
from vmf.data.tracks import Tracks
from vmf.estimate import Cameras
from vmf.estimate.noise import Noise
from vmf.learn.manifold import VisibleManifold
from vmf.tasks import Task

Floats = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Answer:
    """Parameters Θ_S at stereo codes.

    Attributes
    ----------
    rows : (M, 2, 3, k+1) `a, b, c` of the left and the right function; NaN where refused.
    support : (M,) how much data stands behind each answer, in the approximator's unit; 0 for none.
    own : (M,) codes visited in training that answer with their own target's parameters: these hold for the
        code as it was observed, noise and all.
    """

    rows: Floats
    support: Floats
    own: NDArray[np.bool_]

    @classmethod
    def approximated(cls, rows: Floats, support: Floats) -> Answer:
        """Return an answer in which no code's parameters are its own."""
        return cls(rows, support, np.zeros(len(support), bool))


class Learner(ABC):
    """Learns Θ_S from tracks, block by block, and answers any time.

    Attributes
    ----------
    task : the task space.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        self._log = TrackLog()
        self._manifold: VisibleManifold | None = None

    @property
    def tracks(self) -> Tracks | None:
        """Everything observed so far, None before the first block."""
        return self._log.tracks

    @property
    def n_observations(self) -> int:
        """How many observations of targets there were so far."""
        return len(self._log.frame)

    def partial_fit(self, block: Tracks) -> None:
        """Learn from further frames of the same targets.

        Raises
        ------
        ValueError : a pose is not finite.
        """
        if not np.isfinite(block.E_S_from_W).all():
            raise ValueError("a pose of the block is not finite")
        self._log.append(block)
        self._manifold = None
        self._learn(block)

    @abstractmethod
    def _learn(self, block: Tracks) -> None:
        """Take in a block that `tracks` already holds, at its end."""

    @abstractmethod
    def parameters(self, codes: ArrayLike, cameras: Cameras = "both") -> Answer:
        """Answer stereo codes (M, 4) in px; of cameras that are not wanted there may be nothing."""

    def _answer(self, prediction: Prediction, own: NDArray[np.bool_] | None = None) -> Answer:
        """Return an approximator's prediction as rows; one that was taught nothing refuses all codes."""
        n = len(prediction.support)
        shape = (n, 2, 3, self.task.n_lift + 1)
        if prediction.parameters.shape[1] != np.prod(shape[1:]):
            return Answer.approximated(np.full(shape, np.nan), np.zeros(n))
        own = np.zeros(n, bool) if own is None else own
        return Answer(prediction.parameters.reshape(shape), prediction.support, own)

    def rectified(self, pixels: Floats) -> Floats:
        """Return pixels (…, 4) as pinhole cameras would have them: as they are, but where a lens is learned.

        What a learner is asked about is asked in these pixels.
        """
        return pixels

    def y_right(self, q: Floats) -> Floats:
        """Return the row `y_R` (M,) in the right image of targets at `(x_L, y_L, x_R)` (M, 3), px (§6.3)."""
        if self._manifold is None:
            pixels = np.zeros((0, 4)) if self.tracks is None else self.tracks.pixels
            self._manifold = VisibleManifold(pixels[np.isfinite(pixels).all(axis=1)])
        return self._manifold.y_right(q)

    @abstractmethod
    def condition(self, code: ArrayLike) -> float:
        """Return the condition number of the equations behind the parameters of a code (4,)."""

    @property
    @abstractmethod
    def noise(self) -> Noise | None:
        """How pixels scatter, as the training residuals have it; None if unknown."""

    @property
    def refused(self) -> str | None:
        """Why nothing can be learned from what was observed, in words; None where something was."""
        return None

    @property
    @abstractmethod
    def losses(self) -> tuple[str, ...]:
        """What of the data could not be used, in words with counts."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that make an equal learner with `restore`."""
        tracks = self.tracks
        return {} if tracks is None else _pack(tracks)

    def restore(self, state: Arrays) -> None:
        """Take over the arrays of `state`."""
        if "tracks.frame" in state:
            self.partial_fit(_unpack(state))


def _pack(tracks: Tracks) -> dict[str, NDArray[Any]]:
    values = {f.name: getattr(tracks, f.name) for f in fields(tracks)}
    values["ids"] = np.array(tracks.ids, dtype=str)
    values["image_size"] = np.array(tracks.image_size or (0, 0), dtype=np.int64)
    if tracks.exact is None:
        del values["exact"]
    return {f"tracks.{name}": np.asarray(value) for name, value in values.items()}


def _unpack(state: Arrays) -> Tracks:
    values: dict[str, Any] = {
        f.name: np.array(state[f"tracks.{f.name}"])
        for f in fields(Tracks)
        if f.name != "exact" or "tracks.exact" in state
    }
    values["ids"] = tuple(str(i) for i in values["ids"])
    size = tuple(int(v) for v in values["image_size"])
    if len(size) != 2:
        raise ValueError(f"tracks.image_size has {len(size)} numbers, expected 2")
    values["image_size"] = size if size != (0, 0) else None
    tracks = Tracks(**values)
    n, m = len(tracks.times_ns), len(tracks.frame)
    shapes = {"times_ns": (n,), "E_S_from_W": (n, 4, 4), "frame": (m,), "target": (m,), "pixels": (m, 4)}
    if "exact" in values:
        shapes["exact"] = (m, 4)
    for name, shape in shapes.items():
        if values[name].shape != shape:
            raise ValueError(f"tracks.{name} has shape {values[name].shape}, expected {shape}")
    for name, end in (("frame", n), ("target", len(tracks.ids))):
        index = values[name]
        if index.dtype.kind not in "iu" or ((index < 0) | (index >= end)).any():
            raise ValueError(f"tracks.{name} is not an index below {end}")
    return tracks
