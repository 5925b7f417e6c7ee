"""`engine: sequential`: Algorithm 1 as the thesis prints it, pair by pair."""

from __future__ import annotations

from typing import Any

import numpy as np

from vmf.estimate import LINEAR, Cameras, in_gauge, update_rank_k
from vmf.learn.base import Floats
from vmf.learn.centre_factors import CentreFactors
from vmf.learn.pairs import pair_rows
from vmf.learn.pipeline import Bools, Ints, PipelineLearner
from vmf.learn.visited import Tiles


class SequentialPipeline(PipelineLearner):
    """Updates, for every new observation, the tiles of all observations in the pipeline and its own.

    Parameters
    ----------
    step : ε of Eq. 4.8, for `readout="kaczmarz"`.
    exact_matrices : image-based errors enter the matrices without noise, which then is in the right-hand
        sides alone; the tracks have to say what they would be. Only a simulation can learn so, and pairs are
        formed for those tiles alone that are asked for, which changes no sum.
    """

    def __init__(self, *args: Any, step: float = 1.0, exact_matrices: bool = False, **options: Any) -> None:
        super().__init__(*args, **options)
        self.step, self.exact_matrices = step, exact_matrices
        self._n = 3 * (self.task.n_lift + 1)
        self._R: dict[int, Floats] = {}
        self._pipelines: dict[int, list[int]] = {}
        self._weights: dict[int, Floats] = {}
        self._slots: list[list[int]] = []
        self._in_turn = self.table is not None and self.readout == "kaczmarz"
        self._when_asked: CentreFactors | None = None
        if exact_matrices and not self._in_turn:
            self._when_asked = CentreFactors(self.centres, lambda i, c: _by_camera(self._rows(i, c)), self._n)

    def _update(self, new: Ints) -> None:
        if self.exact_matrices:
            self.centres.exact(new)
        if self._when_asked is not None:
            return
        self._slots += self._slots_of(new)
        for centre, target in zip(new.tolist(), self.centres.target(new).tolist(), strict=True):
            pipeline = self._pipelines.setdefault(target, [])
            if self._in_turn:
                self._round_tile_by_tile(pipeline, centre)
            else:
                self._round_in_blocks(pipeline, centre)
            pipeline.append(centre)
            if self.length is not None:
                del pipeline[: -self.length]

    def _slots_of(self, new: Ints) -> list[list[int]]:
        """Return the slots of centres' tiles, in the order of the overlays."""
        if self.table is None:
            return [[centre] for centre in new.tolist()]
        # A slot holds the pairs of the tile that owns it, and those once.
        slots, own = self.table.find(self.centres.code(new))
        return [list(dict.fromkeys(row[o].tolist())) for row, o in zip(slots, own, strict=True)]

    def _rows(self, i: Ints, c: Ints) -> Floats:
        """Return the rows (m, 2, 2, 3k+3) of pairs i → c of centres."""
        x = self.centres
        rows = pair_rows(self.task, x.E(i), x.u(i), x.E(c), x.u(c))
        if self.exact_matrices:
            exact = pair_rows(self.task, x.E(i), x.exact(i), x.E(c), x.exact(c))
            rows[..., :-1] = exact[..., :-1]
        return rows

    def _round_in_blocks(self, pipeline: list[int], new: int) -> None:
        """One turn of the loop of Algorithm 1, the updates of each tile gathered into one of rank k."""
        old = np.array(pipeline, np.int64)
        rows = self._rows(np.full(len(old), new), old)
        members: dict[int, list[int]] = {}
        for i, c in enumerate(pipeline):
            for slot in self._slots[c]:
                members.setdefault(slot, []).append(i)
        by_size: dict[int, list[int]] = {}
        for slot, which in members.items():
            by_size.setdefault(len(which), []).append(slot)
        for slots in by_size.values():
            self._add(slots, np.stack([_by_camera(rows[members[slot]]) for slot in slots]))
        mine = self._slots[new]
        own = _by_camera(self._rows(np.append(old, new), np.full(len(old) + 1, new)))
        self._add(mine, np.broadcast_to(own, (len(mine), *own.shape)))

    def _add(self, slots: list[int], rows: Floats) -> None:
        if not slots:
            return
        R = update_rank_k(np.stack([self._factor(slot) for slot in slots]), rows)
        self._R.update(zip(slots, R, strict=True))

    def _round_tile_by_tile(self, pipeline: list[int], new: int) -> None:
        """One turn of the loop of Algorithm 1 in its own order, with Eq. 4.8 after every update."""
        for old in pipeline:
            self._update_parameters(old, new)
            self._update_parameters(new, old)
        self._update_parameters(new, new)

    def _update_parameters(self, centre: int, other: int) -> None:
        rows = _by_camera(self._rows(np.array([other]), np.array([centre])))
        for slot in self._slots[centre]:
            self._add([slot], rows[None])
            estimate = LINEAR[self.estimator](self._R[slot], self._n_free)
            theta = in_gauge(estimate.rows, self.gauge, self.task.identity_lift)
            if estimate.determined.all() and np.isfinite(theta).all():
                self._kaczmarz(self._slots[centre], theta)

    def _kaczmarz(self, slots: list[int], theta: Floats) -> None:
        zero = np.zeros_like(theta)
        predicted = np.sum([self._weights.get(slot, zero) for slot in slots], axis=0)
        correction = self.step * (theta - predicted) / len(slots)
        for slot in slots:
            self._weights[slot] = self._weights.get(slot, zero) + correction

    def _read_out(self, codes: Floats, slots: Ints, used: Bools, cameras: Cameras) -> tuple[Floats, Floats]:
        if self.readout != "kaczmarz":
            return super()._read_out(codes, slots, used, cameras)
        values = np.full((len(slots), *self._shape), np.nan)
        support = np.zeros(len(slots))
        for i, tiles in enumerate(slots.tolist()):
            weights = [self._weights[s] for s in dict.fromkeys(tiles) if s in self._weights]
            support[i] = len(weights) / len(set(tiles))
            if weights and support[i] >= self.min_support:
                # The trained tiles stand for all T, which is Eq. 4.7 wherever all are trained.
                values[i] = np.sum(weights, axis=0) / support[i]
        return values, support

    def _factor(self, slot: int) -> Floats:
        return self._R.get(slot, np.zeros((2, self._n, self._n)))

    def _factors(self, tiles: Tiles) -> Floats:
        if self._when_asked is not None:
            return self._factors_when_asked(tiles, self._when_asked)
        return np.stack([self._factor(slot) for slot in tiles.slot.tolist()])

    def _factors_when_asked(self, tiles: Tiles, own: CentreFactors) -> Floats:
        sets, which = self._covered(tiles)
        members = np.unique(np.concatenate([np.zeros(0, np.int64), *sets])).tolist()
        of_centre = {c: own.factor(c) for c in members}
        stacked = [np.concatenate([of_centre[c] for c in some.tolist()], axis=1) for some in sets]
        empty = np.zeros((2, self._n, self._n))
        return np.stack([update_rank_k(empty, rows) for rows in stacked])[which]


def _by_camera(rows: Floats) -> Floats:
    """Return rows (2, 2m, n) from the rows (m, 2, 2, n) of m pairs."""
    return np.moveaxis(rows, 1, 0).reshape(2, -1, rows.shape[-1])
