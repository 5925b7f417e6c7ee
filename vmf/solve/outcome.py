"""From minimisers to solutions: choice among starts, rank, and NaN where there is no motion to use."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from vmf.optimise import ArrowFit, LeastSquares, Stop
from vmf.solve.solution import Solutions, StopReason
from vmf.solve.unknowns import Unknowns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Reasons = NDArray[np.object_]

# Half the digits: points at their best place carry the rounding of their own minimisation.
RANK_TOLERANCE = float(np.sqrt(np.finfo(float).eps))
_REASONS: Mapping[Stop, StopReason] = MappingProxyType(
    {
        Stop.MAX_ITERATIONS: StopReason.MAX_ITERATIONS,
        Stop.STALLED: StopReason.DIVERGED,
        Stop.NOT_FINITE: StopReason.BEHIND_CAMERA,
    }
)


@dataclass(frozen=True)
class Draft:
    """Solutions in the making: arrays over Q queries, filled in place for those that can be asked.

    Attributes
    ----------
    unknowns : what is solved for.
    x : (Q, f) free unknowns.
    covariance : (Q, f, f) of x.
    residual_px, iterations, condition, reason : (Q,) as in `Solutions`.
    weights : (Q, n) as in `Solutions`.
    """

    unknowns: Unknowns
    x: Floats
    covariance: Floats
    residual_px: Floats
    iterations: Ints
    condition: Floats
    reason: Reasons
    weights: Floats

    @classmethod
    def of(cls, unknowns: Unknowns, reason: Reasons, used: Bools) -> Draft:
        """Return an empty draft: why queries (Q,) cannot be asked, and which targets (Q, n) are used."""
        Q, n_free = len(reason), unknowns.n_free
        return cls(
            unknowns,
            np.full((Q, n_free), np.nan),
            np.full((Q, n_free, n_free), np.nan),
            np.full(Q, np.nan),
            np.zeros(Q, np.int64),
            np.full(Q, np.nan),
            reason.copy(),
            np.where(used, 1.0, np.nan),
        )

    @property
    def asked(self) -> Ints:
        """The queries for which nothing speaks against a motion yet."""
        return np.nonzero(self.reason == StopReason.CONVERGED)[0]

    def take(
        self, fits: Sequence[LeastSquares | ArrowFit], index: Ints, demerits: Sequence[Bools] = ()
    ) -> tuple[Ints, Ints]:
        """Enter the best fit of each query: fewest demerits, in their order, then the lower cost.

        Parameters
        ----------
        fits : F minimisers of the A queries `index`.
        index : (A,) queries.
        demerits : (F, A) each, the gravest first; not to have converged by default.

        Returns
        -------
        Where the chosen fits are in arrays (F, A).
        """
        cost = np.stack([np.where(np.isfinite(fit.cost), fit.cost, np.inf) for fit in fits])
        demerits = demerits or [np.stack([~fit.converged for fit in fits])]
        best = np.lexsort((cost, *reversed(demerits)), axis=0)[0], np.arange(len(index))
        # Before ranks and covariances, which belong to one choice of equivalent angles.
        self.x[index] = self.unknowns.canonical(np.stack([fit.x for fit in fits])[best], index)
        self.iterations[index] += np.sum([fit.iterations for fit in fits], axis=0)
        stop = np.stack([fit.stop for fit in fits])[best]
        self.reason[index] = StopReason.CONVERGED
        for code, why in _REASONS.items():
            self.reason[index[stop == code]] = why
        return best

    def check_rank(self, s: Floats, size: Floats, index: Ints, tolerance: float = RANK_TOLERANCE) -> None:
        """Enter condition numbers of Jacobians, and refuse where they leave a motion free.

        Parameters
        ----------
        s : (A, f) singular values of the Jacobians with columns of unit length, the largest first.
        size : (A, f) lengths of the columns.
        index : (A,) queries.
        tolerance : smallest singular value of a regular one, relative to the largest.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            self.condition[index] = np.where(s[:, -1] > 0.0, s[:, 0] / s[:, -1], np.inf)
        deficient = (s[:, -1] <= tolerance * s[:, 0]) | (size <= 0.0).any(axis=1)
        self.reason[index[deficient]] = StopReason.RANK_DEFICIENT

    def check_rank_of(self, J: Floats, index: Ints) -> None:
        """The same from the Jacobians (A, r, f) themselves."""
        if not len(index):
            return
        size = np.asarray(np.linalg.norm(J, axis=1), float)
        scaled = J / np.where(size > 0.0, size, 1.0)[:, None, :]
        self.check_rank(np.asarray(np.linalg.svd(scaled, compute_uv=False), float), size, index)

    def solutions(self) -> Solutions:
        """Return the finished solutions, with NaN motions where not converged."""
        failed = self.reason != StopReason.CONVERGED
        unknowns, everything = self.unknowns, np.arange(len(failed))
        p = unknowns.full(np.where(failed[:, None], 0.0, self.x), everything)
        E = unknowns.task.motion(p, unknowns.E_c)
        free = np.nonzero(unknowns.free)[0]
        covariance = np.zeros((*p.shape, p.shape[1]))
        covariance[:, free[:, None], free] = self.covariance
        p[failed], E[failed], covariance[failed] = np.nan, np.nan, np.nan
        return Solutions(
            E, p, covariance, self.residual_px, self.iterations, self.condition, self.reason, self.weights
        )


def refusals(usable: Bools, in_stereo: Bools, fewest: int) -> Reasons:
    """Return why queries cannot be asked, `CONVERGED` for those that can.

    Parameters
    ----------
    usable : (Q, n) targets that the method can use.
    in_stereo : (Q, n) targets it could use if they were in front of the cameras.
    fewest : targets needed.
    """
    reason = np.full(len(usable), StopReason.CONVERGED, dtype=object)
    reason[usable.sum(axis=1) < fewest] = StopReason.TOO_FEW_EQUATIONS
    reason[in_stereo.any(axis=1) & ~usable.any(axis=1)] = StopReason.BEHIND_CAMERA
    return reason
