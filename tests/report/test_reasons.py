"""Reasons on the page: looked up in the runs, said with their numbers, disowned where they do not hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import page_runs as made
import pandas as pd
import pytest
from pydantic import ValidationError

from vmf.report.page import Run, Runs, flat, thesis
from vmf.report.page.claims import Because, Thesis
from vmf.report.page.contents import Section, reasoned, sections

FRAMES = 8
SPEC = {"data": {"simulate": {"frames": FRAMES}}, "evaluate": {"trials": 2}}
# Errors of 2 where the other run has 0.5, and answers that are half of the truth.
TIMES = {
    "what": "the error over that elsewhere",
    "value": {"of": "same"},
    "over": {"of": "same", "config": "elsewhere"},
    "above": 3,
}
GAIN = {"what": "the slope", "value": {"of": "same", "statistic": "gain"}, "below": 0.8}
NOISE = {"says": "It is noise: {times} times, slope {gain}.", "holds": {"times": TIMES, "gain": GAIN}}


def run(path: Path, name: str, **errors: float) -> Run:
    """A run in which a method's answers are all off by so much, all answered; the truth is twice that."""
    tables = [
        made.answers({"own": "vmf[thesis]", "default": "vmf"}[who], "pan", np.full((2, FRAMES), error))
        for who, error in errors.items()
    ]
    table = pd.concat(tables)
    table = table.assign(truth=2.0 * table["abs_error"], estimate=table["abs_error"])
    return Run(name, made.write_run(path / name, SPEC, table), {}, flat(SPEC), None, None, ())


def section(
    because: dict[str, object], *runs: Run, claim: dict[str, object] | None = None
) -> tuple[Section, dict[str, bool]]:
    """A page's one figure of one claim of 1, with the reasons in words and whether they hold."""
    said = {"what": "error", "thesis": 1, "ours": {"of": "answers", "component": "pan"}, "because": ["it"]}
    figure = {"id": "1", "title": "t", "protocol": "p", "config": "here", "claims": [said | (claim or {})]}
    page = Thesis.model_validate(
        {"title": "t", "author": "a", "reasons": {"it": because}, "figures": [figure]}
    )
    written = sections(page, Runs(runs))[0]
    return written, {reason.words: reason.held for reason in written.reasons}


def test_a_reason_that_holds_says_its_numbers(tmp_path: Path) -> None:
    written, said = section(NOISE, run(tmp_path, "here", own=2.0), run(tmp_path, "elsewhere", own=0.5))
    assert said == {"It is noise: 4 times, slope 0.500.": True}
    assert written.reasons[0].whose == "The thesis’s own method"
    assert reasoned(written.rows) == (1, 0)


@pytest.mark.parametrize(
    ("elsewhere", "wrong"),
    [
        ({"own": 1.0}, "the error over that elsewhere is 2, not above 3"),
        ({"default": 1.0}, "the error over that elsewhere was not measured"),
    ],
)
def test_a_reason_that_does_not_hold_is_said_to_be_none(
    elsewhere: dict[str, float], wrong: str, tmp_path: Path
) -> None:
    written, said = section(NOISE, run(tmp_path, "here", own=2.0), run(tmp_path, "elsewhere", **elsewhere))
    assert said == {f"The reason given does not hold in these runs: {wrong}.": False}
    assert written.rows[0].own.verdict.value == "not reproduced"
    assert reasoned(written.rows) == (0, 1)


@pytest.mark.parametrize(
    ("only", "own", "default", "said"),
    [
        ({}, 2.0, 2.0, {"thesis", "default"}),
        ({"by": "thesis"}, 2.0, 2.0, {"thesis"}),
        ({"by": "default"}, 2.0, 2.0, {"default"}),
        ({"ours": "over"}, 2.0, 0.5, {"thesis"}),
        ({"ours": "under"}, 2.0, 0.5, {"default"}),
        ({"when": {"gain": GAIN | {"below": 0.1}}, "holds": {}, "says": "s"}, 2.0, 2.0, set()),
    ],
)
def test_a_reason_is_given_only_where_it_may_be_one(
    only: dict[str, object], own: float, default: float, said: set[str], tmp_path: Path
) -> None:
    because = {"says": "s {gain}", "holds": {"gain": GAIN}} | only
    # A value is to be met: smaller is not reproduced, either.
    here = run(tmp_path, "here", own=own, default=default)
    written, _ = section(because, here, claim={"reading": "value"})
    given = {role for role, reason in written.rows[0].reasons if reason.name == "it"}
    assert given == said
    bare = {role for role, reason in written.rows[0].reasons if reason.says == "No reason was found."}
    assert bare == {"thesis", "default"} - said
    assert reasoned(written.rows) == (len(said), len(bare))


def test_what_only_says_what_is_no_reason_is_none(tmp_path: Path) -> None:
    because = {"says": "Not that.", "holds": {"gain": GAIN}, "explains": False}
    written, said = section(because, run(tmp_path, "here", own=2.0))
    assert said == {"Not that.": True}
    assert reasoned(written.rows) == (0, 1)


def test_a_number_of_few_survivors_has_that_for_a_reason(tmp_path: Path) -> None:
    rows = made.answers("vmf[thesis]", "pan", np.full((1, 2 * FRAMES), 2.0), refused=13)
    here = Run("here", made.write_run(tmp_path / "here", SPEC, rows), {}, flat(SPEC), None, None, ())
    _, said = section(NOISE, here)
    (words,) = said
    assert words.startswith("Of 8 questions 3 were answered: ")
    assert said[words]


def test_frames_are_looked_at_beyond_those_of_the_thesis(tmp_path: Path) -> None:
    """An error of 4 until frame 4, then of 1: its mean beyond frame 2 is 2, twice the final one."""
    error = np.array([[4.0, 4.0, 4.0, 4.0, 1.0, 1.0, 1.0, 1.0]] * 2)
    path = made.write_run(tmp_path / "here", SPEC, made.answers("vmf[thesis]", "pan", error))
    here = Run("here", path, {}, flat(SPEC), None, None, ())
    beyond = {
        "what": "w",
        "value": {"of": "same", "after": "thesis"},
        "over": {"of": "same", "after": "half"},
    }
    because = {"says": "{beyond} times", "when": {"beyond": beyond | {"above": 1.25}}}
    claim = {"thesis": 2, "ours": {"of": "stable", "component": "pan"}}
    assert section(because, here, claim=claim)[1] == {"2 times": True}


def test_numbers_with_one_reason_share_its_sentence(tmp_path: Path) -> None:
    because = {"says": "off by {it}", "holds": {"it": {"what": "w", "value": {"of": "same"}, "above": 1}}}
    ours = {"of": "answers", "component": "pan"}
    claims = [
        {"what": what, "unit": "rad", "thesis": 1, "because": ["it"], "ours": ours | {"statistic": statistic}}
        for what, statistic in (("mean", "mean"), ("95 %", "p95"))
    ]
    figure = {"id": "1", "title": "t", "protocol": "p", "config": "here", "claims": claims}
    page = Thesis.model_validate(
        {"title": "t", "author": "a", "reasons": {"it": because}, "figures": [figure]}
    )
    error = np.array([[2.0] * 6 + [2.0, 6.0]] * 2)
    path = made.write_run(tmp_path / "here", SPEC, made.answers("vmf[thesis]", "pan", error))
    (reason,) = sections(page, Runs((Run("here", path, {}, flat(SPEC), None, None, ()),)))[0].reasons
    # Half of the last four frames' mean is (3 · 2 + 6) / 4.
    assert reason.quantities == ("mean (rad)", "95 % (rad)")
    assert reason.words == "off by 3 … 6"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"says": "It is so."}, "runs cannot refute it"),
        ({"says": "{gain}", "holds": {"gain": {"what": "w", "value": {"of": "same"}}}}, "cannot refute"),
        ({"says": "{other}", "holds": {"gain": GAIN}}, "{other} is not one of"),
        ({"says": "s", "holds": {"gain": GAIN | {"over": {"of": "guess"}}}}, "guess"),
    ],
)
def test_a_reason_that_nothing_could_refute_is_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Because.model_validate(wrong)


@pytest.mark.parametrize(("reasons", "because"), [({}, ["it"]), ({"it": NOISE}, [])])
def test_reasons_and_their_names_belong_together(reasons: dict[str, object], because: list[str]) -> None:
    claim = {"what": "w", "thesis": 1, "ours": {"of": "stable", "component": "pan"}, "because": because}
    figure = {"id": "1", "title": "t", "protocol": "p", "config": "c", "claims": [claim]}
    with pytest.raises(ValidationError, match="because: it"):
        Thesis.model_validate({"title": "t", "author": "a", "reasons": reasons, "figures": [figure]})


def test_every_number_that_may_not_reproduce_has_a_reason_to_be_checked() -> None:
    bare = [
        claim.what
        for figure in thesis().figures
        for claim in figure.claims
        if claim.thesis and not claim.because
    ]
    # What is counted or computed and comes out as printed, on every run.
    assert all(
        figure.command == "study" for figure in thesis().figures for c in figure.claims if c.what in bare
    )
