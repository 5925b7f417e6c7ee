"""The most likely motion for two views of targets whose places are unknown as well (§6.3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vmf.estimate.noise import Noise
from vmf.optimise import ArrowFit
from vmf.solve.outcome import Draft, refusals
from vmf.solve.solution import Solutions, StopReason
from vmf.solve.views import Fits, Views

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# Motions (A, f) to start from, of queries (A,).
Start = Callable[[Ints], Floats]

# More wrong targets than this share, and the motion is looked for again from afar.
_DOUBTFUL = 0.25
# From a scale at which gross errors look like noise down to the noise itself.
_SCALES = (64.0, 16.0, 4.0)
# A start only has to be near.
_NEAR = 1e-4


def drafted(problem: Views, in_stereo: Bools) -> Draft:
    """Return an empty draft: which queries can be asked.

    Parameters
    ----------
    problem : the queries.
    in_stereo : (Q, n) targets that could be used if they were in front of the cameras.
    """
    reason = refusals(problem.used, in_stereo, problem.unknowns.fewest_targets)
    reason[(problem.n_spare < 0) & problem.used.any(axis=1)] = StopReason.TOO_FEW_EQUATIONS
    return Draft.of(problem.unknowns, reason, problem.used)


def most_likely(problem: Views, draft: Draft, starts: Sequence[Start], noise: Noise | None) -> Solutions:
    """Return the motions of least reprojection error over both views, both cameras and all targets.

    Parameters
    ----------
    problem : the queries.
    draft : of `drafted`.
    starts : motions (A, f) to start from, of queries (A,). All are tried: a fit may explain every target and
        still be a local minimum.
    noise : how the pixels scatter; None takes least squares and estimates the noise from what is left.
    """
    index = draft.asked
    if not len(index):
        return draft.solutions()
    q = np.zeros_like(problem.q)
    _enter(draft, [problem.minimise(start(index), index, noise) for start in starts], index, q)
    if noise is not None:
        _look_again(problem, draft, starts, q, noise)
        _without_the_wrong(problem, draft, q, noise)
    _finish(problem, draft, q, noise)
    return draft.solutions()


def _enter(draft: Draft, fits: Sequence[ArrowFit], index: Ints, q: Floats) -> None:
    """Enter the best fit of each query, and the places (Q, n, 3) of its targets."""
    best = draft.take(fits, index)
    q[index] = np.stack([fit.q for fit in fits])[best]


def _look_again(problem: Views, draft: Draft, starts: Sequence[Start], q: Floats, noise: Noise) -> None:
    """Search anew, with the scale of the loss shrinking, where many targets look wrong.

    M. J. Black, A. Rangarajan, "On the unification of line processes, outlier rejection, and robust
    statistics with applications in early vision", IJCV 1996.
    """
    index = np.nonzero(np.isfinite(draft.x).all(axis=1))[0]
    wrong, _, _ = _judged(problem, draft.x[index], q[index], index, noise)
    share = wrong.sum(axis=1) / problem.used[index].sum(axis=1)
    again = (share > _DOUBTFUL) | (draft.reason[index] != StopReason.CONVERGED)
    some = index[again]
    if not len(some):
        return
    # What was found stands unless something better is.
    fits = [problem.minimise(draft.x[some], some, noise)]
    for start in starts:
        x = start(some)
        for scale in _SCALES:
            x = problem.minimise(x, some, noise.scaled(scale), _NEAR).x
        fits.append(problem.minimise(x, some, noise))
    _enter(draft, fits, some, q)


def _without_the_wrong(problem: Views, draft: Draft, q: Floats, noise: Noise) -> None:
    """Go on without the targets that look wrong, which may stand in the way behind a camera."""
    index = draft.asked
    wrong, _, _ = _judged(problem, draft.x[index], q[index], index, noise)
    some = wrong.any(axis=1)
    if not some.any():
        return
    used = problem.used.copy()
    used[index] &= ~wrong
    rest, index = replace(problem, used=used), index[some]
    fit = rest.minimise(draft.x[index], index, noise)
    ended = index[fit.converged]
    draft.x[ended] = fit.x[fit.converged]
    q[ended] = np.where(used[ended][..., None], fit.q[fit.converged], q[ended])


def _judged(problem: Views, x: Floats, q: Floats, index: Ints, noise: Noise) -> tuple[Bools, Floats, Fits]:
    """Return which targets (A, n) are wrong, the slope of each one's loss, and their residuals.

    `x` (A, f) and the places `q` (A, n, 3) are those of the queries `index` (A,).
    """
    fits = problem.fits(x, q, index).with_lost_targets()
    square = np.zeros((len(index), problem.used.shape[1]))
    square[fits.query, fits.target] = fits.square / noise.scale_px**2
    coordinates = problem.coordinates(index)
    wrong = noise.wrong(square, coordinates) & problem.used[index]
    return wrong, noise.loss(square, coordinates)[1], fits


def _finish(problem: Views, draft: Draft, q: Floats, noise: Noise | None) -> None:
    """Enter residuals, weights, rank and covariances at the minimisers."""
    index = draft.asked
    if not len(index):
        return
    used, x = problem.used[index], draft.x[index]
    wrong, slope = np.zeros_like(used), np.ones(used.shape)
    if noise is None:
        fits = problem.fits(x, q[index], index)
    else:
        wrong, slope, fits = _judged(problem, x, q[index], index, noise)
        slope = np.where(wrong, 0.0, slope)
        # In units of what an exact target weighs.
        trust = slope / noise.loss(np.zeros(used.shape), problem.coordinates(index))[1]
        draft.weights[index] = np.where(used, trust, np.nan)
    square = np.zeros(used.shape)
    square[fits.query, fits.target] = fits.square
    square = np.where(wrong, 0.0, square).sum(axis=1)
    n_equations = (problem.coordinates_seen[index] * ~wrong).sum(axis=1)
    draft.residual_px[index] = np.sqrt(square / np.maximum(n_equations, 1))
    if noise is not None:
        # The expected information of a Student t falls short of its observed slope.
        slope = slope * noise.information(problem.coordinates(index))
    J = np.zeros((*used.shape, *fits.J_x.shape[1:]))
    J[fits.query, fits.target] = np.sqrt(slope)[fits.query, fits.target][:, None, None] * fits.J
    J = J.reshape(len(index), -1, J.shape[-1])
    draft.check_rank_of(J, index)
    # Of two halves that contradict each other, nothing says which one is right.
    half = wrong.any(axis=1) & (2 * wrong.sum(axis=1) >= used.sum(axis=1))
    draft.reason[index[half]] = StopReason.INCONSISTENT
    good = draft.reason[index] == StopReason.CONVERGED
    index, square, J = index[good], square[good], J[good]
    if noise is None:
        spare = problem.n_spare[index].astype(float)
        variance = square / np.where(spare > 0.0, spare, np.nan)
    else:
        variance = np.full(len(index), noise.scale_px**2)
    draft.covariance[index] = np.linalg.inv(np.swapaxes(J, -1, -2) @ J) * variance[:, None, None]
