"""The most likely motion for two views of targets whose places are unknown as well (§6.3)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.optimise import LeastSquares, levenberg_marquardt
from vmf.solve.outcome import Draft, refusals
from vmf.solve.solution import Solutions, StopReason
from vmf.solve.two_view import TwoViews

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# More wrong targets than this share, and the motion is looked for again from afar.
_DOUBTFUL = 0.1
# From a scale at which gross errors look like noise down to the noise itself.
_SCALES = (64.0, 16.0, 4.0)


def drafted(problem: TwoViews, in_stereo: Bools) -> Draft:
    """Return an empty draft: which queries can be asked.

    Parameters
    ----------
    problem : the queries.
    in_stereo : (Q, n) targets that could be used if they were in front of the cameras.
    """
    reason = refusals(problem.used, in_stereo, problem.unknowns.fewest_targets)
    reason[(problem.n_spare < 0) & problem.used.any(axis=1)] = StopReason.TOO_FEW_EQUATIONS
    return Draft.of(problem.unknowns, reason, problem.used)


def most_likely(problem: TwoViews, draft: Draft, starts: Sequence[Floats], noise: Noise | None) -> Solutions:
    """Return the motions of least reprojection error over both views, both cameras and all targets.

    Parameters
    ----------
    problem : the queries.
    draft : of `drafted`.
    starts : (A, f) motions to start from, for the queries that `draft` asks.
    noise : how the pixels scatter; None takes least squares and estimates the noise from what is left.
    """
    index = draft.asked
    if len(index):
        draft.take([_minimise(problem, start, index, noise) for start in starts], index)
        if noise is not None:
            _look_again(problem, draft, starts, index, noise)
    if len(draft.asked):
        _finish(problem, draft, noise)
    return draft.solutions()


def _minimise(problem: TwoViews, start: Floats, index: Ints, noise: Noise | None) -> LeastSquares:
    return levenberg_marquardt(lambda x, running: problem.residuals(x, index[running], noise), start)


def _look_again(problem: TwoViews, draft: Draft, starts: Sequence[Floats], index: Ints, noise: Noise) -> None:
    """Search anew, with the scale of the loss shrinking, where many targets look wrong.

    M. J. Black, A. Rangarajan, "On the unification of line processes, outlier rejection, and robust
    statistics with applications in early vision", IJCV 1996.
    """
    wrong, _ = _judged(problem, draft.x[index], index, noise)
    share = wrong.sum(axis=1) / problem.used[index].sum(axis=1)
    again = (share > _DOUBTFUL) | (draft.reason[index] != StopReason.CONVERGED)
    some = index[again]
    if not len(some):
        return
    fits = [_minimise(problem, draft.x[some], some, noise)]
    for start in starts:
        x = start[again]
        for scale in _SCALES:
            x = _minimise(problem, x, some, noise.scaled(scale)).x
        fits.append(_minimise(problem, x, some, noise))
    draft.take(fits, some)


def _judged(problem: TwoViews, x: Floats, index: Ints, noise: Noise) -> tuple[Bools, Floats]:
    """Return which targets (A, n) are wrong, and how far each is trusted."""
    square = problem.fits(x, index).with_lost_targets().square / noise.scale_px**2
    return noise.wrong(square, problem.coordinates(index)), noise.weight(square)


def _finish(problem: TwoViews, draft: Draft, noise: Noise | None) -> None:
    """Enter residuals, weights, rank and covariances at the minimisers."""
    index = draft.asked
    fits = problem.fits(draft.x[index], index)
    used = problem.used[index]
    wrong, slope = np.zeros_like(used), np.ones(used.shape)
    if noise is not None:
        wrong, trust = _judged(problem, draft.x[index], index, noise)
        wrong &= used
        fits = fits.with_lost_targets()
        _, slope = noise.loss(fits.square / noise.scale_px**2, problem.coordinates(index))
        slope = np.where(wrong, 0.0, slope)
        draft.weights[index] = np.where(used, np.where(wrong, 0.0, trust), np.nan)
    n_equations = 2 * (problem.seen[index].sum(axis=-1) * ~wrong).sum(axis=1)
    square = np.where(wrong, 0.0, fits.square).sum(axis=1)
    draft.residual_px[index] = np.sqrt(square / np.maximum(n_equations, 1))
    _, J = fits.weighted(np.sqrt(slope))
    draft.check_rank(J, index)
    draft.reason[index[2 * wrong.sum(axis=1) > used.sum(axis=1)]] = StopReason.INCONSISTENT
    good = draft.reason[index] == StopReason.CONVERGED
    index, square, J = index[good], square[good], J[good]
    if noise is None:
        spare = problem.n_spare[index].astype(float)
        variance = square / np.where(spare > 0.0, spare, np.nan)
    else:
        variance = np.full(len(index), noise.scale_px**2)
    draft.covariance[index] = np.linalg.inv(np.swapaxes(J, -1, -2) @ J) * variance[:, None, None]
