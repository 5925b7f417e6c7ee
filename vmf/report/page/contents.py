"""What the page of the thesis says: every number beside ours, figure by figure."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from vmf.report.page.claims import Because, Claim, Plot, Quantity, Thesis, ThesisFigure
from vmf.report.page.evidence import Evidence, Point, answering, as_given, evidence, measured, span
from vmf.report.page.measure import ROLES, Value, measure
from vmf.report.page.numbers import printed, short
from vmf.report.page.pictures import Picture, picture
from vmf.report.page.reasons import Case, Reason, baseline_words, reasons, together
from vmf.report.page.runs import Run, Runs
from vmf.report.page.tables import Table, count_words, quantities_table, summary_tables
from vmf.report.page.verdict import Verdict, verdict

# Every trial may have one of its own.
MOST_REMARKS = 8
# So many quantities and more are not listed one by one where they are all that there are.
_MANY = 4
# Where more of the questions were left unanswered, that is said beside the number.
FEW_UNANSWERED = 0.1
NO_REASON = Reason("", "No reason was found.", {}, held=False)
_WHOSE = {"thesis": "The thesis’s own method", "default": "Our default"}


@dataclass(frozen=True)
class Cell:
    """Our number in one role.

    Attributes
    ----------
    number, ratio : as text, and over the thesis's.
    verdict : how it agrees.
    n : how many answers it is over, and how many are lacking.
    few : how many answered, where many did not; or that the run has no such frames.
    """

    number: str
    ratio: str
    verdict: Verdict
    n: str
    few: str = ""


@dataclass(frozen=True)
class Row:
    """One claim beside ours.

    Attributes
    ----------
    what, thesis : the quantity with its unit, and the number or the words of the thesis.
    own : by the thesis's own method.
    default : by our default, None where there is but one way to do it.
    bound : what the Cramér–Rao bound allows, empty where there is none.
    reasons : why it does not reproduce, by the thesis's own method and by our default.
    figure, anchor : which figure, and where on the page.
    """

    what: str
    thesis: str
    own: Cell
    default: Cell | None
    bound: str
    reasons: tuple[tuple[str, Reason], ...]
    figure: str
    anchor: str


@dataclass(frozen=True)
class EvidenceRow:
    """What the sweep over the unknown says of one claim."""

    what: str
    thesis: str
    ours: str
    baseline: str
    low: str
    high: str
    nearest: str
    at: str
    points: str
    within: bool


@dataclass(frozen=True)
class ReasonRow:
    """Why some claims do not reproduce: whose numbers, which, and in words."""

    whose: str
    quantities: tuple[str, ...]
    words: str
    held: bool


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
    reasons: tuple[ReasonRow, ...]
    evidence: tuple[EvidenceRow, ...]
    evidence_words: str
    pictures: tuple[Picture, ...]
    undrawn: tuple[str, ...]
    tables: tuple[Table, ...]
    commands: tuple[str, ...]
    notes: tuple[str, ...]


def sections(thesis: Thesis, runs: Runs) -> tuple[Section, ...]:
    """Return every figure of the thesis, whether it was run or not."""
    return tuple(_section(figure, runs, thesis.reasons) for figure in thesis.figures)


def _section(figure: ThesisFigure, runs: Runs, known: Mapping[str, Because]) -> Section:
    run = runs.newest(figure.config)
    swept = runs.named(figure.sweep) if figure.unknowns else ()
    points = [measured(claim, figure.unknowns, swept, runs) for claim in figure.claims]
    found = [evidence(claim, of, runs, run) for claim, of in zip(figure.claims, points, strict=True)]
    each = list(zip(figure.claims, points, found, strict=True))
    rows = tuple(_row(claim, of, seen, figure, run, runs, known) for claim, of, seen in each)
    shown = [
        _evidence_row(claim, row, seen)
        for (claim, _, seen), row in zip(each, rows, strict=True)
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
        _evidence_words(figure, swept, [seen for seen in found if seen is not None], runs),
        () if run is None else _pictures(figure, run),
        () if run is None else _undrawn(figure, run),
        tables,
        tuple(commands),
        () if run is None else remarks(run),
    )


def _optional(table: Table | None) -> tuple[Table, ...]:
    return () if table is None else (table,)


def _row(
    claim: Claim,
    points: Sequence[Point],
    seen: Evidence | None,
    figure: ThesisFigure,
    run: Run | None,
    runs: Runs,
    known: Mapping[str, Because],
) -> Row:
    values = {role: measure(claim.ours, run, runs, role) for role in ROLES}
    if run is not None and isinstance(claim.ours, Quantity) and claim.thesis is not None:
        # A study that has no such number has been asked, and had no answer.
        values["thesis"] = values["thesis"] or Value(None, 0)
    own = _cell(claim, values["thesis"], run is not None)
    # What the thesis says of a method in words it does not say of ours.
    said = claim.model_copy(update={"means": None}) if isinstance(claim.ours, Quantity) else claim
    default = None if values["default"] is None else _cell(said, values["default"], True)
    bound = values["bound"]
    thesis = claim.says if claim.thesis is None else printed(claim.thesis)
    if claim.says and claim.thesis is not None:
        thesis += f" ({claim.says})"
    most, elsewhere = answering(points, elsewhere=False), answering(points, elsewhere=True)
    why = [
        (role, reason)
        for role, cell in (("thesis", own), ("default", default))
        if cell is not None and cell.verdict is Verdict.NOT and (value := values[role]) is not None
        for reason in _said(Case(claim, role, value, seen, run, runs, most, elsewhere), known)
    ]
    return Row(
        _quantity(claim),
        thesis,
        own,
        default,
        "" if bound is None else short(bound.number),
        tuple(why),
        figure.id,
        figure.anchor,
    )


def _said(case: Case, known: Mapping[str, Because]) -> tuple[Reason, ...]:
    found = reasons(case, known)
    return found if any(not reason.unanswered for reason in found) else (*found, NO_REASON)


def _cell(claim: Claim, value: Value | None, ran: bool) -> Cell:
    how = verdict(claim, value, ran)
    if value is None:
        return Cell("–", "–", how, "")
    if value.too_short:
        return Cell("–", "–", how, "", f"too short: {short(value.too_short)} frames")
    without = "never" if value.n else "no answer"
    number = without if value.number is None else short(value.number)
    few = ""
    if value.n is not None and value.lost > FEW_UNANSWERED * (value.n + value.lost):
        few = f"{short(value.n)} of {short(value.n + value.lost)} answered"
    known = value.number is not None and claim.thesis is not None
    ratio = f"{short(value.number / claim.thesis)}" if known and value.number and claim.thesis else "–"
    lost = f", {short(value.lost)} unanswered" if value.lost else ""
    n = "" if value.n is None else f"n = {short(value.n)}{lost}"
    return Cell(number, ratio, how, n, few)


def _reasons(rows: Sequence[Row]) -> tuple[ReasonRow, ...]:
    """Return every reason once for all numbers with the same assumptions; those that hold first."""
    found: dict[tuple[str, str, bool, tuple[str, ...]], list[tuple[str, Reason]]] = {}
    for row in rows:
        for role, reason in row.reasons:
            assumed = tuple(
                cited.words for name, cited in reason.cited.items() if f"{{{name}}}" in reason.says
            )
            found.setdefault((role, reason.says, not reason.failed, assumed), []).append((row.what, reason))
    wanting = {
        role: sum(of == role for row in rows for of in {of for of, _ in row.reasons}) for role in _WHOSE
    }
    said = []
    for (role, _, held, _), of in found.items():
        names = tuple(what for what, _ in of)
        if len(names) == wanting[role] >= _MANY:
            names = (f"all {len(names)} numbers that are not reproduced",)
        said.append(ReasonRow(_WHOSE[role], names, together([reason for _, reason in of]), held))
    return tuple(sorted(said, key=lambda reason: not reason.held))


def _evidence_words(figure: ThesisFigure, swept: Sequence[Run], found: Sequence[Evidence], runs: Runs) -> str:
    """Return what was varied, and what came of it, in a sentence or two."""
    if not figure.unknowns:
        return ""
    if not swept:
        return "The sweep over what the thesis leaves open was not run."
    efforts = {(run.trials, run.frames) for run in swept}
    trials, frames = next(iter(efforts))
    each = f", {_trials(trials)} of {frames} frames each" if trials and len(efforts) == 1 else ""
    of_all = f" of {points}" if (points := runs.points.get(figure.sweep, 0)) > len(swept) else ""
    said = f"{span(swept, figure.unknowns)}; {len(swept)}{of_all} combinations{each}"
    points_open = sum(as_given(run, figure.unknowns) for run in swept)
    empty = max((points_open - one.points for one in found), default=0)
    few = (
        f" At up to {empty} combinations fewer than half of the questions were answered, or the function’s "
        "errors were larger than those of no motion: they count for nothing."
        if empty
        else ""
    )
    silent = sum(claim.thesis is not None for claim in figure.claims) - len(found)
    none_counts = f" For {silent} more no combination counts." if silent and found else ""
    together = Counter(path for one in found for path in one.within)
    anywhere = sum(bool(one.within) for one in found)
    alone = sum(one.found == "reaches" for one in found)
    effort = (
        f"; {anywhere - alone} of these {'is' if anywhere - alone == 1 else 'are'} near it or on both sides "
        "of it under the usual assumptions, too, with as few frames and trials"
        if anywhere > alone
        else ""
    )
    numbers = f"{len(found)} number{'s' * (len(found) != 1)}"
    return (
        f"What the thesis leaves open was varied: {said}. Of {numbers}, the thesis’s method "
        f"reproduces {anywhere} at some combination, and {max(together.values(), default=0)} at one and the "
        f"same{effort}.{none_counts}{few}"
    )


def _quantity(claim: Claim) -> str:
    return f"{claim.what} ({claim.unit})" if claim.unit else claim.what


def _evidence_row(claim: Claim, row: Row, seen: Evidence) -> EvidenceRow:
    return EvidenceRow(
        _quantity(claim),
        row.thesis,
        row.own.number,
        baseline_words(seen) or "–",
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


@dataclass(frozen=True)
class Reasoned:
    """How many of the numbers that are not reproduced have a reason.

    Attributes
    ----------
    held, none : those with a reason that holds, and without.
    unanswered : those of which most questions were unanswered, which are in neither.
    unanswered_held : those of them with a reason that holds.
    """

    held: int = 0
    none: int = 0
    unanswered: int = 0
    unanswered_held: int = 0


def reasoned(rows: Sequence[Row]) -> Reasoned:
    """Return how many numbers that are not reproduced have a reason."""
    found: dict[tuple[int, str], list[Reason]] = {}
    for number, row in enumerate(rows):
        for role, reason in row.reasons:
            found.setdefault((number, role), []).append(reason)
    count = Counter(
        (any(reason.unanswered for reason in several), any(reason.held for reason in several))
        for several in found.values()
    )
    few = count[True, True] + count[True, False]
    return Reasoned(count[False, True], count[False, False], few, count[True, True])


def _agreement(rows: Sequence[Row]) -> str:
    """Return a sentence on how a figure agrees."""
    if all(row.own.verdict is Verdict.NOT_RUN and row.default is None for row in rows):
        return "Nothing to compare yet."
    said = [f"The thesis’s own method, as printed: {counted(rows)}."]
    if ours := counted(rows, default=True):
        said.append(f"Our default: {ours}.")
    if few := reasoned(rows).unanswered:
        said.append(f"Of those not reproduced, {few} had most questions left unanswered.")
    return " ".join(said)


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
    own = "" if run.overrides else " with its config’s own effort"
    again = f" The newest{own} of {others + 1} runs of this experiment." if others else ""
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
    drawn = [(path, shows) for name, shows in _named(figure) if (path := run.plot(name)) is not None]
    # Colours are counted outside Python, on all processors at once.
    with ThreadPoolExecutor() as threads:
        return tuple(threads.map(lambda one: picture(*one), drawn))


def _undrawn(figure: ThesisFigure, run: Run) -> tuple[str, ...]:
    """Return the pictures of the figure that the run has not: drawn without, or lost since."""
    return tuple(name for name, _ in _named(figure) if run.plot(name) is None)


def _named(figure: ThesisFigure) -> list[tuple[str, str]]:
    """Return the pictures of a figure by name, and what they show where the figure says so."""
    return [(plot.name, plot.shows) if isinstance(plot, Plot) else (plot, "") for plot in figure.plots]


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
