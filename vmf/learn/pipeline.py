"""Algorithm 1: every observation of a target paired with every other, one least-squares factor a tile.

The two engines differ in how a tile comes by its factor; what is read from the factors is the same. Both
keep the pair of an observation with itself, which says `e(I) = 0` (§4).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate import Approximator, Collisions, Lookup, SlotTable, Tiling
from vmf.data.tracks import Tracks
from vmf.estimate import (
    CAMERAS,
    LINEAR,
    Cameras,
    condition_number,
    in_gauge,
    maximum_likelihood,
    update_rank_k,
)
from vmf.estimate.noise import Noise
from vmf.geometry import inverse
from vmf.learn.base import Answer, Floats, Learner
from vmf.learn.visited import Centres, CodeIndex, Tiles
from vmf.tasks import Task

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Readout = Literal["kaczmarz", "mean", "pooled"]

# Tiles worked on at once: bounds the memory of a query.
CHUNK = 256
# Visited codes without tiles are looked up in buckets of this width.
_BUCKET_PX = 16.0


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
    ValueError : estimator `ml`, which needs all pairs at once, with another read-out than `mean`; a length
        below 1.
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
        if length is not None and length < 1:
            raise ValueError(f"length {length}: at least 1 observation is kept")
        self.tiling, self._make_approximator = tiling, make_approximator
        self.estimator, self.readout, self.gauge = estimator, readout, gauge
        self.min_support, self.length = min_support, length
        self.table = None if tiling is None else SlotTable(tiling)
        self.centres = Centres(self._log, length)
        self._index = CodeIndex(self.centres, _BUCKET_PX if tiling is None else tiling.tile_px)
        self._approximator: Approximator | None = None
        # By the cameras that were wanted, and by slot.
        self._solved: dict[Cameras, dict[int, tuple[Floats, bool]]] = {which: {} for which in CAMERAS}

    @property
    def collisions(self) -> Collisions | None:
        """How well the table kept tiles apart, None without one."""
        return None if self.table is None else self.table.collisions

    @abstractmethod
    def _update(self, new: Ints) -> None:
        """Take in new centres."""

    @abstractmethod
    def _factors(self, tiles: Tiles) -> Floats:
        """Return the factors (S, 2, 3k+3, 3k+3) of tiles that hold data."""

    def _learn(self, block: Tracks) -> None:
        self._approximator = None
        new = self.centres.take_in()
        self._index.append(new)
        if self.table is not None:
            self.table.visit(self.centres.code(new))
        self._update(new)
        self._forget(new)

    def _forget(self, new: Ints) -> None:
        """Drop the solutions that new centres change."""
        for solved in self._solved.values():
            solved.clear()

    def parameters(self, codes: ArrayLike, cameras: Cameras = "both") -> Answer:
        codes = np.asarray(codes, float)
        if self.table is None:
            return self._from_visited(codes)
        slots, used = self.table.find(codes)
        chunks = [slice(begin, begin + CHUNK) for begin in range(0, max(len(codes), 1), CHUNK)]
        parts = [self._read_out(codes[some], slots[some], used[some], cameras) for some in chunks]
        return Answer.approximated(*(np.concatenate(values) for values in zip(*parts, strict=True)))

    def _read_out(self, codes: Floats, slots: Ints, used: Bools, cameras: Cameras) -> tuple[Floats, Floats]:
        """Return rows (M, 2, 3, k+1) and support (M,) of codes whose tiles lie in slots (M, T), if `used`."""
        tiles = self._tiles(codes, slots, used)
        read_out = self._pooled if self.readout == "pooled" else self._mean
        some, support = read_out(tiles, used, cameras)
        rows = np.full((len(some), *self._shape), np.nan)
        rows[:, CAMERAS[cameras]] = some
        return rows, support

    def tiles(self, codes: ArrayLike) -> Tiles:
        """Return the tiles of codes (M, 4) that hold data, each once; without a table the visited codes."""
        codes = np.asarray(codes, float)
        if self.table is None:
            found = [self._index.at(code)[-1:] for code in codes]
            return self._own(np.unique(np.concatenate([np.zeros(0, np.int64), *found])))
        slots, used = self.table.find(codes)
        tiles = self._tiles(codes, slots, used)
        return tiles[np.unique(tiles.slot, return_index=True)[1]]

    def condition(self, code: ArrayLike) -> float:
        """Return the condition number of one tile's equations (Fig. 5.19): the code's first tile, left."""
        tiles = self.tiles(np.asarray(code, float)[None])
        if not len(tiles):
            return float("nan")
        first = tiles[np.argsort(tiles.overlay)[:1]]
        return float(condition_number(self._factors(first)[0, 0]))

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

    @staticmethod
    def _tiles(codes: Floats, slots: Ints, used: Bools) -> Tiles:
        which, overlay = np.nonzero(used)
        return Tiles(slots[used], overlay, codes[which])

    def _own(self, centres: Ints) -> Tiles:
        """Return centres as tiles of their own."""
        return Tiles(centres, np.zeros_like(centres), self.centres.code(centres))

    def _covered(self, tiles: Tiles) -> tuple[list[Ints], Ints]:
        """Return the different sets of centres that tiles cover, and which of them each tile covers."""
        if self.tiling is None:
            return list(tiles.slot[:, None]), np.arange(len(tiles))
        return self._index.inside(self.tiling, tiles)

    def _solutions(self, tiles: Tiles, cameras: Cameras) -> tuple[Floats, Bools]:
        """Return parameters (S, C, 3, k+1) of tiles and which are determined, solving what is new."""
        if not len(tiles):
            return np.zeros((0, *self._shape))[:, CAMERAS[cameras]], np.zeros(0, bool)
        solved = self._solved[cameras]
        slots = tiles.slot.tolist()
        first = {slot: i for i, slot in reversed(list(enumerate(slots))) if slot not in solved}
        wanted = np.array(sorted(first.values()), np.int64)
        for begin in range(0, len(wanted), CHUNK):
            part = tiles[wanted[begin : begin + CHUNK]]
            rows, good = self._solve_in_gauge(part, cameras)
            solved.update(zip(part.slot.tolist(), zip(rows, good.tolist(), strict=True), strict=True))
        found = [solved[slot] for slot in slots]
        return np.stack([rows for rows, _ in found]), np.array([good for _, good in found])

    def _solve_in_gauge(self, tiles: Tiles, cameras: Cameras = "both") -> tuple[Floats, Bools]:
        rows, determined = self._solve(tiles, cameras)
        rows = in_gauge(rows, self.gauge, self.task.identity_lift)
        return rows, determined & np.isfinite(rows).all(axis=(1, 2, 3))

    def _solve(self, tiles: Tiles, cameras: Cameras = "both") -> tuple[Floats, Bools]:
        """Return rows (S, C, 3, k+1) of tiles, any gauge, and whether all cameras' are determined (S,)."""
        R, some = self._factors(tiles), CAMERAS[cameras]
        if self.estimator != "ml":
            return self._linear(R[:, some])
        rows, good = self._maximum_likelihood(tiles, R)
        return rows[:, some], good

    def _maximum_likelihood(self, tiles: Tiles, R: Floats) -> tuple[Floats, Bools]:
        """Form the tiles' pairs anew: this estimator needs every one of them."""
        rows, good = np.empty((len(tiles), *self._shape)), np.empty(len(tiles), bool)
        sets, which = self._covered(tiles)
        for number, centres in enumerate(sets):
            mine = np.nonzero(which == number)[0]
            pairs = [self._pairs_of(c) for c in centres.tolist()]
            x_bar = np.concatenate([x for x, _ in pairs])
            e = np.moveaxis(np.concatenate([e for _, e in pairs]), 1, 0)
            lifts = np.broadcast_to(x_bar, (2, *x_bar.shape))
            estimate, _ = maximum_likelihood(R[mine[0]], self._n_free, lifts, e)
            rows[mine], good[mine] = estimate.rows, estimate.determined.all()
        return rows, good

    def _pairs_of(self, c: int) -> tuple[Floats, Floats]:
        """Return lifts (m, k+1) and errors (m, 2, 2) of the pairs of centre c, with itself included."""
        centres, me = self.centres, np.array([c])
        target = int(centres.target(me)[0])
        (begin,), (end,) = centres.window(target, me)
        mates = centres.of_target(target)[begin:end]
        x_bar = self.task.lift(centres.E(mates) @ inverse(centres.E(me)))
        return x_bar, centres.u(mates) - centres.u(me)

    def _from_visited(self, codes: Floats) -> Answer:
        if isinstance(self._make_approximator(), Lookup):
            return self._look_up(codes)
        if self._approximator is None:
            self._approximator = self._make_approximator()
            for begin in range(0, len(self.centres), CHUNK):
                part = self._own(np.arange(begin, min(begin + CHUNK, len(self.centres))))
                rows, good = self._solve_in_gauge(part)
                if good.any():
                    self._approximator.partial_fit(part.code[good], rows[good].reshape(good.sum(), -1))
        prediction = self._approximator.predict(codes)
        return self._answer(prediction)

    def _look_up(self, codes: Floats) -> Answer:
        """Answer visited codes with their own parameters, solving no others."""
        values = np.full((len(codes), *self._shape), np.nan)
        centres = [self._index.at(code)[-1:] for code in codes]
        known = np.array([len(c) > 0 for c in centres], bool)
        if known.any():
            rows, good = self._solutions(self._own(np.concatenate(centres)), "both")
            values[known] = np.where(good[:, None, None, None], rows, np.nan)
        return Answer.approximated(values, np.isfinite(values).all(axis=(1, 2, 3)).astype(float))

    def _mean(self, tiles: Tiles, used: Bools, cameras: Cameras) -> tuple[Floats, Floats]:
        """Average the tiles' solutions: the fixed point of Eq. 4.8 for one code."""
        rows, good = self._solutions(tiles, cameras)
        shape = rows.shape[1:]
        n_good = np.zeros(used.shape, bool)
        n_good[used] = good
        support = n_good.mean(axis=1)
        every = np.zeros((*used.shape, *shape))
        every[n_good] = rows[good]
        answered = (support > 0.0) & (support >= self.min_support)
        values = np.full((len(used), *shape), np.nan)
        total, count = every[answered].sum(axis=1), n_good[answered].sum(axis=1)
        values[answered] = total / count[:, None, None, None]
        return values, support

    def _pooled(self, tiles: Tiles, used: Bools, cameras: Cameras) -> tuple[Floats, Floats]:
        """One least squares over the equations of all tiles of a code."""
        values = np.full((len(used), *self._shape), np.nan)[:, CAMERAS[cameras]]
        support = used.mean(axis=1)
        asked = np.nonzero((support > 0.0) & (support >= self.min_support))[0]
        if len(asked):
            ends = np.cumsum(used.sum(axis=1))
            groups = [tiles[ends[i] - used[i].sum() : ends[i]] for i in asked]
            rows, good = self._solve_pooled(groups, cameras)
            values[asked[good]] = in_gauge(rows[good], self.gauge, self.task.identity_lift)
        return values, np.where(np.isfinite(values).all(axis=(1, 2, 3)), support, 0.0)

    def _solve_pooled(self, groups: list[Tiles], cameras: Cameras) -> tuple[Floats, Bools]:
        """Return rows (M, C, 3, k+1) of M groups of tiles, any gauge, and which are determined (M,)."""
        pooled = []
        for tiles in groups:
            R = self._factors(tiles)[:, CAMERAS[cameras]]
            rows = R.swapaxes(0, 1).reshape(R.shape[1], -1, R.shape[-1])
            pooled.append(update_rank_k(np.zeros_like(R[0]), rows))
        return self._linear(np.stack(pooled))

    def _linear(self, R: Floats) -> tuple[Floats, Bools]:
        estimate = LINEAR[self.estimator](R, self._n_free)
        return estimate.rows, np.asarray(estimate.determined.all(axis=1))
