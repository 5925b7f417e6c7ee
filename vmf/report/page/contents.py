"""What the page of the thesis says: every number beside ours, figure by figure."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from vmf.report.page.claims import CITING, PLACEHOLDERS, Claim, Plot, Thesis, ThesisFigure
from vmf.report.page.evidence import Evidence, evidence, span
from vmf.report.page.measure import ROLES, Value, measure
from vmf.report.page.numbers import printed, short, with_unit
from vmf.report.page.pictures import Picture, picture
from vmf.report.page.runs import Run, Runs
from vmf.report.page.tables import Table, count_words, quantities_table, summary_tables
from vmf.report.page.verdict import Verdict, verdict

# Every trial may have one of its own.
MOST_REMARKS = 8


@dataclass(frozen=True)
class Cell:
    """Our number in one role: as text, with its unit, its ratio to the thesis's, and how it agrees."""

    number: str
    ratio: str
    verdict: Verdict
    n: str


@dataclass(frozen=True)
class Row:
    """One claim beside ours.

    Attributes
    ----------
    what, thesis : the quantity with its unit, and the number or the words of the thesis.
    own : by the thesis's own method.
    default : by our default, None where there is but one way to do it.
    bound : what the Cramér–Rao bound allows, empty where there is none.
    reason : why it does not reproduce, empty if it does.
    figure, anchor : which figure, and where on the page.
    """

    what: str
    thesis: str
    own: Cell
    default: Cell | None
    bound: str
    reason: str
    figure: str
    anchor: str


@dataclass(frozen=True)
class EvidenceRow:
    """What the sweep over the unknown says of one claim."""

    what: str
    thesis: str
    ours: str
    low: str
    high: str
    nearest: str
    at: str
    points: str
    within: bool


@dataclass(frozen=True)
class Reason:
    """Why some claims do not reproduce."""

    quantities: tuple[str, ...]
    words: str


@dataclass(frozen=True)
class Section:
    """One figure of the thesis on the page."""

    id: str
    anchor: str
    title: str
    protocol: str
    remark: str
    agreement: str
    status: str
    rows: tuple[Row, ...]
    reasons: tuple[Reason, ...]
    evidence: tuple[EvidenceRow, ...]
    evidence_words: str
    pictures: tuple[Picture, ...]
    tables: tuple[Table, ...]
    commands: tuple[str, ...]
    notes: tuple[str, ...]


def sections(thesis: Thesis, runs: Runs) -> tuple[Section, ...]:
    """Return every figure of the thesis, whether it was run or not."""
    return tuple(_section(figure, runs) for figure in thesis.figures)


def _section(figure: ThesisFigure, runs: Runs) -> Section:
    run = runs.newest(figure.config)
    swept = runs.named(figure.sweep) if figure.unknowns else ()
    found = [(claim, evidence(claim, figure.unknowns, swept, runs)) for claim in figure.claims]
    rows = tuple(_row(claim, seen, figure, run, runs) for claim, seen in found)
    shown = [
        _evidence_row(claim, row, seen)
        for (claim, seen), row in zip(found, rows, strict=True)
        if seen is not None
    ]
    commands = [rerun(run, figure.config) if run else f"vmf {figure.command} {_path(figure.config)}"]
    if figure.unknowns:
        commands.append(_sweep_command(figure, swept))
    tables = () if run is None else (*summary_tables(run), *_optional(quantities_table(run)))
    return Section(
        figure.id,
        figure.anchor,
        figure.title,
        figure.protocol,
        figure.remark,
        _agreement(rows),
        _status(figure, run, runs),
        rows,
        _reasons(rows),
        tuple(shown),
        _evidence_words(figure, swept, [seen for _, seen in found if seen is not None], runs),
        () if run is None else _pictures(figure, run),
        tables,
        tuple(commands),
        () if run is None else remarks(run),
    )


def _optional(table: Table | None) -> tuple[Table, ...]:
    return () if table is None else (table,)


def _row(claim: Claim, seen: Evidence | None, figure: ThesisFigure, run: Run | None, runs: Runs) -> Row:
    values = {role: measure(claim.ours, run, runs, role) for role in ROLES}
    own = _cell(claim, values["thesis"], run is not None)
    default = None if values["default"] is None else _cell(claim, values["default"], True)
    bound = values["bound"]
    thesis = claim.says if claim.thesis is None else printed(claim.thesis)
    if claim.says and claim.thesis is not None:
        thesis += f" ({claim.says})"
    reason = ""
    if own.verdict is Verdict.NOT or (default is not None and default.verdict is Verdict.NOT):
        reason = _reason(claim, values["thesis"], values["default"], seen)
    return Row(
        _quantity(claim),
        thesis,
        own,
        default,
        "" if bound is None else short(bound.number),
        reason,
        figure.id,
        figure.anchor,
    )


def _cell(claim: Claim, value: Value | None, ran: bool) -> Cell:
    how = verdict(claim, value, ran)
    if value is None:
        return Cell("–", "–", how, "")
    without = "never" if value.n else "no answer"
    number = without if value.number is None else short(value.number)
    if value.mostly_lost and value.n is not None:
        number += f" ({value.n:,} of {value.n + value.lost:,} answered)"
    known = value.number is not None and claim.thesis is not None
    ratio = f"{short(value.number / claim.thesis)}" if known and value.number and claim.thesis else "–"
    lost = f", {value.lost:,} unanswered" if value.lost else ""
    n = "" if value.n is None else f"n = {value.n:,}{lost}"
    return Cell(number, ratio, how, n)


def _reason(claim: Claim, own: Value | None, default: Value | None, seen: Evidence | None) -> str:
    """Return why a claim does not reproduce."""
    if own is not None and own.mostly_lost and own.n is not None:
        return (
            f"of {own.n + own.lost:,} questions the thesis’s own method, as printed, answers {own.n:,}: its "
            "minimisation ends behind a camera, or its tiles do not determine the parameters; a number of "
            "the rest is not that of the thesis."
        )
    cites = any(f"{{{name}}}" in claim.because for name in CITING)
    if not claim.because or (cites and seen is None):
        return "no reason was found."
    words = dict.fromkeys(PLACEHOLDERS, "–")
    words |= {k: with_unit(v.number, claim.unit) for k, v in (("ours", own), ("default", default)) if v}
    if seen is not None:
        words |= {k: with_unit(getattr(seen, k), claim.unit) for k in ("low", "high", "nearest")}
        words |= {"points": str(seen.points), "at": seen.at}
    return claim.because.format_map(words)


def _reasons(rows: Sequence[Row]) -> tuple[Reason, ...]:
    """Return every reason once, with all it is the reason for."""
    found: dict[str, list[str]] = {}
    for row in rows:
        if row.reason:
            found.setdefault(row.reason, []).append(row.what)
    return tuple(Reason(tuple(what), words) for words, what in found.items())


def _evidence_words(figure: ThesisFigure, swept: Sequence[Run], found: Sequence[Evidence], runs: Runs) -> str:
    """Return what was varied, and what came of it, in a sentence or two."""
    if not figure.unknowns:
        return ""
    if not swept:
        return "The sweep over what the thesis leaves open was not run."
    trials = {run.trials for run in swept}
    each = f", {_trials(number)} each" if (number := next(iter(trials))) and len(trials) == 1 else ""
    of_all = f" of {points}" if (points := runs.points.get(figure.sweep, 0)) > len(swept) else ""
    said = f"{span(swept, figure.unknowns)}; {len(swept)}{of_all} combinations{each}"
    empty = max((len(swept) - one.points for one in found), default=0)
    few = (
        f" At up to {empty} combinations fewer than half of the questions were answered, or none: they count "
        "for nothing."
        if empty
        else ""
    )
    together = Counter(path for one in found for path in one.within)
    anywhere = sum(bool(one.within) for one in found)
    return (
        f"What the thesis leaves open was varied: {said}. Of {len(found)} numbers, the thesis’s method "
        f"comes within 25 % of {anywhere} at some combination, and of {max(together.values(), default=0)} "
        f"at one and the same.{few}"
    )


def _quantity(claim: Claim) -> str:
    return f"{claim.what} ({claim.unit})" if claim.unit else claim.what


def _evidence_row(claim: Claim, row: Row, seen: Evidence) -> EvidenceRow:
    return EvidenceRow(
        _quantity(claim),
        row.thesis,
        row.own.number,
        short(seen.low),
        short(seen.high),
        short(seen.nearest),
        seen.at,
        str(seen.points),
        bool(seen.within),
    )


def counted(rows: Sequence[Row], default: bool = False) -> str:
    """Return how many claims agree in which way: by the thesis's own method, or by our default."""
    cells = [row.default if default else row.own for row in rows]
    verdicts = [cell.verdict for cell in cells if cell is not None]
    count = Counter(verdicts)
    words = {Verdict.WORDS: "stated in words alone"}
    return count_words([(count[v], words.get(v, v.value)) for v in Verdict])


def _agreement(rows: Sequence[Row]) -> str:
    """Return a sentence on how a figure agrees."""
    if all(row.own.verdict is Verdict.NOT_RUN and row.default is None for row in rows):
        return "Nothing to compare yet."
    said = f"The thesis’s own method, as printed: {counted(rows)}."
    ours = counted(rows, default=True)
    return f"{said} Our default: {ours}." if ours else said


def _status(figure: ThesisFigure, run: Run | None, runs: Runs) -> str:
    """Return which run a figure is from, or that there is none."""
    if run is None:
        return "Not run."
    said = [f"Run {run.path.name} of {figure.config}"]
    if run.trials is not None:
        said.append(_trials(run.trials))
        said.append(f"{run.settings.get('data.simulate.frames')} frames")
    if run.overrides:
        said.append(f"otherwise than in its config: {', '.join(run.overrides)}")
    others = len(runs.named(figure.config)) - 1
    again = f" The newest of {others + 1} runs of this experiment." if others else ""
    return ", ".join(said) + "." + again


def _trials(number: int) -> str:
    return "1 trial" if number == 1 else f"{number} trials"


def remarks(run: Run) -> tuple[str, ...]:
    """Return what a run says beside its numbers, as long as it is not too much."""
    losses = [f"lost: {loss}" for loss in run.record.get("losses", ())]
    said = [*losses, *(str(note) for note in run.record.get("notes", ()))]
    more = len(said) - MOST_REMARKS
    return (*said[:MOST_REMARKS], *([f"and {more} more, in {run.path.name}/run.json"] if more > 0 else []))


def _pictures(figure: ThesisFigure, run: Run) -> tuple[Picture, ...]:
    if not figure.plots:
        return tuple(picture(path) for path in run.plots)
    found = []
    for plot in figure.plots:
        name, shows = (plot.name, plot.shows) if isinstance(plot, Plot) else (plot, "")
        path = run.plot(name)
        if path is not None:
            found.append(picture(path, shows))
    return tuple(found)


def rerun(run: Run, config: str | None = None) -> str:
    """Return the command that makes a run again: from its config, or from what it left behind."""
    if run.command == "evaluate":
        overrides = map(str, run.record.get("overrides", ()))
        return shlex.join(["vmf", "evaluate", str(run.path.parents[1]), *overrides])
    if config is None:
        return shlex.join(["vmf", run.command, str(run.path / "spec.yaml")])
    return shlex.join(["vmf", run.command, _path(config), *run.overrides])


def _path(config: str) -> str:
    return f"configs/thesis/{config}.yaml"


def _sweep_command(figure: ThesisFigure, swept: Sequence[Run]) -> str:
    command = ["--command", "compare-3d"] if figure.command == "compare-3d" else []
    grid = f"configs/thesis/unknowns/{figure.config}.yaml"
    # Points of several efforts are made by several commands: the grid's own makes them all.
    efforts = {run.overrides for run in swept}
    overrides = next(iter(efforts)) if len(efforts) == 1 else ()
    return shlex.join(["vmf", "sweep", _path(figure.config), "--grid", grid, *overrides, *command])
