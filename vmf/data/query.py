"""A question to the visuomotor function: these targets are here, and should be there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from vmf.geometry import motion

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Query:
    """Q pairs of views of up to n targets.

    Attributes
    ----------
    initial : (Q, n, 4) `x_L, y_L, x_R, y_R` at the start (px), NaN where not seen.
    desired : (Q, n, 4) where they should be.
    E_initial : (Q, 4, 4) pose `E_S_from_W` at the start, from the robot's encoders.
    E_desired : (Q, 4, 4) pose at the goal: the truth that answers are compared with.
    """

    initial: Floats
    desired: Floats
    E_initial: Floats
    E_desired: Floats

    def __len__(self) -> int:
        return len(self.initial)

    @property
    def truth(self) -> Floats:
        """The true motions `E_desired inv(E_initial)` (Q, 4, 4)."""
        return self.E_desired @ motion.inverse(self.E_initial)

    def rotations(self, known: bool) -> Floats | None:
        """Return the rotations (Q, 3, 3) of the motions where the robot is to give them, None where not."""
        return self.truth[:, :3, :3] if known else None

    def reversed(self) -> Query:
        """Return the queries with initial and desired view exchanged."""
        return Query(self.desired, self.initial, self.E_desired, self.E_initial)

    def of_camera(self, cameras: str) -> Query:
        """Return the queries with desired pixels of `left`, `right` or `both` cameras alone."""
        desired = self.desired.copy()
        if cameras != "both":
            desired[..., slice(2, 4) if cameras == "left" else slice(0, 2)] = np.nan
        return Query(self.initial, desired, self.E_initial, self.E_desired)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Query:
        """Return some of the queries."""
        return Query(self.initial[which], self.desired[which], self.E_initial[which], self.E_desired[which])


@dataclass(frozen=True)
class Truth:
    """What a simulation knows about Q queries beside their motions; nothing of it reaches a learner.

    Attributes
    ----------
    points : (Q, n, 3) true targets in S at the start of each motion (m).
    noise_px : (Q, n, 8) Gaussian noise on the coordinates of the initial view, then of the desired one.
    moved : (Q, n, 3) how far the targets have moved since the initial view, in the same axes (m).
    """

    points: Floats
    noise_px: Floats
    moved: Floats


def join(queries: Sequence[Query]) -> Query:
    """Return several queries on as many targets as one."""
    return Query(*(np.concatenate([getattr(q, f.name) for q in queries]) for f in fields(Query)))
