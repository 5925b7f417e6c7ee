"""Algorithm 1: every observation of a target paired with every other, one least-squares factor a tile.

The two engines differ in how a tile comes by its factor; what is read from the factors is the same. Both
keep the pair of an observation with itself, which says `e(I) = 0` (§4).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate import Approximator, Collisions, Lookup, SlotTable, Tiling
from vmf.data.tracks import Tracks
from vmf.estimate import (
    LINEAR,
    Estimate,
    in_gauge,
    least_squares,
    maximum_likelihood,
    update_rank_k,
)
from vmf.estimate.noise import Noise
from vmf.geometry import inverse
from vmf.learn.base import Answer, Floats, Learner
from vmf.tasks import Task

Ints = NDArray[np.int64]
Readout = Literal["kaczmarz", "mean", "pooled"]

# Tiles or centres worked on at once: bounds the memory of a query.
CHUNK = 256


@dataclass
class Centres:
    """All observations seen by both cameras, in order; each is the centre of its own pairs.

    Attributes
    ----------
    target : (V,) target of each centre.
    rank : (V,) how many centres of the same target came before.
    E : (V, 4, 4) poses `E_S_from_W`.
    code : (V, 4) stereo codes in px.
    of_slot : centres in each tile.
    slots : tiles of each centre, in the order of the overlays.
    """

    target: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    rank: Ints = field(default_factory=lambda: np.zeros(0, np.int64))
    E: Floats = field(default_factory=lambda: np.zeros((0, 4, 4)))
    code: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    of_slot: dict[int, list[int]] = field(default_factory=dict)
    slots: list[list[int]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.target)

    def append(self, target: Ints, E: Floats, code: Floats, slots: list[list[int]]) -> None:
        """Add centres (in order) that lie in the given tiles."""
        order = np.argsort(target, kind="stable")
        first = np.searchsorted(target[order], target[order])
        before = np.empty(len(target), np.int64)
        before[order] = np.arange(len(target)) - first
        earlier = np.bincount(self.target, minlength=int(target.max(initial=0)) + 1)
        begin = len(self)
        self.rank = np.concatenate([self.rank, before + earlier[target]])
        self.target = np.concatenate([self.target, target])
        self.E = np.concatenate([self.E, E])
        self.code = np.concatenate([self.code, code])
        self.slots += slots
        for centre, tiles in enumerate(slots, start=begin):
            for slot in tiles:
                self.of_slot.setdefault(slot, []).append(centre)

    @property
    def u(self) -> Floats:
        """Pixels (V, 2, 2) of both cameras."""
        return self.code.reshape(-1, 2, 2)


class PipelineLearner(Learner):
    """Common part of the engines: tiles, estimators and read-outs.

    Parameters
    ----------
    task : the task space.
    tiling : the overlays; None gives every visited code a factor of its own.
    make_approximator : without a tiling, learns the visited codes' parameters and answers the others.
    estimator : `qr`, `tls` or `ml`.
    readout : of the T tiles of a code: `mean` of their solutions, `pooled` least squares, or `kaczmarz`.
    gauge : in which solutions are averaged.
    min_support : codes with a smaller share of determined tiles are refused.
    length : observations kept per target, None for all.

    Raises
    ------
    ValueError : estimator `ml`, which needs all pairs at once, with another read-out than `mean`.
    """

    def __init__(
        self,
        task: Task,
        tiling: Tiling | None,
        make_approximator: Callable[[], Approximator],
        *,
        estimator: str = "qr",
        readout: Readout = "mean",
        gauge: str = "unit_depth",
        min_support: float = 0.25,
        length: int | None = None,
    ) -> None:
        super().__init__(task)
        if estimator == "ml" and readout != "mean":
            raise ValueError(f"readout {readout} works on factors, which estimator ml does not solve")
        self.tiling, self._make_approximator = tiling, make_approximator
        self.estimator, self.readout, self.gauge = estimator, readout, gauge
        self.min_support, self.length = min_support, length
        self.table = None if tiling is None else SlotTable(tiling)
        self.centres = Centres()
        self._approximator: Approximator | None = None
        self._solved: dict[int, tuple[Floats, bool]] = {}

    @property
    def collisions(self) -> Collisions | None:
        """How well the table kept tiles apart, None without one."""
        return None if self.table is None else self.table.collisions

    @abstractmethod
    def _update(self, first: int) -> None:
        """Take in the centres from number `first` on."""

    @abstractmethod
    def _factors(self, slots: Ints) -> Floats:
        """Return the factors (S, 2, 3k+3, 3k+3) of tiles that hold data."""

    def _learn(self, block: Tracks) -> None:
        self._approximator = None
        self._solved.clear()
        target, frame, code = stereo_observations(block)
        first = len(self.centres)
        if self.table is None:
            slots = [[first + i] for i in range(len(code))]
        else:
            visited = self.table.visit(code)
            # A slot holds the pairs of the tile that owns it, and those once.
            own = self.table.find(code)[1]
            slots = [list(dict.fromkeys(row[o].tolist())) for row, o in zip(visited, own, strict=True)]
        self.centres.append(target, block.E_S_from_W[frame], code, slots)
        self._update(first)

    def parameters(self, codes: ArrayLike) -> Answer:
        codes = np.asarray(codes, float)
        if self.table is None:
            return self._from_visited(codes)
        slots, used = self.table.find(codes)
        return self._pooled(slots, used) if self.readout == "pooled" else self._mean(slots, used)

    def condition(self, code: ArrayLike) -> float:
        """Return the condition number of one tile's equations (Fig. 5.19): the code's first tile, left."""
        slots = self._slots_of(np.asarray(code, float))
        if not len(slots):
            return float("nan")
        return float(least_squares(self._factors(slots[:1]), self._n_free).condition[0, 0])

    @property
    def noise(self) -> Noise | None:
        return None

    @property
    def losses(self) -> tuple[str, ...]:
        if self.collisions is not None and self.collisions.collided:
            c = self.collisions
            return (f"{c.collided} of {c.updates} tile updates fell on a slot of another tile",)
        return ()

    @property
    def _n_free(self) -> int:
        return self.task.world().n_lift + 1

    @property
    def _shape(self) -> tuple[int, int, int]:
        return (2, 3, self.task.n_lift + 1)

    def _slots_of(self, code: Floats) -> Ints:
        if self.table is None:
            return np.nonzero((self.centres.code == code).all(axis=1))[0][-1:]
        slots, used = self.table.find(code[None])
        return np.asarray(slots[0, used[0]])

    def _in_gauge(self, rows: Floats) -> Floats:
        return in_gauge(rows, self.gauge, self.task.identity_lift)

    def _solutions(self, slots: Ints) -> tuple[Floats, NDArray[np.bool_]]:
        """Return parameters (S, 2, 3, k+1) of tiles and which are determined, solving what is new."""
        wanted = np.array([s for s in dict.fromkeys(slots.tolist()) if s not in self._solved], np.int64)
        for begin in range(0, len(wanted), CHUNK):
            part = wanted[begin : begin + CHUNK]
            estimate = self._solve(part, self._factors(part))
            rows = self._in_gauge(estimate.rows)
            good = np.asarray(estimate.determined.all(axis=1) & np.isfinite(rows).all(axis=(1, 2, 3)))
            for slot, theta, ok in zip(part, rows, good, strict=True):
                self._solved[int(slot)] = (theta, bool(ok))
        if not len(slots):
            return np.zeros((0, *self._shape)), np.zeros(0, bool)
        solved = [self._solved[int(s)] for s in slots]
        return np.stack([rows for rows, _ in solved]), np.array([good for _, good in solved])

    def _solve(self, slots: Ints, R: Floats) -> Estimate:
        if self.estimator == "ml":
            return self._maximum_likelihood(slots, R)
        return LINEAR[self.estimator](R, self._n_free)

    def _maximum_likelihood(self, slots: Ints, R: Floats) -> Estimate:
        """Form the tiles' pairs anew: this estimator needs every one of them."""
        parts = []
        for slot, factor in zip(slots, R, strict=True):
            pairs = [self._pairs_of(c) for c in self.centres.of_slot[int(slot)]]
            x_bar = np.concatenate([x for x, _ in pairs])
            e = np.moveaxis(np.concatenate([e for _, e in pairs]), 1, 0)
            lifts = np.broadcast_to(x_bar, (2, *x_bar.shape))
            parts.append(maximum_likelihood(factor, self._n_free, lifts, e)[0])
        return Estimate(*(np.stack([getattr(p, name) for p in parts]) for name in Estimate.__annotations__))

    def _pairs_of(self, c: int) -> tuple[Floats, Floats]:
        """Return lifts (m, k+1) and errors (m, 2, 2) of the pairs of centre c, with itself included."""
        centres = self.centres
        mates = centres.target == centres.target[c]
        if self.length is not None:
            mates &= np.abs(centres.rank - centres.rank[c]) <= self.length
        x_bar = self.task.lift(centres.E[mates] @ inverse(centres.E[c]))
        return x_bar, centres.u[mates] - centres.u[c]

    def _from_visited(self, codes: Floats) -> Answer:
        if isinstance(self._make_approximator(), Lookup):
            return self._look_up(codes)
        if self._approximator is None:
            self._approximator = self._make_approximator()
            rows, good = self._solutions(np.arange(len(self.centres)))
            if good.any():
                self._approximator.partial_fit(self.centres.code[good], rows[good].reshape(good.sum(), -1))
        prediction = self._approximator.predict(codes)
        return self._answer(prediction)

    def _look_up(self, codes: Floats) -> Answer:
        """Answer visited codes with their own parameters, solving no others."""
        values = np.full((len(codes), *self._shape), np.nan)
        slots = [self._slots_of(code) for code in codes]
        known = np.array([len(s) > 0 for s in slots], bool)
        if known.any():
            rows, good = self._solutions(np.concatenate(slots))
            values[known] = np.where(good[:, None, None, None], rows, np.nan)
        return Answer.approximated(values, np.isfinite(values).all(axis=(1, 2, 3)).astype(float))

    def _mean(self, slots: Ints, used: NDArray[np.bool_]) -> Answer:
        """Average the tiles' solutions: the fixed point of Eq. 4.8 for one code."""
        values = np.full((len(slots), *self._shape), np.nan)
        support = np.zeros(len(slots))
        self._solutions(slots[used])
        for i, (tiles, filled) in enumerate(zip(slots, used, strict=True)):
            rows, good = self._solutions(tiles[filled])
            support[i] = good.sum() / len(tiles)
            if support[i] > 0.0 and support[i] >= self.min_support:
                values[i] = rows[good].mean(axis=0)
        return Answer.approximated(values, support)

    def _pooled(self, slots: Ints, used: NDArray[np.bool_]) -> Answer:
        """One least squares over the stacked factors of all tiles of a code."""
        values = np.full((len(slots), *self._shape), np.nan)
        support = used.mean(axis=1)
        for i in np.nonzero((support > 0.0) & (support >= self.min_support))[0]:
            R = self._factors(slots[i, used[i]])
            stacked = np.moveaxis(R, 0, 1).reshape(2, -1, R.shape[-1])
            pooled = update_rank_k(np.zeros_like(R[0]), stacked)
            estimate = LINEAR[self.estimator](pooled, self._n_free)
            if estimate.determined.all():
                values[i] = self._in_gauge(estimate.rows)
        return Answer.approximated(values, np.where(np.isfinite(values).all(axis=(1, 2, 3)), support, 0.0))


def stereo_observations(tracks: Tracks) -> tuple[Ints, Ints, Floats]:
    """Return targets (V,), frames (V,) and codes (V, 4) of all observations in both cameras, by frame."""
    both = np.isfinite(tracks.pixels).all(axis=1)
    target, frame, code = tracks.target[both], tracks.frame[both], tracks.pixels[both]
    order = np.lexsort((target, frame))
    return target[order], frame[order], code[order]
