"""Why a number does not reproduce: reasons whose conditions are looked up in the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from vmf.report.page.claims import (
    Answered,
    Answers,
    Because,
    Check,
    Claim,
    Condition,
    Found,
    Measured,
    Ours,
    Ratio,
    Said,
    Same,
    Stable,
    Strays,
)
from vmf.report.page.evidence import Answering, Evidence
from vmf.report.page.measure import Value, measure, strays
from vmf.report.page.numbers import listed, short, with_unit
from vmf.report.page.runs import Run, Runs

DEFINITION = (
    "A reason stands with what the runs measured for it. Where they do not bear it out the page says so, and "
    "the number stays not reproduced without a reason. Where most questions were left unanswered the number "
    "of the rest says little, and what is looked for is why they were."
)


@dataclass(frozen=True)
class Case:
    """A number that does not reproduce.

    Attributes
    ----------
    claim : of the thesis.
    role : whose number: `thesis` or `default`.
    value : the number.
    seen : what the sweep over what is left open says of the thesis's method, if there was one.
    run, runs : of the figure, and all there are.
    most, most_elsewhere : where in that sweep most questions are answered: under assumptions that are open,
        and where what the thesis says is varied.
    """

    claim: Claim
    role: str
    value: Value
    seen: Evidence | None
    run: Run | None
    runs: Runs
    most: Answering | None = None
    most_elsewhere: Answering | None = None

    @property
    def side(self) -> str:
        """On which side of the thesis's number ours is; never is over, and no answer on neither."""
        thesis, number = self.claim.thesis, self.value.number
        if number is None and not self.value.n:
            return ""
        return "under" if thesis is not None and number is not None and number < thesis else "over"

    @property
    def evidence(self) -> Evidence | None:
        """What the sweep says of this number: it has the thesis's method alone."""
        return self.seen if self.role == "thesis" else None

    @property
    def found(self) -> Found:
        """What the sweep finds of this number."""
        return "none" if self.evidence is None else self.evidence.found


@dataclass(frozen=True)
class Cited:
    """What a sentence cites: a number with its unit, or words."""

    number: float | None = None
    unit: str = ""
    words: str = ""


@dataclass(frozen=True)
class Reason:
    """A reason for one number.

    Attributes
    ----------
    name : which; empty if it is none that the thesis's file gives.
    says : its sentence, with what it cites in braces.
    cited : that, by name.
    failed : what would have to be otherwise for it to hold in these runs, with what it cites in braces.
    held : whether it does, and is a reason.
    unanswered : whether it says that most questions were unanswered, which is no reason.
    """

    name: str
    says: str
    cited: Mapping[str, Cited]
    failed: tuple[str, ...] = ()
    held: bool = True
    unanswered: bool = False


def reasons(case: Case, known: Mapping[str, Because]) -> tuple[Reason, ...]:
    """Return the reasons that are given for such a number, whether they hold in these runs or not."""
    common = (name for name, because in known.items() if because.common)
    given = [(name, known[name]) for name in (*case.claim.because, *common)]
    found = [_reason(name, because, case) for name, because in given if _fits(because, case)]
    return (*([_unanswered(case)] if case.value.mostly_lost else []), *found)


def _fits(because: Because, case: Case) -> bool:
    if because.by not in (None, case.role) or because.ours not in (None, case.side):
        return False
    if because.sweep is not None and case.found not in because.sweep:
        return False
    if because.few != "too" and (because.few == "only") != case.value.mostly_lost:
        return False
    return not any(_of_check(key, check, _number(check, case)) for key, check in because.when.items())


def together(several: Sequence[Reason]) -> str:
    """Return a reason that several numbers have in common in words, with the span of what it cites."""
    said = {name: _span([one.cited[name] for one in several]) for name in several[0].cited}
    failed = list(dict.fromkeys(text for one in several for text in one.failed))
    if failed:
        return f"The reason given does not hold in these runs: {'; '.join(failed)}.".format_map(said)
    return several[0].says.strip().format_map(said)


def _span(cited: Sequence[Cited]) -> str:
    words = list(dict.fromkeys(one.words for one in cited if one.words))
    numbers = sorted(one.number for one in cited if one.number is not None)
    if words or not numbers:
        return " or ".join(words) or "–"
    units = {one.unit for one in cited}
    low, high = short(numbers[0]), with_unit(numbers[-1], units.pop() if len(units) == 1 else "")
    return high if short(numbers[0]) == short(numbers[-1]) else f"{low} … {high}"


def _unanswered(case: Case) -> Reason:
    value = case.value
    n = value.n or 0
    return Reason(
        "",
        "Of {asked} questions {answered} were answered. {refused} were refused, as the parameters are not "
        "determined; {diverged} diverged: the minimisation does not converge, or ends behind a camera. A "
        "number of the rest is not that of the thesis.",
        {
            "asked": Cited(n + value.lost),
            "answered": Cited(n),
            "refused": Cited(value.refused),
            "diverged": Cited(value.diverged),
        },
        held=False,
        unanswered=True,
    )


def _reason(name: str, because: Because, case: Case) -> Reason:
    seen = case.evidence
    cited = {"ours": Cited(case.value.number, case.claim.unit)}
    cited["points"] = Cited(None if seen is None else seen.points)
    cited["at"] = Cited(words="" if seen is None else seen.at)
    cited["between"] = Cited(words="" if seen is None else seen.between)
    cited["baseline"] = Cited(words=baseline_words(seen, case.claim.unit))
    cited["most_at"] = Cited(words="" if case.most is None else case.most.at)
    cited["most_elsewhere_at"] = Cited(words="" if case.most_elsewhere is None else case.most_elsewhere.at)
    failed: list[str] = []
    for key, check in (because.when | because.holds).items():
        number = _number(check, case)
        cited[key] = Cited(number, case.claim.unit if check.unit == "same" else check.unit)
        failed += _of_check(key, check, number)
    return Reason(name, because.says, cited, tuple(failed), because.explains and not failed)


def baseline_words(seen: Evidence | None, unit: str = "") -> str:
    """Return what a number is under the usual assumptions with the sweep's effort: `10 … 14 frames`."""
    if seen is None or seen.baseline is None:
        return ""
    numbers = [Cited(number, unit) for number in seen.baseline.numbers]
    said = [_span(numbers)] if numbers else []
    return " or ".join([*said, *(["never"] if seen.baseline.never else [])])


def _of_check(name: str, check: Check, number: float | None) -> list[str]:
    """Return what is wrong with what was measured, citing it by its name."""
    if number is None:
        return [f"{check.what} was not measured"]
    low, high = check.above, check.below
    if (low is None or number > low) and (high is None or number < high):
        return []
    wanted = [
        f"{word} {short(bound)}" for word, bound in (("above", low), ("below", high)) if bound is not None
    ]
    return [f"{check.what} is {{{name}}}, not {listed(wanted)}"]


def _number(check: Check, case: Case) -> float | None:
    value = _side(check.value, check, case)
    if check.over is None or value is None:
        return value
    over = _side(check.over, check, case)
    return value / over if over else None


def _side(asked: Measured, check: Check, case: Case) -> float | None:
    if isinstance(asked, Answered):
        found = case.most_elsewhere if asked.elsewhere else case.most
        if found is None or case.role != "thesis":
            return None
        return found.share if asked.share == "greatest" else found.least
    if isinstance(asked, Said):
        return case.claim.thesis
    role = check.by or case.role
    if isinstance(asked, Strays):
        if not isinstance(case.claim.ours, Stable):
            return None
        far = strays(case.claim.ours, case.run, case.runs, role, case.claim.thesis or 1.0)
        return None if far is None else far[asked.at == "most"]
    ours = _same(asked, case.claim) if isinstance(asked, Same) else asked
    if isinstance(ours, Condition) and ours.after == "thesis":
        ours = ours.model_copy(update={"after": round(case.claim.thesis or 1)})
    if ours is None:
        return None
    if isinstance(ours, Answers | Stable) and ours.method != "function":
        # There is but one way to ask a method that is named.
        role = "thesis"
    value = measure(ours, case.run, case.runs, role)
    return None if value is None else value.number


def _same(asked: Same, claim: Claim) -> Ours | None:
    """Return what a claim asks for, changed; None where it has nothing of the kind."""
    ours: Ours = claim.ours
    if isinstance(ours, Ratio):
        if asked.side is None:
            return ours
        ours = ours.over if asked.side == "over" else ours.under
    changes: dict[str, Any] = asked.model_dump(exclude={"of", "side"}, exclude_none=True)
    if isinstance(ours, Stable) and changes.keys() - {"config", "method", "component"}:
        # When errors settle and what they settle to are asked of the same answers.
        ours = Answers(config=ours.config, method=ours.method, component=ours.component)
    return ours.model_copy(update=changes) if changes.keys() <= type(ours).model_fields.keys() else None
