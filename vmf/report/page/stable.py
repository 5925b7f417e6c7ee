"""When a curve has settled: the measure behind "stable after 100 frames"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# A curve is settled where it stays within this share of its final value ...
NEAR = 0.25
# ... in the mean over windows from a frame to so many times that frame: single frames are too noisy to
# compare, and early on a window of fixed width would swallow what is asked for.
WINDOW = 1.25
# What may be chance does not unsettle it, a difference within so many standard errors, ...
CHANCE = 2.0
# ... but by no more than so many times what is near: of what varies by more nothing can be told.
_MOST_CHANCE = 2.0
# Frames are tried in steps of so many times the one before: their number is no more exact than that.
_STEP = 1.01
# Answers of one trial are not independent; where trials are too few, stretches of so many frames are counted.
_TRIALS = 4
_STRETCH = 50

DEFINITION = (
    "A curve counts as stable after frame f if from f on its mean over every window of frames g to "
    f"{WINDOW:g} g differs from its final value, the mean over the last half of the frames, by no more than "
    f"{NEAR * 100:.0f} %, or by no more than chance would have it ({CHANCE:g} standard errors over trials, "
    f"or over stretches of {_STRETCH} frames where there are fewer than {_TRIALS} trials), "
    f"{_MOST_CHANCE * NEAR * 100:.0f} % at the most; and if at least "
    "half of the questions of every such window were answered."
)


def first_stable(frames: Floats, values: Floats, trials: Ints | None = None) -> float | None:
    """Return the first frame after which a curve stays near its final value; None if it never does.

    Parameters
    ----------
    frames : (n,) number of frames learned at each value.
    values : (n,) the values; NaN where there is none: where most are, nothing is settled.
    trials : (n,) which trial each is of; None if they are not samples and nothing is left to chance.
    """
    order = np.argsort(frames, kind="stable")
    frames, values = frames[order], values[order]
    clusters = None if trials is None else _clusters(frames, trials[order])
    windows = _windows(frames)
    if not windows:
        return None
    final, off = _mean(values, clusters, frames > frames[-1] / 2)
    stable: float | None = None
    for start, window in reversed(windows):
        mean, error = _mean(values, clusters, window)
        # Where most are unanswered, or nothing is, a comparison with NaN is no agreement.
        near = NEAR * abs(final)
        if not abs(mean - final) <= np.clip(CHANCE * np.hypot(error, off), near, _MOST_CHANCE * near):
            break
        stable = start
    return stable


def strays(frames: Floats, values: Floats, trials: Ints, after: float) -> tuple[float, float] | None:
    """Return the mean of a curve's window from a frame on over its final value, and how far later ones stray.

    Later windows stray by a factor of at least 1, up or down. None if no window begins there, or there is no
    final value.

    Parameters
    ----------
    frames, values, trials : as for `first_stable`.
    after : the frame.
    """
    order = np.argsort(frames, kind="stable")
    frames, values, clusters = frames[order], values[order], _clusters(frames, trials)[order]
    final, _ = _mean(values, clusters, frames > frames[-1] / 2)
    inside = [window for start, window in _windows(frames) if start >= after]
    means = np.array([_mean(values, clusters, window)[0] for window in inside])
    ratios = means[np.isfinite(means)] / final if final > 0.0 else np.zeros(0)
    ratios = ratios[ratios > 0.0]
    if not len(ratios):
        return None
    return float(ratios[0]), float(np.maximum(ratios, 1.0 / ratios).max())


def _windows(frames: Floats) -> list[tuple[float, slice]]:
    """Return the first frames of the windows of a sorted curve, and where in it they are."""
    starts = _starts(np.unique(frames))
    begins = np.searchsorted(frames, starts).tolist()
    ends = np.searchsorted(frames, starts * WINDOW, side="right").tolist()
    return [(s, slice(b, e)) for s, b, e in zip(starts.tolist(), begins, ends, strict=True)]


def _starts(frames: Floats) -> Floats:
    """Return frames whose windows end within the curve, a step apart; none where the curve is too short."""
    if len(frames) < 4:
        return np.zeros(0)
    inside = frames[frames * WINDOW <= frames[-1]]
    number = np.floor(np.log(inside) / np.log(_STEP))
    return np.asarray(inside[np.unique(number, return_index=True)[1]])


def _clusters(frames: Floats, trials: Ints) -> Ints:
    different, number = np.unique(trials, return_inverse=True)
    if len(different) >= _TRIALS:
        return number
    stretch = (frames // _STRETCH).astype(np.int64)
    return np.asarray(number * (int(stretch.max()) + 1) + stretch)


def _mean(values: Floats, clusters: Ints | None, part: slice | Bools) -> tuple[float, float]:
    """Return the mean of a part of the values and its standard error, 0 where nothing is known of it.

    The mean is NaN where most of the values are.
    """
    known = np.isfinite(values[part])
    if not len(known) or 2 * known.sum() < len(known):
        return np.nan, 0.0
    some = values[part][known]
    mean = float(some.mean())
    if clusters is None:
        return mean, 0.0
    # The spread of a ratio of sums over clusters, each of a sum of values and a number of them.
    number = clusters[part][known]
    sizes = np.bincount(number)
    sums = np.bincount(number, weights=some)[sizes > 0]
    sizes = sizes[sizes > 0]
    n = len(sizes)
    if n < 2:
        return mean, 0.0
    residuals = sums - mean * sizes
    return mean, float(np.sqrt(n / (n - 1) * (residuals**2).sum()) / sizes.sum())
