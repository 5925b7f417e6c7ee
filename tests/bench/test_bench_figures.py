"""Every figure in miniature: it runs, its ratios are finite, and what it says it checked holds. No speeds."""

from __future__ import annotations

import json
import re
from dataclasses import fields

import numpy as np
import pytest

from vmf.bench import FIGURES, Effort, Reading, Report, Row, as_text, to_json
from vmf.bench.machine import describe

# These start processes of their own, each of which imports everything anew.
SLOW = {"cores", "memory"}


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.long] * (name in SLOW)) for name in FIGURES],
)
def figure(request):
    """Every figure in turn, measured once."""
    return FIGURES[request.param](Effort(quick=True))


def test_a_figure_has_its_name_and_rows(figure):
    assert FIGURES[figure.name]
    assert figure.title
    assert figure.rows


def test_ratios_are_finite_and_between_their_quartiles(figure):
    for row in figure.rows:
        numbers = [row.ratio, row.low, row.high, row.ours_value, row.alternative_value]
        assert np.isfinite(numbers).all(), row
        assert 0.0 < row.low <= row.ratio <= row.high, row
        assert row.repeats >= 1


def test_a_ratio_is_that_of_the_values_beside_it(figure):
    """Medians of ratios and ratios of medians differ, but not beyond the extremes of a repeat."""
    for row in figure.rows:
        times = row.unit == "s" and row.reading is Reading.FASTER
        ours, other = row.ours_value, row.alternative_value
        ratio = other / ours if times else ours / other
        if row.repeats == 1:
            assert row.ratio == pytest.approx(ratio, rel=1e-12), row


def test_every_row_says_what_is_compared(figure):
    for row in figure.rows:
        assert row.case
        assert row.ours != row.alternative
        assert isinstance(row.reading, Reading)


def differences(figure):
    """Relative differences of results that notes state: `equal to 3e-12`, `within 7e-07`."""
    stated = [re.findall(r"(?:equal to|within|and) (\d\.?\d*e[-+]\d+)", row.note) for row in figure.rows]
    return [float(number) for numbers in stated for number in numbers]


def test_both_sides_did_the_same_work(figure):
    found = differences(figure)
    if figure.name == "engines":
        # 38 unknowns from a few dozen noisy observations: condition numbers up to 1e6, nine digits.
        assert found
        assert max(found) < 1e-9
    elif figure.name == "motions":
        # Minimisers to half the digits of their costs, whose tolerances are 1e-8 in SciPy.
        assert found
        assert max(found) < 1e-4
    elif figure.name == "updates":
        # Recursive least squares starts from parameters of zero, trusted to 1e-6.
        assert found
        assert max(found) < 1e-4
    elif figure.name == "cores":
        assert all("bit for bit" in row.note for row in figure.rows)


def test_what_was_not_run_is_marked(figure):
    for row in figure.rows:
        assert row.extrapolated == ("by its exponent" in row.note), row


def test_a_figure_is_json_and_text(figure):
    report = Report(describe(), True, (figure,))
    (read,) = json.loads(to_json(report))["figures"]
    assert read["name"] == figure.name
    assert [set(row) for row in read["rows"]] == [{f.name for f in fields(Row)}] * len(figure.rows)
    said = as_text(report)
    assert figure.name in said
    assert "nan" not in said
