"""Looks that must hold: a fixed style per method, readable logarithmic ticks."""

from __future__ import annotations

import numpy as np
import pytest
from error_tables import ACCURACY
from hypothesis import given
from hypothesis import strategies as st

from vmf.report.style import log_limits, log_ticks, method_styles, natural_key
from vmf.report.tables import shown_cases


def test_a_method_looks_the_same_in_every_company() -> None:
    everyone = method_styles(ACCURACY)
    assert next(iter(everyone)) == "vmf"
    for method in ACCURACY:
        assert method_styles([method])[method] == everyone[method]


def test_methods_differ_without_colour() -> None:
    looks = method_styles([*ACCURACY, "bundle[focal=2%,rot=1deg]", "unknown"])
    assert len({(s.linestyle, s.marker, s.filled, s.linewidth) for s in looks.values()}) == len(looks)
    assert looks["bundle[focal=1%,rot=0.5deg]"].label == "bundle (focal 1 %, rot 0.5°)"
    assert looks["unknown"].label == "unknown"


@given(st.floats(-9, 6), st.floats(0, 12), st.integers(3, 8))
def test_log_ticks_are_few_and_never_fewer_than_one(low: float, decades: float, most: int) -> None:
    limits = log_limits(np.array([10**low, 10 ** (low + decades)]))
    assert limits is not None
    ticks = log_ticks(*limits, most)
    assert 1 <= len(ticks) <= most
    assert all(limits[0] <= t <= limits[1] for t in ticks)


@pytest.mark.parametrize("values", [[], [0.0, -1.0], [np.nan, np.inf]])
def test_nothing_positive_has_no_log_limits(values: list[float]) -> None:
    assert log_limits(np.array(values)) is None


def test_cases_are_in_numeric_order_and_few() -> None:
    assert sorted(["gap=20", "gap=5"], key=natural_key) == ["gap=5", "gap=20"]
    assert shown_cases(["frame=50", "frame=300", "gap=20", "gap=5"]) == ["gap=5", "gap=20", "frame=300"]
    assert shown_cases([f"gap={i}" for i in range(1, 10)]) == ["gap=1", "gap=5", "gap=9"]
