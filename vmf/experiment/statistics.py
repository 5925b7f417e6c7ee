"""Error statistics with their denominators and bootstrap intervals."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SUMMARY = (
    "protocol",
    "method",
    "component",
    "unit",
    "case",
    "n",
    "n_refused",
    "n_diverged",
    "mean",
    "std",
    "median",
    "p95",
    "ci_low",
    "ci_high",
)
PAIRED = (
    "protocol",
    "case",
    "method",
    "component",
    "unit",
    "n",
    "mean_difference",
    "ci_low",
    "ci_high",
    "median_ratio",
)
# How the case of all answers after more than so many frames begins.
BEYOND = "frame>"
# Such answers of one trial are as smooth as its motion: these many frames are one cluster.
_STRETCH = 50
# Resamples drawn at once: bounds the memory of a bootstrap over many errors.
_DRAWS = 2_000_000


def summarise(errors: pd.DataFrame, cases: tuple[str, ...], seed: int, resamples: int) -> pd.DataFrame:
    """Return the summary of the given cases.

    `n` is the number of answers that the mean is over; refused and diverged questions are counted beside
    it, so that `n + n_refused + n_diverged` were asked.

    Parameters
    ----------
    errors : the tidy table, with `case`.
    cases : case names to keep.
    seed : of the bootstrap.
    resamples : number of bootstrap resamples.
    """
    kept = errors[errors["case"].isin(cases)]
    error, trial, frame = _numbers(kept)
    ok, refused, diverged = ((kept["status"] == s).to_numpy(bool) for s in ("ok", "refused", "diverged"))
    keys, counts, samples, means = [], [], [], []
    for key, group in _groups(kept, ("protocol", "method", "component", "unit", "case")):
        answered = group[ok[group]]
        values, clusters = error[answered], question_clusters(trial[answered], frame[answered], key[-1])
        keys.append(key)
        counts.append((len(values), int(refused[group].sum()), int(diverged[group].sum())))
        samples.append(values)
        means.append(_resampled_means(values, stream(seed, key), resamples, clusters))
    numbers = np.column_stack([_moments(samples), _intervals(means)]).tolist()
    rows = [(*key, *count, *row) for key, count, row in zip(keys, counts, numbers, strict=True)]
    return pd.DataFrame(rows, columns=list(SUMMARY))


def beyond(errors: pd.DataFrame, frames: Sequence[int]) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Return the answers at trained codes after more than so many frames, as cases of their own; their names.

    Parameters
    ----------
    errors : the tidy table.
    frames : numbers of frames learned.
    """
    asked, learned = (errors["protocol"] == "trained_code").to_numpy(bool), errors["frame"].to_numpy()
    names = tuple(f"{BEYOND}{count}" for count in frames)
    parts = [
        errors.loc[asked & (learned > count)].assign(case=name)
        for count, name in zip(frames, names, strict=True)
    ]
    return (pd.concat(parts, ignore_index=True) if parts else errors.iloc[:0]), names


def _numbers(table: pd.DataFrame) -> tuple[Floats, Ints, Ints]:
    """Return the columns that are counted with, as arrays: thousands of small tables leave pandas no time."""
    return (
        table["abs_error"].to_numpy(float),
        table["trial"].to_numpy(np.int64),
        table["frame"].to_numpy(np.int64),
    )


def _groups(table: pd.DataFrame, keys: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Ints]]:
    """Yield the values of `keys` and the rows (n,) that have them, in order of first appearance."""
    codes = np.zeros(len(table), np.int64)
    columns = []
    for key in keys:
        code, values = pd.factorize(table[key])
        codes = codes * len(values) + code
        columns.append((code, list(values)))
    _, first, group = np.unique(codes, return_index=True, return_inverse=True)
    rows = np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1])
    for number in np.argsort(first):
        yield tuple(str(values[code[first[number]]]) for code, values in columns), rows[number]


def _moments(samples: list[Floats]) -> Floats:
    """Return mean, standard deviation, median and 95th percentile (G, 4) of G samples of any sizes."""
    found = np.full((len(samples), 4), np.nan)
    sizes = np.array([len(values) for values in samples], np.int64)
    for size in np.unique(sizes[sizes > 0]):
        which = np.flatnonzero(sizes == size)
        values = np.stack([samples[i] for i in which])
        found[which, 0] = values.mean(axis=1)
        if size > 1:
            found[which, 1] = values.std(axis=1, ddof=1)
        found[which, 2] = np.median(values, axis=1)
        found[which, 3] = np.percentile(values, 95, axis=1)
    return found


def paired_differences(
    errors: pd.DataFrame, cases: tuple[str, ...], seed: int, resamples: int
) -> pd.DataFrame:
    """Return mean |error| differences (method − vmf) over the questions that both answered, but no bound's.

    The questions are the same, on the same points, poses and noise draws. A positive difference says that
    `vmf` is the better one; `median_ratio` is the ratio of the methods' median errors over the same ones.
    """
    kept = errors[errors["case"].isin(cases)]
    error, trial, frame = _numbers(kept)
    query = kept["query"].to_numpy(np.int64)
    method, names = pd.factorize(kept["method"])
    rows, means = [], []
    for key, group in _groups(kept, ("protocol", "case", "component", "unit")):
        protocol, case, component, unit = key
        first, asked = _in_order(np.stack([trial[group], frame[group], query[group]], axis=1))
        answers = np.full((len(names), len(first)), np.nan)
        answers[method[group], asked] = error[group]
        asked_of = {str(names[code]): answers[code] for code in dict.fromkeys(method[group].tolist())}
        asked_of.pop("cramer_rao", None)
        mine = asked_of.pop("vmf", None)
        if mine is None:
            continue
        for name, theirs in asked_of.items():
            both = np.isfinite(mine) & np.isfinite(theirs)
            difference = (theirs - mine)[both]
            where = group[first[both]]
            clusters = question_clusters(trial[where], frame[where], case)
            means.append(_resampled_means(difference, stream(seed, (*key, name)), resamples, clusters))
            mean = float(difference.mean()) if len(difference) else np.nan
            median = float(np.median(mine[both])) if len(difference) else np.nan
            ratio = float(np.median(theirs[both])) / median if median > 0.0 else np.nan
            rows.append((protocol, case, name, component, unit, len(difference), mean, ratio))
    intervals = _intervals(means).tolist()
    rows = [(*row[:-1], *interval, row[-1]) for row, interval in zip(rows, intervals, strict=True)]
    return pd.DataFrame(rows, columns=list(PAIRED))


def _in_order(rows: Ints) -> tuple[Ints, Ints]:
    """Return where each different row first appears, in that order, and the number (n,) of each row."""
    _, first, number = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[number.ravel()]


def question_clusters(trial: Ints, frame: Ints, case: str) -> Ints:
    """Return the cluster (n,) of each question, within which answers are not independent.

    Simulated questions share the trial that was learned from. Pairs of frames of a recording overlap: they
    share a stretch of time, of five gaps; so do the frames of a single trial's curve. A single cluster says
    nothing about its spread; then questions count one by one.
    """
    length = 5 * _gap(case)
    if case.startswith(BEYOND) and len(trial) and (trial == trial[0]).all():
        length = _STRETCH
    time = frame // length if length > 0 else np.zeros_like(frame)
    span = int(time.max(initial=0)) + 1
    different, number = np.unique(trial * span + time, return_inverse=True)
    return np.arange(len(trial)) if len(different) < 2 else number


def _gap(case: str) -> int:
    name, _, value = case.partition("=")
    return int(value) if name == "gap" else 0


def bootstrap_mean(
    values: Floats,
    rng: np.random.Generator,
    resamples: int,
    clusters: NDArray[np.int64] | None = None,
    level: float = 0.95,
) -> tuple[float, float]:
    """Return the percentile bootstrap interval of the mean, resampling whole clusters.

    Parameters
    ----------
    values : (n,) what the mean is over; fewer than two give NaN.
    rng : the resampling's own stream.
    resamples : number of resamples.
    clusters : (n,) which values belong together; each by itself by default.
    level : of the interval.
    """
    low, high = _intervals([_resampled_means(values, rng, resamples, clusters)], level)[0]
    return float(low), float(high)


def _resampled_means(
    values: Floats, rng: np.random.Generator, resamples: int, clusters: Ints | None
) -> Floats:
    """Return the means (resamples,) of values whose clusters are drawn with replacement."""
    if len(values) < 2:
        return np.full(resamples, np.nan)
    number = np.arange(len(values)) if clusters is None else np.unique(clusters, return_inverse=True)[1]
    sums, sizes = np.bincount(number, weights=values), np.bincount(number)
    n, alike = len(sums), len(set(sizes.tolist())) == 1
    means = []
    left = resamples
    while left > 0:
        draws = min(left, max(_DRAWS // n, 1))
        drawn = rng.integers(0, n, (draws, n))
        counts = len(values) if alike else sizes[drawn].sum(axis=1)
        means.append(sums[drawn].sum(axis=1) / counts)
        left -= draws
    return np.concatenate(means)


def _intervals(means: list[Floats], level: float = 0.95) -> Floats:
    """Return the percentile intervals (G, 2) of G samples of equal size."""
    if not means:
        return np.zeros((0, 2))
    tail = 50.0 * (1.0 - level)
    bounds = np.percentile(np.stack(means), [tail, 100.0 - tail], axis=1)
    return np.asarray(bounds.T)


def resampled_medians(
    values: Floats, rng: np.random.Generator, resamples: int, clusters: NDArray[np.int64]
) -> Floats:
    """Return the medians (resamples, k) of columns (n, k) over whole clusters (n,) drawn with replacement.

    All columns see the same draws, so that differences between them are paired.
    """
    number = np.unique(clusters, return_inverse=True)[1]
    n_clusters = int(number.max()) + 1
    order = np.argsort(values, axis=0, kind="stable")
    medians = np.empty((resamples, values.shape[1]))
    step = max(_DRAWS // len(values), 1)
    for begin in range(0, resamples, step):
        n_drawn = min(step, resamples - begin)
        drawn = rng.integers(0, n_clusters, (n_drawn, n_clusters))
        times = np.zeros((n_drawn, n_clusters), np.int64)
        np.add.at(times, (np.arange(n_drawn)[:, None], drawn), 1)
        weight = times[:, number]
        for column, ranked in enumerate(order.T):
            # Each value counts as often as it was drawn; of an even number the middle two are averaged.
            twice = 2 * np.cumsum(weight[:, ranked], axis=1)
            size = twice[:, -1:] // 2
            lower, upper = (twice >= size).argmax(axis=1), (twice > size).argmax(axis=1)
            found = values[ranked, column]
            medians[begin : begin + n_drawn, column] = 0.5 * (found[lower] + found[upper])
    return medians


def stream(seed: int, key: Iterable[object]) -> np.random.Generator:
    """Return a generator that depends on the seed and on what is resampled, not on the order of work."""
    return np.random.default_rng([seed, zlib.crc32("|".join(map(str, key)).encode())])
