"""Every number that the thesis is known to print is on the page: read from where they are listed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from vmf.report.page import thesis

SHARED = Path(__file__).resolve().parents[3] / "shared"
EXPERIMENTS = SHARED / "spec/experiments.md"
NUMBER = re.compile(r"(?<![\w.])(?:\d[\d,]*\d|\d)?(?:\.\d+)?(?:e-?\d+)?(?![\w.]*\d)")


def read(path: Path) -> str:
    if not path.exists():
        pytest.skip(f"no {path.name} beside the project, which lists what the thesis prints")
    return path.read_text(encoding="utf-8")


def numbers(text: str) -> set[float]:
    """All numbers in a text: `.075`, `30,720,000`, `1e-10`, `–2560`, `10⁻¹⁰`."""
    return {float(found.replace(",", "")) for found in NUMBER.findall(text) if re.search(r"\d", found)}


def rows() -> Iterator[tuple[str, str]]:
    """The configs of each row of the table of experiments, and what the thesis reports."""
    for line in read(EXPERIMENTS).splitlines():
        # An escaped bar belongs to its cell.
        cells = re.split(r"(?<!\\)\|", line.strip("|"))
        if line.startswith("|") and len(cells) == 4:
            for config in re.findall(r"`(\w+)`", cells[1]):
                yield config, cells[3].strip()


def printed(config: str) -> set[float]:
    """The numbers of a config's claims: those of the thesis, in digits or in words, and after which frame."""
    claims = [claim for figure in thesis().figures if figure.config == config for claim in figure.claims]
    given = {claim.thesis for claim in claims if claim.thesis is not None}
    return given.union(*(numbers(f"{claim.what} {claim.says}") for claim in claims))


def test_numbers_are_found_however_they_are_written() -> None:
    assert numbers("→ .075 rad, 4, 10 of 16; 30,720,000 (0.52 %); .6–.8 m; 1e-10; r11; 3-D") == {
        *(0.075, 4, 10, 16, 30720000, 0.52, 0.6, 0.8, 1e-10, 3),
    }


def test_every_number_of_the_list_of_experiments_is_a_claim() -> None:
    listed = list(rows())
    assert {config for config, _ in listed} <= {figure.config for figure in thesis().figures}
    assert len(listed) >= 18
    missing = {
        (config, number) for config, reported in listed for number in numbers(reported) - printed(config)
    }
    assert missing == set()


def test_table_5_2_is_on_the_page_whole() -> None:
    """Means and standard deviations of three rotations and three translations."""
    text = "".join(read(path) for path in sorted((SHARED / "thesis").glob("*.txt"))[:1])
    if not text:
        pytest.skip("no text of the thesis beside the project")
    table = text.partition("Table 5.2: Mean absolute error")[2].partition("deviation after the 800th")[0]
    # The scan has one point lost: "s.049".
    values = {float(found) for found in re.findall(r"0?\.\d{3,4}", table)}
    assert len(values) == 12
    claims = [
        c for figure in thesis().figures if figure.config == "six_dof_hand_guided" for c in figure.claims
    ]
    assert {claim.thesis for claim in claims if claim.unit in ("rad", "m")} == values
