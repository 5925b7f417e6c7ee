"""What a solved motion is, and how it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.geometry import motion

Floats = NDArray[np.float64]


class StopReason(Enum):
    """Why a solver stopped; only `CONVERGED` comes with a motion to use."""

    CONVERGED = "converged"
    NO_PARAMETERS = "no parameters for these stereo codes"
    TOO_FEW_EQUATIONS = "too few targets or equations for the unknowns"
    RANK_DEFICIENT = "the equations leave a direction of motion free"
    BEHIND_CAMERA = "a target ends behind a camera"
    MAX_ITERATIONS = "no convergence within the iterations allowed"
    DIVERGED = "the minimisation diverged"
    INCONSISTENT = "most targets contradict any one motion"

    @property
    def status(self) -> str:
        """Status in error tables: `ok`, `refused` (could not be asked) or `diverged` (came to nothing)."""
        if self is StopReason.CONVERGED:
            return "ok"
        refusals = (
            StopReason.NO_PARAMETERS,
            StopReason.TOO_FEW_EQUATIONS,
            StopReason.RANK_DEFICIENT,
            StopReason.INCONSISTENT,
        )
        return "refused" if self in refusals else "diverged"


@dataclass(frozen=True)
class Solution:
    """One solved motion.

    Attributes
    ----------
    E_to_from : (4, 4) motion E' from the initial to the desired pose of S; NaN unless converged.
    p : (m,) its unknowns in the task's parametrisation; NaN unless converged.
    covariance : (m, m) of p; NaN unless converged.
    residual_px : root mean square residual over all equations.
    iterations : steps tried.
    condition : condition number of the Jacobian, columns scaled to unit length.
    reason : why the solver stopped.
    weights : (n,) how far each target was trusted, from 1 down to 0 for one that was rejected as a wrong
        correspondence; NaN for targets that could not be used.
    """

    E_to_from: Floats
    p: Floats
    covariance: Floats
    residual_px: float
    iterations: int
    condition: float
    reason: StopReason
    weights: Floats

    @property
    def converged(self) -> bool:
        """Whether there is a motion to use."""
        return self.reason is StopReason.CONVERGED


@dataclass(frozen=True)
class Solutions:
    """Q solved motions: the fields of `Solution` with a leading axis."""

    E_to_from: Floats
    p: Floats
    covariance: Floats
    residual_px: Floats
    iterations: NDArray[np.int64]
    condition: Floats
    reason: NDArray[np.object_]
    weights: Floats

    def __len__(self) -> int:
        return len(self.p)

    def __getitem__(self, i: int) -> Solution:
        return Solution(
            self.E_to_from[i],
            self.p[i],
            self.covariance[i],
            float(self.residual_px[i]),
            int(self.iterations[i]),
            float(self.condition[i]),
            self.reason[i],
            self.weights[i],
        )

    def select(self, which: NDArray[np.int64]) -> Solutions:
        """Return some of the solutions."""
        return Solutions(*(getattr(self, f.name)[which] for f in fields(Solutions)))

    @property
    def rejected(self) -> NDArray[np.bool_]:
        """Which targets (Q, n) were rejected as wrong correspondences."""
        return np.asarray(self.weights == 0.0)

    @property
    def status(self) -> NDArray[np.str_]:
        """Statuses (Q,) for error tables."""
        return np.array([r.status for r in self.reason], dtype=str)


def concatenate(parts: Sequence[Solutions]) -> Solutions:
    """Return the solutions of several calls as one, with room for the most targets of any."""
    most = max(p.weights.shape[1] for p in parts)
    weights = [
        np.pad(p.weights, ((0, 0), (0, most - p.weights.shape[1])), constant_values=np.nan) for p in parts
    ]
    parts = [replace(p, weights=w) for p, w in zip(parts, weights, strict=True)]
    return Solutions(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Solutions)))


def command(T_now: ArrayLike, E_to_from: ArrayLike, mounting: str) -> Floats:
    """Return the pose to command (…, 4, 4) for a solved motion E' (§1).

    Parameters
    ----------
    T_now : (…, 4, 4) present pose, `W_T_S` (eye-in-hand) or `B_T_tool` (eye-to-hand).
    E_to_from : (…, 4, 4) solved motions.
    mounting : `eye_in_hand` gives `W_T_S · inv(E')`, `eye_to_hand` gives `E' · B_T_tool`.
    """
    T_now, E = np.asarray(T_now, float), np.asarray(E_to_from, float)
    return E @ T_now if mounting == "eye_to_hand" else T_now @ motion.inverse(E)
