"""Reasons on the page: looked up in the runs, said with their numbers, disowned where they do not hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import page_runs as made
import pandas as pd
import pytest
from pydantic import ValidationError

from vmf.report.page import Run, Runs, flat, thesis
from vmf.report.page.claims import Axis, Because, Claim, Thesis
from vmf.report.page.contents import Reasoned, Section, reasoned, sections
from vmf.report.page.evidence import Baseline
from vmf.report.page.numbers import short
from vmf.report.page.stable import strays

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
    assert reasoned(written.rows) == Reasoned(held=1)


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
    assert reasoned(written.rows) == Reasoned(none=1)


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
    assert reasoned(written.rows) == Reasoned(len(said), len(bare))


def test_what_only_says_what_is_no_reason_is_none(tmp_path: Path) -> None:
    because = {"says": "Not that.", "holds": {"gain": GAIN}, "explains": False}
    written, said = section(because, run(tmp_path, "here", own=2.0))
    assert said == {"Not that.": True}
    assert reasoned(written.rows) == Reasoned(none=1)


def sweep_of(
    path: Path, *points: tuple[float, float, float, int], effort: tuple[int, int] = (2, FRAMES)
) -> list[Run]:
    """Points of a sweep: an open setting, a given one, the error, and how many questions are refused."""
    runs = []
    for number, (low, noise, error, refused) in enumerate(points):
        trials, frames = effort
        simulate = {"frames": frames, "low": low}
        spec = {"data": {"simulate": simulate}, "evaluate": {"trials": trials}, "noise": {"px": noise}}
        rows = made.answers("vmf[thesis]", "pan", np.full((trials, frames), error), refused)
        written = made.write_run(path / f"point-{number}", spec, rows)
        runs.append(Run("here_unknowns", written, {}, flat(spec), None, None, ()))
    return runs


AXES = [
    {"name": "low", "key": "data.simulate.low"},
    {"name": "noise", "unit": "px", "key": "noise.px", "given": 3},
]


@pytest.mark.parametrize(
    ("points", "held"),
    [
        # Most are answered with less noise alone.
        (
            [(1.0, 3.0, 2.0, 14), (1.0, 0.3, 1.0, 10), (2.0, 0.3, 1.0, 12)],
            {"25 % (low 1), less 75 % (low 1, noise 0.3 px), 50 % at least"},
        ),
        # They are with the noise that is given, elsewhere.
        ([(1.0, 3.0, 2.0, 14), (2.0, 3.0, 2.0, 10), (1.0, 0.3, 1.0, 2)], {"open: low 2"}),
        # Nothing helps.
        ([(1.0, 3.0, 2.0, 14), (1.0, 0.3, 1.0, 14)], set()),
        ([], set()),
    ],
)
def test_why_most_questions_are_unanswered_is_looked_up_in_the_sweep(
    points: list[tuple[float, float, float, int]], held: set[str], tmp_path: Path
) -> None:
    share = {"what": "share", "unit": "%", "value": {"of": "answered"}}
    less = share | {"value": {"of": "answered", "elsewhere": True}}
    known = {
        "noise": {
            "says": "{given} ({most_at}), less {less} ({most_elsewhere_at}), {least} at least",
            "few": "only",
            "when": {"given": share | {"below": 50}, "less": less},
            "holds": {
                "times": {"what": "w", "value": less["value"], "over": share["value"], "above": 1.25},
                "least": share | {"value": {"of": "answered", "elsewhere": True, "share": "least"}},
            },
        },
        "open": {"says": "open: {most_at}", "few": "only", "when": {"most": share | {"above": 50}}},
        # What is left of a few answers is no reason.
        "gain": {"says": "gain", "when": {"gain": {"what": "w", "value": {"of": "same"}, "above": 0}}},
    }
    claim = {
        "what": "error",
        "thesis": 1,
        "ours": {"of": "answers", "component": "pan"},
        "because": list(known),
    }
    figure = {"id": "1", "title": "t", "protocol": "p", "config": "here", "unknowns": AXES, "claims": [claim]}
    page = Thesis.model_validate({"title": "t", "author": "a", "reasons": known, "figures": [figure]})
    rows = made.answers("vmf[thesis]", "pan", np.full((1, 2 * FRAMES), 2.0), refused=13)
    here = Run("here", made.write_run(tmp_path / "here", SPEC, rows), {}, flat(SPEC), None, None, ())
    # The last 8 of 16 frames count, of which 14 refused leave 2.
    written = sections(page, Runs((here, *sweep_of(tmp_path, *points, effort=(1, 2 * FRAMES)))))[0]
    (row,) = written.rows
    first = row.reasons[0][1]
    assert first.unanswered
    assert {number.number for number in first.cited.values()} == {8, 3, 5, 0}
    said = {reason.words.replace("\u00a0", " ") for reason in written.reasons if reason.held}
    said -= {"No reason was found."}
    assert {words for words in said if not words.startswith("Of ")} == held
    assert reasoned(written.rows) == Reasoned(unanswered=1, unanswered_held=len(held))


@pytest.mark.parametrize(
    ("errors", "usual", "found"),
    [
        ([4.0, 2.0, 3.0], [2.0] * 4, "misses"),
        # Two points on one side are next to none.
        ([4.0, 2.0], [2.0] * 4, "none"),
        ([4.0, 1.1], [2.0] * 4, "reaches"),
        ([4.0, 0.5], [2.0] * 4, "brackets"),
        # One part of the usual run is as near with as few trials, or parts of it are on both sides.
        ([4.0, 1.1], [1.1, 3.0, 3.0, 3.0], "effort"),
        ([4.0, 0.5], [0.5, 4.0, 4.0, 4.0], "effort"),
    ],
)
def test_a_sweep_is_held_against_the_usual_run_with_as_few_trials(
    errors: list[float], usual: list[float], found: str, tmp_path: Path
) -> None:
    spec = {"data": {"simulate": {"frames": FRAMES}}, "evaluate": {"trials": len(usual)}}
    rows = made.answers("vmf[thesis]", "pan", np.repeat(np.array(usual)[:, None], FRAMES, axis=1))
    here = Run("here", made.write_run(tmp_path / "here", spec, rows), {}, flat(spec), None, None, ())
    swept = sweep_of(
        tmp_path, *((float(n), 3.0, error, 0) for n, error in enumerate(errors)), effort=(1, FRAMES)
    )
    known = {
        name: {"says": f"{name} {{at}}|{{between}}|{{baseline}}", "sweep": [name], "by": "thesis"}
        for name in ("misses", "reaches", "brackets", "effort", "none")
    }
    claim = {
        "what": "error",
        "thesis": 1,
        "reading": "value",
        "ours": {"of": "answers", "component": "pan"},
        "because": list(known),
    }
    figure = {"id": "1", "title": "t", "protocol": "p", "config": "here", "claims": [claim]}
    figure["unknowns"] = AXES[:1]
    page = Thesis.model_validate({"title": "t", "author": "a", "reasons": known, "figures": [figure]})
    # No two of them are given for one number.
    (reason,) = sections(page, Runs((here, *swept)))[0].reasons
    assert reason.words.split()[0] == found
    at, between, baseline = reason.words.split(" ", 1)[1].split("|")
    # The nearest of 4 and 2, 1.1 or a half is the second, but for a half it is as near as 2 would be.
    assert at == "low 1"
    assert between == ("low 1 and low 0" if 0.5 in errors else "–")
    low, high = short(min(usual)), short(max(usual))
    assert baseline == (high if low == high else f"{low} … {high}")


def test_the_usual_run_is_cut_to_the_frames_of_the_sweep(tmp_path: Path) -> None:
    """An error of 4 for four frames, then of 1: cut to four frames it is 4, and the sweep has four."""
    error = np.array([[4.0] * 4 + [1.0] * 12] * 2)
    spec = {"data": {"simulate": {"frames": 16}}, "evaluate": {"trials": 2}}
    path = made.write_run(tmp_path / "here", spec, made.answers("vmf[thesis]", "pan", error))
    here = Run("here", path, {}, flat(spec), None, None, ())
    swept = sweep_of(tmp_path, (1.0, 3.0, 4.0, 0), effort=(2, 4))
    axes = [Axis.model_validate(axis) for axis in AXES]
    said = Claim.model_validate({"what": "w", "thesis": 1, "ours": {"of": "answers", "component": "pan"}})
    found = made.swept_evidence(said, axes, swept, Runs((here, *swept)), here)
    assert found is not None
    assert found.baseline == Baseline((4.0,), False, False)
    # Points that differ in what the thesis gives are no evidence.
    other = sweep_of(tmp_path / "other", (1.0, 0.3, 1.0, 0), effort=(2, 4))
    assert made.swept_evidence(said, axes, [*swept, *other], Runs((here, *swept, *other)), here) == found


def test_reasons_of_the_thesis_s_page_do_not_contradict_each_other() -> None:
    """What depends on the assumptions has not settled whatever they are, and no bound forbids it."""
    known = thesis().reasons
    apart = {("reaches",), ("brackets",), ("effort",), ("misses",)}
    assert {because.sweep for because in known.values() if because.common} == apart
    for name in ("unsettled", "condition_settling", "bounded"):
        assert set(known[name].sweep or ()) == {"effort", "misses", "none"}


def test_a_curve_is_looked_at_from_the_thesis_s_frame_on(tmp_path: Path) -> None:
    """A curve that ends at 1: 2 in frame 3, and 4 and 1 in the window of frames 4 and 5."""
    error = np.array([[4.0, 4.0, 2.0, 4.0, 1.0, 1.0, 1.0, 1.0]] * 2)
    path = made.write_run(tmp_path / "here", SPEC, made.answers("vmf[thesis]", "pan", error))
    here = Run("here", path, {}, flat(SPEC), None, None, ())
    there, most = ({"what": "w", "value": {"of": "strays", "at": at}} for at in ("there", "most"))
    because = {"says": "{there}, {most} times", "holds": {"there": there, "most": most | {"above": 1.25}}}
    claim = {"thesis": 3, "ours": {"of": "stable", "component": "pan"}}
    assert section(because, here, claim=claim)[1] == {"2, 2.50 times": True}


@pytest.mark.parametrize(("after", "found"), [(3.0, (2.0, 2.5)), (6.0, (1.0, 1.0)), (7.0, None)])
def test_how_far_a_curve_strays(after: float, found: tuple[float, float] | None) -> None:
    frames, values = np.arange(1.0, 9.0), np.array([4.0, 4.0, 2.0, 4.0, 1.0, 1.0, 1.0, 1.0])
    assert strays(frames, values, np.zeros(8, np.int64), after) == found
    half = strays(frames, values[::-1], np.zeros(8, np.int64), 1.0)
    # The last four are 3.5 in the mean; ones are below it by as much.
    assert half == pytest.approx((1 / 3.5, 3.5))


@pytest.mark.parametrize(
    ("method", "points", "at"),
    [("function", {1}, "low 1"), ("triangulate_arun", {0, 1}, "low 0")],
)
def test_a_function_s_errors_larger_than_those_of_no_motion_reproduce_nothing(
    method: str, points: set[int], at: str, tmp_path: Path
) -> None:
    """Of two points at the thesis's number, one is met with errors twice those of no motion.

    How large a rival's errors are is what is claimed of it.
    """
    runs = []
    for number, nothing in enumerate((0.5, 4.0)):
        spec = {"data": {"simulate": {"frames": FRAMES, "low": float(number)}}, "evaluate": {"trials": 1}}
        who = "vmf[thesis]" if method == "function" else method
        rows = [made.answers(who, "pan", np.full((1, FRAMES), 1.0))]
        rows += [made.answers("no_motion", "pan", np.full((1, FRAMES), nothing))]
        path = made.write_run(tmp_path / str(number), spec, pd.concat(rows))
        runs.append(Run("here_unknowns", path, {}, flat(spec), None, None, ()))
    ours = {"of": "answers", "component": "pan", "method": method}
    said = Claim.model_validate({"what": "w", "thesis": 1, "ours": ours})
    axes = [Axis.model_validate(axis) for axis in AXES[:1]]
    found = made.swept_evidence(said, axes, runs, Runs(tuple(runs)))
    assert found is not None
    assert found.within == {tmp_path / str(number) for number in points}
    assert (found.points, found.at) == (len(points), at)


def test_a_number_may_be_held_against_the_thesis_s_own(tmp_path: Path) -> None:
    """A bound of 3 where the thesis has 2."""
    bound = {"what": "w", "value": {"of": "same", "method": "cramer_rao"}, "over": {"of": "said"}}
    it = {"what": "w", "unit": "same", "value": {"of": "same"}}
    holds = {"bound": bound | {"above": 1.25}, "it": it}
    because = {"says": "{bound} times, not {it}", "by": "thesis", "holds": holds}
    rows = [
        made.answers(who, "pan", np.full((2, FRAMES), error))
        for who, error in (("vmf[thesis]", 4.0), ("cramer_rao", 3.0))
    ]
    path = made.write_run(tmp_path / "here", SPEC, pd.concat(rows))
    here = Run("here", path, {}, flat(SPEC), None, None, ())
    assert section(because, here, claim={"thesis": 2, "unit": "m"})[1] == {"1.50 times, not 4\u00a0m": True}
    assert section(because, here, claim={"thesis": 3})[1] == {
        "The reason given does not hold in these runs: w is 1, not above 1.25.": False
    }


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


@pytest.mark.parametrize(
    ("reasons", "because"), [({}, ["it"]), ({"it": NOISE}, []), ({"it": NOISE | {"common": True}}, ["it"])]
)
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
        if claim.thesis and not claim.because and not figure.unknowns
    ]
    # What is counted or computed and comes out as printed, on every run.
    assert all(
        figure.command == "study" for figure in thesis().figures for c in figure.claims if c.what in bare
    )
