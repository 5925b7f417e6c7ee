"""`engine: compressed`: Algorithm 1's least-squares state without its N(N−1) updates (§4)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vmf.estimate import CAMERAS, Cameras, StereoEquations
from vmf.learn.base import Arrays, Floats
from vmf.learn.history import History, RunningHistory, WindowedHistory
from vmf.learn.pipeline import Bools, Ints, PipelineLearner
from vmf.learn.visited import Tiles

# Centres worked on at once, at about 10 kB each: bounds the memory of a query.
_CENTRES = 1024


class CompressedPipeline(PipelineLearner):
    """Forms the factor of a tile only when it is asked for, at the cost of the tile's own centres."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        make = RunningHistory if self.length is None else WindowedHistory
        self._history: History = make(self.task, self.centres)
        # Slots with solutions that observations still to come may change.
        self._unsettled: set[int] = set()

    def state(self) -> dict[str, NDArray[Any]]:
        return {**super().state(), **self._history.state()}

    def restore(self, state: Arrays) -> None:
        super().restore(state)
        # Learned in other blocks, factors differ in their last bits.
        self._history.restore(state)

    def _update(self, new: Ints) -> None:
        self._history.take_in(new)

    def _forget(self, new: Ints) -> None:
        changed = self._unsettled
        self._unsettled = set()
        if any(self._solved.values()):
            changed.update(self.tiles(self.centres.code(new)).slot.tolist())
        for solved in self._solved.values():
            for slot in changed & solved.keys():
                del solved[slot]

    def _solve(self, tiles: Tiles, cameras: Cameras = "both") -> tuple[Floats, Bools]:
        sets, which = self._covered(tiles)
        settled = np.array([self.centres.complete(centres) for centres in sets])
        self._unsettled.update(tiles.slot[~settled[which]].tolist())
        if self.estimator == "ml":
            rows, good = self._maximum_likelihood(tiles, self._equations(sets).factors()[which])
            return rows[:, CAMERAS[cameras]], good
        equations = self._equations(sets, cameras=cameras)
        rows, good = self._solve_equations(equations)
        return rows[which], good[which]

    def _solve_pooled(self, groups: list[Tiles], cameras: Cameras) -> tuple[Floats, Bools]:
        members, weights = [], []
        for tiles in groups:
            # A centre in several of the tiles counts as often as that.
            sets, which = self._covered(tiles)
            centres, count = np.unique(np.concatenate([sets[i] for i in which]), return_counts=True)
            members.append(centres)
            weights.append(np.sqrt(count))
        return self._solve_equations(self._equations(members, weights, cameras))

    def _solve_equations(self, equations: StereoEquations) -> tuple[Floats, Bools]:
        if self.estimator != "qr":
            return self._linear(equations.factors())
        rows, regular = equations.least_squares()
        good: Bools = np.asarray(regular.all(axis=1))
        # Where a triangle has zeros on its diagonal, there are fewer equations than unknowns.
        some_free = self._n_free <= self.task.n_lift
        hard = np.nonzero(~good & (equations.full | some_free))[0]
        if len(hard):
            rows[hard], good[hard] = self._linear(equations[hard].factors())
        return rows, good

    def _factors(self, tiles: Tiles) -> Floats:
        sets, which = self._covered(tiles)
        return self._equations(sets).factors()[which]

    def _equations(
        self, sets: list[Ints], weights: list[Floats] | None = None, cameras: Cameras = "both"
    ) -> StereoEquations:
        """Return the triangular equations of sets of centres, each over all pairs of its members.

        Centres that are in the same sets, with the same weights, are made triangular once for all of them.
        """
        if len(sets) == 1 and len(sets[0]) <= _CENTRES:
            return _pool(self._history.pairs(sets[0], cameras), [np.arange(len(sets[0]))], weights)
        total = StereoEquations.none(self.task.n_lift + 1, len(sets)).of_cameras(cameras)
        everyone = np.unique(np.concatenate(sets))
        for begin in range(0, len(everyone), _CENTRES):
            chunk = everyone[begin : begin + _CENTRES]
            weight = np.zeros((len(chunk), len(sets)))
            for number, centres in enumerate(sets):
                inside = np.nonzero((centres >= chunk[0]) & (centres <= chunk[-1]))[0]
                row = np.searchsorted(chunk, centres[inside])
                weight[row, number] = 1.0 if weights is None else weights[number][inside]
            pairs = self._history.pairs(chunk, cameras)
            # Bits sort faster than numbers.
            pattern = np.packbits(weight > 0.0, axis=1) if weights is None else weight
            _, first, kind = np.unique(pattern, axis=0, return_index=True, return_inverse=True)
            if 2 * len(first) <= len(chunk):
                pairs = _pool(pairs, [np.nonzero(kind == k)[0] for k in range(len(first))])
                weight = weight[first]
            if weights is None:
                part = _pool_nested(pairs, weight > 0.0)
            else:
                part = _pool(pairs, [np.nonzero(w)[0] for w in weight.T], [w[w > 0.0] for w in weight.T])
            total = part if begin == 0 else total.with_others(part)
        return total


def _pool_nested(pairs: StereoEquations, member: Bools) -> StereoEquations:
    """Return the equations of the members (C, S) of each of S sets as one, sharing what neighbours share.

    Neighbouring overlays are displaced little, so that neighbouring sets have most of their centres in
    common. A binary tree over the sets holds each centre as high up as all sets below have it; a node is its
    own centres and its parent's equations, and a leaf is a set.
    """
    n_sets = member.shape[1]
    leaves = 1 << (n_sets - 1).bit_length()
    levels = [np.ones((len(member), leaves), bool)]
    levels[0][:, :n_sets] = member
    while levels[-1].shape[1] > 1:
        levels.append(levels[-1][:, ::2] & levels[-1][:, 1::2])
    held = np.zeros((len(member), 1), bool)
    equations = StereoEquations.none(pairs.n, 1, cameras=pairs.cameras)
    for member in reversed(levels):
        width = member.shape[1]
        parent = np.arange(width) * len(held.T) // width
        held, equations = held[:, parent], equations[parent]
        own = member & ~held
        # Leaves beyond the sets are there to make the tree whole.
        nodes = np.nonzero(own.any(axis=0) & (np.arange(width) * leaves < n_sets * width))[0]
        if len(nodes):
            more = _pool(pairs, [np.nonzero(column)[0] for column in own.T[nodes]])
            grown = equations[nodes].with_others(more)
            equations.lifts[nodes], equations.rest[nodes] = grown.lifts, grown.rest
        held = member
    return equations[:n_sets]


def _padded(n: int) -> int:
    """Return the next of the numbers 1, 2, 3, 4, 6, 8, 12, 16, 24, …"""
    whole = 1 << max(n - 1, 0).bit_length()
    return 3 * whole // 4 if whole > 2 and n <= 3 * whole // 4 else whole


def _pool(
    equations: StereoEquations, groups: list[Ints], weights: list[Floats] | None = None
) -> StereoEquations:
    """Return the equations of the members of each group as one.

    Groups of similar size go together, padded with nothing.
    """
    size = [_padded(len(group)) for group in groups]
    out = StereoEquations.none(equations.n, len(groups), cameras=equations.cameras)
    for c in dict.fromkeys(size):
        of = [number for number, m in enumerate(size) if m == c]
        step = max(_CENTRES // c, 1)
        for some in (np.array(of[begin : begin + step]) for begin in range(0, len(of), step)):
            members, weight = np.zeros((len(some), c), np.int64), np.zeros((len(some), c))
            for row, number in enumerate(some.tolist()):
                m = len(groups[number])
                members[row, :m] = groups[number]
                weight[row, :m] = 1.0 if weights is None else weights[number]
            part = equations.pooled(members, weight)
            out.lifts[some], out.rest[some] = part.lifts, part.rest
    return out
