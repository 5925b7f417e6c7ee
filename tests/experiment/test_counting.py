"""Statistics state their denominators, and intervals cover what they say they cover."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from vmf.experiment.statistics import PAIRED, SUMMARY, bootstrap_mean, paired_differences, stream, summarise


def table(rng: np.random.Generator, trials: int = 4, queries: int = 12) -> pd.DataFrame:
    """Errors of two methods on the same questions, some of them refused or diverged."""
    rows = []
    for method in ("vmf", "bundle"):
        for trial in range(trials):
            for query in range(queries):
                status = rng.choice(["ok", "refused", "diverged"], p=[0.6, 0.3, 0.1])
                for component, unit in (("t_x", "m"), ("angle", "rad")):
                    # An answer that does not count would be seen at once if it were counted.
                    error = rng.gamma(2.0) if status == "ok" else np.nan
                    case = f"frame={10 * (1 + query % 2)}"
                    rows.append(
                        (trial, query, "held_out", method, component, unit, error, status, case, query)
                    )
    columns = [
        "trial",
        "frame",
        "protocol",
        "method",
        "component",
        "unit",
        "abs_error",
        "status",
        "case",
        "query",
    ]
    return pd.DataFrame(rows, columns=columns)


def test_a_summary_is_what_a_person_would_compute(rng: np.random.Generator) -> None:
    errors = table(rng)
    counted = summarise(errors, ("frame=10", "frame=20"), 1, 200)
    assert list(counted) == list(SUMMARY)
    assert len(counted) == 2 * 2 * 2
    for row in counted.itertuples():
        mine = errors.query(
            f"method == {row.method!r} and component == {row.component!r} and case == {row.case!r}"
        )
        values = sorted(e for e, s in zip(mine["abs_error"], mine["status"], strict=True) if s == "ok")
        n = len(values)
        mean = math.fsum(values) / n
        assert row.n == n
        assert row.n_refused == sum(s == "refused" for s in mine["status"])
        assert row.n_diverged == sum(s == "diverged" for s in mine["status"])
        assert row.n + row.n_refused + row.n_diverged == len(mine) == 4 * 6
        assert row.mean == pytest.approx(mean, rel=1e-12)
        assert row.std == pytest.approx(
            math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (n - 1)), rel=1e-12
        )
        middle = values[n // 2] if n % 2 else (values[n // 2 - 1] + values[n // 2]) / 2
        assert row.median == pytest.approx(middle, rel=1e-12)
        at = 0.95 * (n - 1)
        below, above = values[int(at)], values[min(int(at) + 1, n - 1)]
        assert row.p95 == pytest.approx(below + (at - int(at)) * (above - below), rel=1e-12)
        assert row.ci_low < row.mean < row.ci_high


def test_refusals_move_no_number_but_their_count(rng: np.random.Generator) -> None:
    errors = table(rng)
    answered = errors[errors["status"] == "ok"]
    numbers = ["n", "mean", "std", "median", "p95", "ci_low", "ci_high"]
    cases = ("frame=10", "frame=20")
    with_them, without = summarise(errors, cases, 1, 100), summarise(answered, cases, 1, 100)
    keys = ["method", "component", "case"]
    a, b = (t.set_index(keys).sort_index() for t in (with_them, without))
    assert a[numbers].equals(b[numbers])
    assert (a["n_refused"] > 0).all()
    assert (b["n_refused"] == 0).all()


def test_where_nothing_was_answered_there_is_a_count_and_no_number(rng: np.random.Generator) -> None:
    errors = table(rng).assign(status="refused", abs_error=np.nan)
    counted = summarise(errors, ("frame=10",), 1, 100)
    assert (counted[["n", "n_diverged"]] == 0).all(axis=None)
    assert (counted["n_refused"] == 24).all()
    assert counted[["mean", "std", "median", "p95", "ci_low", "ci_high"]].isna().all(axis=None)


def test_one_answer_has_a_mean_and_no_spread() -> None:
    low, high = bootstrap_mean(np.array([2.0]), np.random.default_rng(0), 100)
    assert np.isnan([low, high]).all()


def test_cases_left_out_are_left_out(rng: np.random.Generator) -> None:
    assert set(summarise(table(rng), ("frame=20",), 1, 10)["case"]) == {"frame=20"}
    assert len(summarise(table(rng), (), 1, 10)) == 0


@pytest.mark.parametrize("n", [30, 200])
def test_bootstrap_intervals_cover_the_mean_as_often_as_they_say(n: int) -> None:
    """Skew costs the percentile bootstrap about 1/√n of its coverage: 2 % for 30 gamma(2) errors."""
    rng = np.random.default_rng(7)
    experiments, true_mean = 400, 2.0
    covered = 0
    for _ in range(experiments):
        low, high = bootstrap_mean(rng.gamma(2.0, size=n), rng, 400)
        covered += low <= true_mean <= high
    worst, best = 0.95 - 0.11 / math.sqrt(n) - 0.01, 0.96
    assert binom.ppf(1e-4, experiments, worst) <= covered <= binom.ppf(1 - 1e-4, experiments, best)


def test_a_bootstrap_interval_is_that_of_the_normal_distribution_for_many_values() -> None:
    values = np.random.default_rng(3).gamma(2.0, size=4000)
    low, high = bootstrap_mean(values, np.random.default_rng(4), 4000)
    half = 1.96 * values.std() / math.sqrt(len(values))
    # The 2.5 % quantile of 4000 draws has a standard error of 0.042 standard deviations of the mean.
    assert low == pytest.approx(values.mean() - half, abs=5 * 0.042 * half / 1.96)
    assert high == pytest.approx(values.mean() + half, abs=5 * 0.042 * half / 1.96)


def test_many_values_are_resampled_piece_by_piece() -> None:
    values = np.random.default_rng(3).normal(size=1_500_000)
    low, high = bootstrap_mean(values, np.random.default_rng(4), 3)
    assert low <= high
    assert abs(low - values.mean()) < 6 / math.sqrt(len(values))


def test_intervals_depend_on_the_seed_and_on_what_is_counted_only(rng: np.random.Generator) -> None:
    errors = table(rng)
    cases = ("frame=10", "frame=20")
    whole = summarise(errors, cases, 1, 50)
    again = summarise(errors, cases, 1, 50)
    assert whole.equals(again)
    alone = summarise(errors[errors["method"] == "bundle"], cases, 1, 50)
    assert whole[whole["method"] == "bundle"].reset_index(drop=True).equals(alone)
    other = summarise(errors, cases, 2, 50)
    # Few clusters give few different means: two streams may now and then meet in one.
    assert (whole["ci_low"] != other["ci_low"]).mean() > 0.5
    assert stream(1, ("a",)).random() != stream(1, ("b",)).random()


def test_paired_differences_are_over_questions_that_both_answered(rng: np.random.Generator) -> None:
    errors = table(rng)
    paired = paired_differences(errors, ("frame=10", "frame=20"), 1, 200)
    assert list(paired) == list(PAIRED)
    for row in paired.itertuples():
        mine = errors.query(f"component == {row.component!r} and case == {row.case!r} and status == 'ok'")
        ours, theirs = (
            {(r.trial, r.query): r.abs_error for r in mine[mine["method"] == m].itertuples()}
            for m in ("vmf", row.method)
        )
        shared = sorted(ours.keys() & theirs.keys())
        assert 0 < row.n == len(shared) < len(ours)
        assert row.mean_difference == pytest.approx(np.mean([theirs[k] - ours[k] for k in shared]), rel=1e-12)
        ratio = np.median([theirs[k] for k in shared]) / np.median([ours[k] for k in shared])
        assert row.median_ratio == pytest.approx(ratio, rel=1e-12)


def test_a_constant_advantage_is_found_exactly(rng: np.random.Generator) -> None:
    errors = table(rng).assign(status="ok")
    errors["abs_error"] = np.tile(rng.gamma(2.0, size=len(errors) // 2), 2)
    errors.loc[errors["method"] == "bundle", "abs_error"] += 0.25
    paired = paired_differences(errors, ("frame=10", "frame=20"), 1, 50)
    for column in ("mean_difference", "ci_low", "ci_high"):
        np.testing.assert_allclose(paired[column], 0.25, rtol=0, atol=1e-12)
