"""Error statistics with their denominators and bootstrap intervals."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Floats = NDArray[np.float64]

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
    rows = []
    keys = ["protocol", "method", "component", "unit", "case"]
    for key, group in kept.groupby(keys, sort=False, observed=True):
        values = group.loc[group["status"] == "ok", "abs_error"].to_numpy(float)
        refused = int((group["status"] == "refused").sum())
        diverged = int((group["status"] == "diverged").sum())
        clusters = question_clusters(group.loc[group["status"] == "ok"])
        low, high = bootstrap_mean(values, stream(seed, key), resamples, clusters)
        rows.append((*key, len(values), refused, diverged, *_moments(values), low, high))
    return pd.DataFrame(rows, columns=list(SUMMARY))


def _moments(values: Floats) -> tuple[float, float, float, float]:
    if not len(values):
        return (np.nan,) * 4
    std = float(np.std(values, ddof=1)) if len(values) > 1 else np.nan
    return float(values.mean()), std, float(np.median(values)), float(np.percentile(values, 95))


def paired_differences(
    errors: pd.DataFrame, cases: tuple[str, ...], seed: int, resamples: int
) -> pd.DataFrame:
    """Return mean |error| differences (method − vmf) over the questions that both answered, but no bound's.

    The questions are the same, on the same points, poses and noise draws. A positive difference says that
    `vmf` is the better one; `median_ratio` is the ratio of the methods' median errors over the same ones.
    """
    kept = errors[errors["case"].isin(cases)]
    keys = ["protocol", "case", "component", "unit"]
    rows = []
    for key, group in kept.groupby(keys, sort=False, observed=True):
        wide = group.pivot_table(
            index=["trial", "frame", "query"], columns="method", values="abs_error", sort=False
        ).reindex(columns=group["method"].unique())
        if "vmf" not in wide:
            continue
        protocol, case, component, unit = key
        for method in [m for m in wide.columns if m not in ("vmf", "cramer_rao")]:
            both = wide[["vmf", method]].dropna()
            difference = (both[method] - both["vmf"]).to_numpy(float)
            clusters = question_clusters(both.index.to_frame(index=False).assign(case=str(case)))
            low, high = bootstrap_mean(difference, stream(seed, (*key, method)), resamples, clusters)
            mean = float(difference.mean()) if len(difference) else np.nan
            ours = float(both["vmf"].median()) if len(both) else np.nan
            ratio = float(both[method].median()) / ours if len(both) and ours > 0.0 else np.nan
            rows.append((protocol, case, method, component, unit, len(difference), mean, low, high, ratio))
    return pd.DataFrame(rows, columns=list(PAIRED))


def question_clusters(rows: pd.DataFrame) -> NDArray[np.int64]:
    """Return the cluster of each question, within which answers are not independent.

    Simulated questions share the trial that was learned from. Pairs of frames of a recording overlap: they
    share a stretch of time, of five gaps. A single cluster says nothing about its spread; then questions
    count one by one.
    """
    trial = rows["trial"].to_numpy(np.int64)
    stretch = np.array([_gap(case) for case in rows["case"]], np.int64)
    time = np.where(stretch > 0, rows["frame"].to_numpy(np.int64) // np.maximum(5 * stretch, 1), 0)
    number = np.unique(np.stack([trial, time], axis=1), axis=0, return_inverse=True)[1].ravel()
    if len(np.unique(number)) < 2:
        return np.arange(len(rows))
    return np.asarray(number)


def _gap(case: str) -> int:
    name, _, value = str(case).partition("=")
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
    if len(values) < 2:
        return float("nan"), float("nan")
    number = np.arange(len(values)) if clusters is None else np.unique(clusters, return_inverse=True)[1]
    sums, sizes = np.bincount(number, weights=values), np.bincount(number)
    n = len(sums)
    means = []
    left = resamples
    while left > 0:
        draws = min(left, max(_DRAWS // n, 1))
        drawn = rng.integers(0, n, (draws, n))
        means.append(sums[drawn].sum(axis=1) / sizes[drawn].sum(axis=1))
        left -= draws
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(np.concatenate(means), [tail, 100.0 - tail])
    return float(low), float(high)


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
