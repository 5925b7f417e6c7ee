"""The clock, the ratios and the report, on work whose answers are known."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from vmf.bench import Effort, Figure, Reading, Report, as_text, to_json, write
from vmf.bench.clock import Times, in_turns, once
from vmf.bench.engines import Runs
from vmf.bench.figure import faster, growth, quicker, share
from vmf.bench.hot_loops import reflections
from vmf.bench.machine import describe, peaks
from vmf.bench.memory import peak_resident
from vmf.errors import InputError


def test_candidates_take_turns_and_all_the_same_number():
    calls = []
    times = in_turns({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 4)
    assert {name: len(t.seconds) for name, t in times.items()} == {"a": 4, "b": 4}
    # After the rounds that do not count, a block of one and a block of the other, four times.
    changes = "".join(c for i, c in enumerate(calls) if i == 0 or calls[i - 1] != c)
    assert changes == "ab" + "ab" * 4


def test_work_returns_its_result_beside_its_time():
    seconds, result = once(lambda: 42)
    assert result == 42
    assert seconds >= 0.0


def test_faster_is_the_alternatives_time_by_ours_turn_by_turn():
    row = faster("n", ("ours", Times(np.array([1.0, 2.0, 4.0]))), ("other", Times(np.array([8.0, 8.0, 8.0]))))
    assert (row.low, row.ratio, row.high) == (3.0, 4.0, 6.0)
    assert (row.ours_value, row.alternative_value, row.repeats) == (2.0, 8.0, 3)
    assert row.reading is Reading.FASTER


def test_an_alternative_measured_once_stands_against_every_repeat():
    row = faster("n", ("ours", Times(np.array([1.0, 2.0, 4.0]))), ("other", Times(np.array([8.0]))))
    assert (row.low, row.ratio, row.high, row.repeats) == (3.0, 4.0, 6.0, 3)


def test_rates_shares_and_quantities_are_ours_by_the_others():
    assert quicker("n", ("ours", [30.0, 30.0]), ("other", [10.0, 15.0]), "1/s").ratio == 2.5
    assert share("n", ("ours", 2.0), ("best", 8.0), "GB/s", "").ratio == 0.25
    assert growth("n", ("ours", 3.0), ("other", 2.0), "bytes").ratio == 1.5


@pytest.mark.parametrize("exponent", [1.0, 2.0, 2.5])
def test_a_law_of_growth_is_found_and_goes_on(exponent):
    runs = Runs("any", {n: [3e-6 * n**exponent] for n in (10, 20, 40)})
    factor, found = runs.law
    assert found == pytest.approx(exponent, rel=1e-12)
    assert factor == pytest.approx(3e-6, rel=1e-9)
    assert runs.expected(160) == pytest.approx(3e-6 * 160**exponent, rel=1e-9)


@pytest.mark.parametrize(("m", "n"), [(5, 3), (3, 5), (400, 39), (1, 1)])
def test_reflections_cost_what_textbooks_say(m, n):
    """2n²(m − n/3) to leading order for tall arrays (Golub and Van Loan, §5.2.2)."""
    exact = sum(4 * (m - j) * (n - j) for j in range(min(m, n)))
    assert reflections(m, n) == exact
    if m > 5 * n:
        assert reflections(m, n) == pytest.approx(2 * n**2 * (m - n / 3), rel=2 / n)


def test_the_machine_is_described():
    machine = describe()
    assert machine.processor
    assert machine.cores >= 1
    assert dict(machine.packages)["numpy"] == np.__version__
    found = peaks(quick=True)
    assert found.dgemm_gflops > 0.0
    assert found.triad_gbs > 0.0


@pytest.fixture
def report():
    rows = (
        faster("N = 10", ("ours", Times(np.array([1e-3]))), ("theirs", Times(np.array([2.0]))), "checked"),
        faster(
            "N = 99",
            ("ours", Times(np.array([1e-5]))),
            ("theirs", Times(np.array([2.0]))),
            extrapolated=True,
        ),
        growth("N = 10", ("held", 2.5e7), ("pose", 184.0), "bytes"),
    )
    return Report(describe(), False, (Figure("any", "this against that", rows, ("one thing is missing",)),))


def test_a_report_is_read_back_from_json(report, tmp_path):
    path = write(report, tmp_path / "deep" / "down")
    read = json.loads(path.read_text())
    assert read["quick"] is False
    assert read["machine"]["processor"] == report.machine.processor
    rows = read["figures"][0]["rows"]
    assert [row["reading"] for row in rows] == ["faster", "faster", "growth"]
    assert [row["extrapolated"] for row in rows] == [False, True, False]
    assert rows[0]["ratio"] == pytest.approx(2000.0)
    assert json.loads(to_json(report)) == read
    assert (path.parent / "bench.txt").read_text().rstrip() == as_text(report)


def test_a_report_reads_well(report):
    said = as_text(report)
    for part in ("2,000 ×", "1 ms", "10 µs", "25 MB", "184 bytes", "~200,000 ×", "~2 s"):
        assert part in said, part
    assert "extrapolated" in said
    assert "note: one thing is missing" in said
    assert "miniature" not in said
    assert "miniature" in as_text(Report(report.machine, True, report.figures))


def test_a_directory_that_cannot_be_made_is_the_users_mistake(report, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write(report, tmp_path / "file" / "below")


def test_the_memory_of_a_process_is_its_own():
    """Linux hands `ru_maxrss` on to the programs that a process starts."""
    held = np.ones(30_000_000)
    said = "from vmf.bench.memory import peak_resident; print(peak_resident())"
    own = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert peak_resident() > held.nbytes
    assert 1_000_000 < int(own.stdout) < peak_resident() - held.nbytes / 2


def test_full_effort_repeats_more():
    assert Effort().repeats > Effort(quick=True).repeats >= 3
