"""The whole page, and its text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined

from vmf.report.page import reasons, stable, verdict
from vmf.report.page.claims import thesis
from vmf.report.page.contents import Row, Section, counted, reasoned, remarks, rerun, sections
from vmf.report.page.pictures import Picture, picture
from vmf.report.page.runs import Run, Runs
from vmf.report.page.tables import Table, quantities_table, summary_tables


@dataclass(frozen=True)
class RunSection:
    """Any run on the page: its numbers, figures and spec."""

    anchor: str
    title: str
    path: str
    facts: tuple[tuple[str, str], ...]
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    spec: str
    command: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ThesisPart:
    """What is on the page when it is about the thesis."""

    title: str
    author: str
    sections: tuple[Section, ...]

    @property
    def rows(self) -> tuple[Row, ...]:
        """The table of everything."""
        return tuple(row for section in self.sections for row in section.rows)

    @property
    def own(self) -> str:
        """How many numbers the thesis's own method reproduces."""
        return counted(self.rows)

    @property
    def default(self) -> str:
        """How our default compares."""
        return counted(self.rows, default=True)

    @property
    def reasoned(self) -> str:
        """How many of the numbers that are not reproduced have a reason."""
        count = reasoned(self.rows)
        few = (
            f" {count.unanswered} had most of their questions unanswered; for {count.unanswered_held} "
            "of them something was measured that bears on why."
            if count.unanswered
            else ""
        )
        return (
            f"Of {count.held + count.none + count.unanswered} numbers that are not reproduced, {count.held} "
            f"have a reason that holds in these runs, {count.none} have none.{few}"
        )

    @property
    def definitions(self) -> tuple[str, ...]:
        """What the words of the page mean, exactly."""
        return verdict.DEFINITION, reasons.DEFINITION, stable.DEFINITION


@dataclass(frozen=True)
class Page:
    """Everything that the page says.

    Attributes
    ----------
    title : its title.
    program : what made it.
    thesis : the thesis beside ours, None on a page about other runs.
    overview : runs side by side, None where there is nothing to put there.
    runs : those that no figure of the thesis is made of.
    notes : what makes the runs hard to compare.
    """

    title: str
    program: str
    thesis: ThesisPart | None
    overview: Table | None
    runs: tuple[RunSection, ...]
    notes: tuple[str, ...]


def thesis_part(runs: Runs) -> ThesisPart:
    """Return the thesis beside what these runs found."""
    said = thesis()
    return ThesisPart(said.title, said.author, sections(said, runs))


def run_sections(runs: Sequence[Run]) -> tuple[RunSection, ...]:
    """Return the sections of any runs."""
    return tuple(_section(number, run) for number, run in enumerate(runs, 1))


def _section(number: int, run: Run) -> RunSection:
    study = quantities_table(run)
    facts = [("made by", f"vmf {run.command}")]
    if run.trials is not None:
        facts.append(("trials", str(run.trials)))
    facts += [
        (word, str(run.record[key]))
        for key, word in (("finished", "finished"), ("cpu_s", "CPU time (s)"), ("git_commit", "commit"))
        if run.record.get(key) is not None
    ]
    inputs = run.record.get("inputs")
    if isinstance(inputs, dict):
        facts += [("input", f"{name}, SHA-256 {digest}") for name, digest in inputs.items()]
    spec = run.path / "spec.yaml"
    return RunSection(
        f"run-{number}",
        f"{run.name}, {run.path.name}",
        str(run.path),
        tuple(facts),
        (*summary_tables(run), *(() if study is None else (study,))),
        tuple(picture(path) for path in run.plots),
        spec.read_text(encoding="utf-8", errors="replace") if spec.exists() else "",
        rerun(run),
        remarks(run),
    )


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader("vmf.report.page", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(page: Page) -> str:
    """Return the page as HTML that needs nothing else: style and figures are in it, no scripts."""
    style = resources.files("vmf.report.page").joinpath("templates/style.css").read_text(encoding="utf-8")
    return _environment().get_template("page.html").render(page=page, style=style)
