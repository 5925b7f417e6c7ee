"""`engine: compressed`: Algorithm 1's least-squares state without its N(N−1) updates (§4)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vmf.estimate import update_rank_k
from vmf.geometry import inverse
from vmf.learn.base import Arrays, Floats
from vmf.learn.pairs import centre_factors, observation_rows
from vmf.learn.pipeline import CHUNK, Ints, PipelineLearner


class CompressedPipeline(PipelineLearner):
    """Keeps one running factor per target and forms a tile's factor only when it is asked for."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        n = 3 * (self.task.n_lift + 1)
        self._R_w = np.zeros((0, 2, n, n))
        # Poses and pixels count from those of each target's first centre, for the sake of rounding; only
        # pan-tilt poses, which do not close, stay absolute (C3).
        self._E_ref = np.zeros((0, 4, 4))
        self._u_ref = np.zeros((0, 2, 2))

    def state(self) -> dict[str, NDArray[Any]]:
        return {**super().state(), "R_w": self._R_w.copy()}

    def restore(self, state: Arrays) -> None:
        super().restore(state)
        # Learned in other blocks, the factors differ in their last bits.
        R_w = np.array(state["R_w"], float)
        if R_w.shape != self._R_w.shape:
            raise ValueError(f"R_w has shape {R_w.shape}, expected {self._R_w.shape}")
        self._R_w = R_w

    def _update(self, first: int) -> None:
        centres = self.centres
        target = centres.target[first:]
        if not len(target):
            return
        self._grow(int(target.max()) + 1)
        begins = first + np.nonzero(centres.rank[first:] == 0)[0]
        self._E_ref[centres.target[begins]] = centres.E[begins] if self.task.closed else np.eye(4)
        self._u_ref[centres.target[begins]] = centres.u[begins]
        x_bar = self.task.lift(centres.E[first:] @ inverse(self._E_ref[target]))
        w = observation_rows(x_bar, centres.u[first:] - self._u_ref[target])
        for t in np.unique(target):
            self._R_w[t] = update_rank_k(self._R_w[t], np.moveaxis(w[target == t], 1, 0))

    def _grow(self, n_targets: int) -> None:
        more = max(n_targets - len(self._R_w), 0)
        self._R_w = np.concatenate([self._R_w, np.zeros((more, *self._R_w.shape[1:]))])
        self._E_ref = np.concatenate([self._E_ref, np.tile(np.eye(4), (more, 1, 1))])
        self._u_ref = np.concatenate([self._u_ref, np.zeros((more, 2, 2))])

    def _centre_factors(self, which: Ints) -> Floats:
        target = self.centres.target[which]
        E_c = self.centres.E[which] @ inverse(self._E_ref[target])
        u_c = self.centres.u[which] - self._u_ref[target]
        return centre_factors(self.task, self._R_w[target], E_c, u_c)

    def _factors(self, slots: Ints) -> Floats:
        if self.table is None:
            return self._centre_factors(slots)
        # Tiles that cover the same centres share one factor.
        groups: dict[tuple[int, ...], list[int]] = {}
        for i, slot in enumerate(slots.tolist()):
            groups.setdefault(tuple(self.centres.of_slot[slot]), []).append(i)
        out = np.empty((len(slots), *self._R_w.shape[1:]))
        for centres, members in groups.items():
            out[members] = self._stacked(np.array(centres, np.int64))
        return out

    def _stacked(self, which: Ints) -> Floats:
        R = np.zeros(self._R_w.shape[1:])
        for begin in range(0, len(which), CHUNK):
            part = self._centre_factors(which[begin : begin + CHUNK])
            R = update_rank_k(R, np.moveaxis(part, 0, 1).reshape(2, -1, R.shape[-1]))
        return R
