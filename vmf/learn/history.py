"""What a target's observations say about any centre, without a visit to every pair (§4).

The rows of the pairs (i → c) are linear in `[x̄_i; x_i x̄_i; y_i x̄_i]`, and c enters by its closure matrix and
its pixel alone. So the observations of a target, made triangular once, serve all of its centres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vmf.data.growing import Growing
from vmf.estimate import CAMERAS, Cameras, StereoEquations
from vmf.geometry import inverse
from vmf.learn.base import Arrays, Floats
from vmf.learn.visited import Centres, Ints
from vmf.tasks import Task

# Observations of a window worked on at once: bounds the memory of a query.
_ROWS = 2048


class History(ABC):
    """Equations of centres over the observations of their own targets.

    Parameters
    ----------
    task : the task space.
    centres : the observations.
    """

    def __init__(self, task: Task, centres: Centres) -> None:
        self.task, self.centres = task, centres

    @abstractmethod
    def take_in(self, new: Ints) -> None:
        """Learn of new centres."""

    @abstractmethod
    def pairs(self, which: Ints, cameras: Cameras = "both") -> StereoEquations:
        """Return the equations (C,) of all pairs of some centres, in increasing order; not triangular."""

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that observations alone do not give back bit for bit."""
        return {}

    def restore(self, state: Arrays) -> None:  # noqa: B027
        """Take over the arrays of `state`."""

    def _reference(self, centre: Ints) -> tuple[Floats, Floats]:
        """Return inverse poses and pixels of centres, for others to count from, for the sake of rounding.

        Only pan-tilt poses, which do not close, stay absolute (C3).
        """
        E = self.centres.E(centre)
        return inverse(E) if self.task.closed else np.broadcast_to(np.eye(4), E.shape), self.centres.u(centre)

    def _rows(self, which: Ints, W_from_ref: Floats, u_ref: Floats) -> tuple[Floats, Floats]:
        """Return lifts (m, k+1) and pixels (m, 2, 2) of centres, from a reference."""
        return self.task.lift(self.centres.E(which) @ W_from_ref), self.centres.u(which) - u_ref

    def _seen_from(
        self, equations: StereoEquations, which: Ints, W_from_ref: Floats, u_ref: Floats, cameras: Cameras
    ) -> StereoEquations:
        """Return equations of observations, made from a reference, as those of pairs with centres."""
        L = self.task.closure(self.centres.E(which) @ W_from_ref)
        u = self.centres.u(which) - u_ref
        return equations.of_cameras(cameras).seen_from(L, u[..., CAMERAS[cameras], :])


class RunningHistory(History):
    """Unbounded: one running factor a target, of constant size and constant cost for a new observation."""

    def __init__(self, task: Task, centres: Centres) -> None:
        super().__init__(task, centres)
        n = task.n_lift + 1
        self._lifts: Growing[np.float64] = Growing((n, 5, n), np.float64)
        self._rest: Growing[np.float64] = Growing((2, n, n), np.float64)
        # Where the observations of each target count from: its first centre.
        self._begun: Growing[np.bool_] = Growing((), np.bool_)
        self._W_from_ref: Growing[np.float64] = Growing((4, 4), np.float64)
        self._u_ref: Growing[np.float64] = Growing((2, 2), np.float64)

    def take_in(self, new: Ints) -> None:
        if not len(new):
            return
        target = self.centres.target(new)
        self._begin(target, new)
        x_bar, u = self._rows(new, self._W_from_ref.rows[target], self._u_ref.rows[target])
        for targets, index in _by_target(target):
            real = (index >= 0)[..., None]
            rows = StereoEquations.of(np.where(real, x_bar[index], 0.0), u[index])
            now = self._equations(targets).with_others(rows)
            self._lifts.rows[targets], self._rest.rows[targets] = now.lifts, now.rest

    def _begin(self, target: Ints, new: Ints) -> None:
        """Make room for targets that are seen for the first time."""
        more = int(target.max()) + 1 - len(self._begun)
        if more > 0:
            nothing = StereoEquations.none(self.task.n_lift + 1, more)
            self._lifts.append(nothing.lifts)
            self._rest.append(nothing.rest)
            self._begun.append(np.zeros(more, bool))
            self._W_from_ref.append(np.zeros((more, 4, 4)))
            self._u_ref.append(np.zeros((more, 2, 2)))
        fresh = ~self._begun.rows[target]
        if fresh.any():
            targets, first = np.unique(target[fresh], return_index=True)
            W_from_ref, u_ref = self._reference(new[fresh][first])
            self._W_from_ref.rows[targets], self._u_ref.rows[targets] = W_from_ref, u_ref
            self._begun.rows[targets] = True

    def _equations(self, targets: Ints) -> StereoEquations:
        return StereoEquations(self._lifts.rows[targets], self._rest.rows[targets])

    def pairs(self, which: Ints, cameras: Cameras = "both") -> StereoEquations:
        target = self.centres.target(which)
        W_from_ref, u_ref = self._W_from_ref.rows[target], self._u_ref.rows[target]
        return self._seen_from(self._equations(target), which, W_from_ref, u_ref, cameras)

    def state(self) -> dict[str, NDArray[Any]]:
        return {"history.lifts": self._lifts.rows.copy(), "history.rest": self._rest.rows.copy()}

    def restore(self, state: Arrays) -> None:
        for name, kept in (("history.lifts", self._lifts), ("history.rest", self._rest)):
            array = np.array(state[name], float)
            if array.shape != kept.rows.shape:
                raise ValueError(f"{name} has shape {array.shape}, expected {kept.rows.shape}")
            kept.rows[...] = array


def _by_target(target: Ints) -> list[tuple[Ints, Ints]]:
    """Return targets (B,) and where each occurs (B, m), −1 in the padding, similar numbers together."""
    if len(target) == 1:
        return [(target, np.zeros((1, 1), np.int64))]
    targets, start, count = np.unique(np.sort(target), return_index=True, return_counts=True)
    order = np.argsort(target, kind="stable")
    size = 2 ** np.ceil(np.log2(count)).astype(np.int64)
    found = []
    for m in np.unique(size):
        mine = np.nonzero(size == m)[0]
        column = np.arange(m)
        index = order[np.minimum(start[mine, None] + column, len(order) - 1)]
        found.append((targets[mine], np.where(column < count[mine, None], index, -1)))
    return found


class WindowedHistory(History):
    """Bounded: each centre is paired with the observations in a window around its own.

    Windows of one length slide over a target's observations. Taking rows away from a factor loses digits, so
    none is ever taken away. Windows that share an observation are halved there: the left halves all end at
    it and are nested, and so are the right halves that begin behind it. Each half grows out of the next
    shorter one, and a window is the two halves together. A centre therefore costs no more than the
    observations of its window, and much less where centres have windows in common (the sliding
    window of two stacks, done with QR factors). Nothing is kept between queries.
    """

    def take_in(self, new: Ints) -> None:
        pass

    def pairs(self, which: Ints, cameras: Cameras = "both") -> StereoEquations:
        n = self.task.n_lift + 1
        target = self.centres.target(which)
        out = StereoEquations.none(n, len(which)).of_cameras(cameras)
        for t in dict.fromkeys(target.tolist()):
            mine = np.nonzero(target == t)[0]
            mates = self.centres.of_target(t)
            first, end = self.centres.window(t, which[mine])
            i = 0
            while i < len(mine):
                # All windows that begin no later than the first of them ends.
                pivot = int(end[i])
                j = int(np.searchsorted(first, pivot))
                group = mine[i:j]
                W_from_ref, u_ref = self._reference(mates[pivot - 1 : pivot])
                x_bar, u = self._rows(mates[first[i] : end[j - 1]], W_from_ref, u_ref)
                equations = _halved(x_bar, u, first[i:j] - first[i], pivot - first[i], end[i:j] - first[i])
                seen = self._seen_from(equations, which[group], W_from_ref, u_ref, cameras)
                out.lifts[group], out.rest[group] = seen.lifts, seen.rest
                i = j
        return out


def _halved(x_bar: Floats, u: Floats, first: Ints, pivot: int, end: Ints) -> StereoEquations:
    """Return the triangular equations (C,) of rows `first` to `end` of increasing windows around a pivot."""
    left = _nested(x_bar[:pivot][::-1], u[:pivot][::-1], pivot - first[::-1])[::-1]
    right = _nested(x_bar[pivot:], u[pivot:], end - pivot)
    return left.with_others(right)


def _nested(x_bar: Floats, u: Floats, counts: Ints) -> StereoEquations:
    """Return the triangular equations (C,) of the first rows, for counts (C,) that do not decrease."""
    n = x_bar.shape[-1]
    out = StereoEquations.none(n, len(counts))
    so_far = StereoEquations.none(n)
    done = 0
    for i, count in enumerate(counts.tolist()):
        while done < count:
            upto = min(count, done + _ROWS)
            so_far = so_far.with_others(StereoEquations.of(x_bar[done:upto], u[done:upto]))
            done = upto
        out.lifts[i], out.rest[i] = so_far.lifts, so_far.rest
    return out
