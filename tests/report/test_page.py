"""What the page says of runs whose numbers are known: values, ratios, verdicts, and the sweep's evidence."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import page_runs as made
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from vmf.errors import InputError
from vmf.experiment.check import check
from vmf.experiment.reporting import report
from vmf.report.page import Run, Runs, flat, thesis
from vmf.report.page.claims import Axis, Claim, Ratio, Thesis, ThesisFigure
from vmf.report.page.contents import sections
from vmf.report.page.measure import Value, measure
from vmf.report.page.numbers import printed, short
from vmf.report.page.stable import NEAR, WINDOW, first_stable
from vmf.report.page.verdict import Verdict, verdict
from vmf.spec import is_study, load_all, load_studies, variants

CONFIGS = Path(__file__).resolve().parents[2] / "configs/thesis"
STABLE = {"of": "stable", "component": "pan"}
SPEC = {"data": {"simulate": {"frames": 8}}, "evaluate": {"trials": 2}}


def run_at(path: Path, name: str, command: str = "train", quantities: pd.DataFrame | None = None) -> Run:
    return Run(name, path, {"command": command}, flat(SPEC), None, quantities, ())


def claim(**ours: object) -> Claim:
    return Claim.model_validate({"what": "error", "unit": "rad", "thesis": 0.5, "ours": ours})


@pytest.fixture
def known(tmp_path: Path) -> Runs:
    """Two trials of 4, 3, 2, 1, then 0.4 and 0.6 in turn by the thesis's method; ours a tenth of it."""
    error = np.array([[4, 3, 2, 1, 0.4, 0.6, 0.4, 0.6]] * 2)
    tables = [made.answers("vmf[thesis]", "pan", error, refused=1), made.answers("vmf", "pan", error / 10)]
    path = made.write_run(tmp_path / "pan_tilt-sweep" / "a", SPEC, pd.concat(tables))
    return Runs((run_at(path, "pan_tilt"),))


def test_every_role_is_measured_over_the_frames_asked_for(known: Runs) -> None:
    run = known.newest("pan_tilt")
    mean = claim(of="answers", component="pan").ours
    own, default = (measure(mean, run, known, role) for role in ("thesis", "default"))
    assert own is not None
    assert default is not None
    assert own.number == pytest.approx(0.5)
    assert default.number == pytest.approx(0.05)
    assert (own.n, own.lost) == (8, 0)
    assert measure(mean, run, known, "bound") is None
    every = measure(claim(of="answers", component="pan", after=1).ours, run, known, "thesis")
    assert every is not None
    assert every.n == 14
    median = claim(of="answers", component="pan", after=3, statistic="median").ours
    early = measure(median, run, known, "thesis")
    assert early is not None
    assert early.number == pytest.approx(0.6)


@pytest.mark.parametrize(("after", "short_by"), [(7, False), (8, True), (800, True)])
def test_a_run_that_ends_before_the_frames_asked_for_has_no_number(
    known: Runs, after: int, short_by: bool
) -> None:
    run = known.newest("pan_tilt")
    found = measure(claim(of="answers", component="pan", after=after).ours, run, known, "thesis")
    assert found is not None
    assert (found.number is None, found.too_short) == ((True, 8) if short_by else (False, None))
    expected = Verdict.NO_NUMBER if short_by else Verdict.REPRODUCED
    assert verdict(claim(of="answers", component="pan", after=after), found) is expected


def test_a_curve_is_held_against_the_last_half_and_what_was_refused_there(known: Runs) -> None:
    rows = known.all[0].answers("trained_code", "vmf[thesis]", "pan")
    assert (rows["status"] == "refused").sum() == 1
    settled = measure(claim(of="stable", component="pan").ours, known.all[0], known, "thesis")
    assert settled is not None
    # One question was refused, of the first frame.
    assert (settled.n, settled.lost) == (8, 0)


def test_what_nobody_answered_is_no_number_and_not_reproduced(tmp_path: Path) -> None:
    path = made.write_run(tmp_path / "a", SPEC, made.answers("vmf", "pan", np.ones((1, 8)), refused=8))
    run = run_at(path, "pan_tilt")
    for of in ("answers", "stable"):
        found = measure(claim(of=of, component="pan").ours, run, Runs((run,)), "default")
        assert found is not None
        assert (found.number, found.n) == (None, 0)
        assert found.lost >= 4
        assert verdict(claim(of=of, component="pan"), found) is Verdict.NOT


def test_a_point_that_keeps_a_bound_beats_a_nearer_one_that_does_not(tmp_path: Path) -> None:
    """Of 7 and 30 times, the thesis having at least 10, the second reproduces it."""
    runs = []
    for depth, error in ((1.0, 7.0), (2.0, 30.0)):
        spec = {"name": "u", "data": {"simulate": {"frames": 8, "low": [depth]}}}
        path = tmp_path / str(depth)
        made.write_run(path, spec, made.answers("vmf[thesis]", "pan", np.full((1, 8), error)))
        runs.append(Run("u", path, {}, flat(spec), None, None, ()))
    said = {"what": "w", "thesis": 10, "reading": "at_least", "ours": {"of": "answers", "component": "pan"}}
    axes = [Axis(name="targets from", unit="m", key="data.simulate.low.0")]
    found = made.swept_evidence(Claim.model_validate(said), axes, runs, Runs(tuple(runs)))
    assert found is not None
    assert (found.nearest, found.at, found.within) == (30.0, "targets from 2\u00a0m", {tmp_path / "2.0"})


def test_a_number_of_few_survivors_reproduces_nothing(tmp_path: Path) -> None:
    """Five of the last eight questions unanswered, the others as the thesis has it: no agreement."""
    error = np.full((1, 16), 0.5)
    path = made.write_run(tmp_path / "a", SPEC, made.answers("vmf[thesis]", "pan", error, refused=13))
    run = run_at(path, "pan_tilt")
    found = measure(claim(of="answers", component="pan").ours, run, Runs((run,)), "thesis")
    assert found is not None
    assert (found.number, found.n, found.lost) == (0.5, 3, 5)
    assert verdict(claim(of="answers", component="pan"), found) is Verdict.NOT
    assert made.swept_evidence(claim(of="answers", component="pan"), [], (run,), Runs((run,))) is None


@pytest.mark.parametrize(("refused", "said"), [(16, ""), (17, ""), (18, "14 of 16 answered")])
def test_more_than_a_tenth_of_the_questions_unanswered_is_said_beside_the_number(
    tmp_path: Path, refused: int, said: str
) -> None:
    """Counted over the last half of the frames: what is refused before has yet to settle."""
    rows = made.answers("vmf[thesis]", "pan", np.full((1, 32), 0.1), refused=refused)
    run = run_at(made.write_run(tmp_path / "a", SPEC, rows), "here")
    late = claim(**STABLE).model_copy(update={"thesis": 100.0})
    figure = ThesisFigure(id="1", title="t", protocol="p", config="here", claims=(late,))
    (row,) = sections(Thesis(title="t", author="a", figures=(figure,)), Runs((run,)))[0].rows
    assert row.own.verdict is Verdict.BETTER
    assert row.own.few == said


def test_a_tracker_s_pixels_have_no_bound(tmp_path: Path) -> None:
    path = made.write_run(tmp_path / "a", SPEC, made.answers("cramer_rao", "pan", np.ones((1, 8))))
    spec = {"data": {"simulate": {"frames": 8, "tracker": {"kind": "meanshift"}}}}
    for settings, known in ((SPEC, True), (spec, False)):
        run = Run("pan_tilt", path, {}, flat(settings), None, None, ())
        found = measure(claim(of="answers", component="pan").ours, run, Runs((run,)), "bound")
        assert (found is not None) is known


def test_the_newest_run_of_an_experiment_is_shown() -> None:
    older, newer = (Run("pan_tilt", Path(at), {"finished": at}, {}, None, None, ()) for at in "12")
    assert Runs((newer, older)).newest("pan_tilt") is newer
    # Unless less work went into it than its config has.
    quick = replace(newer, overrides=("evaluate.trials=1",))
    assert Runs((quick, older)).newest("pan_tilt") is older


def test_a_ratio_compares_runs_and_a_rival_with_each_function(known: Runs, tmp_path: Path) -> None:
    path = tmp_path / "pan_tilt_disturbed-sweep" / "a"
    made.write_run(path, SPEC, made.answers("triangulate_arun", "pan", np.full((1, 8), 2.0)))
    runs = Runs((*known.all, run_at(path, "pan_tilt_disturbed")))
    ours = claim(
        of="ratio",
        over={"of": "answers", "component": "pan", "method": "triangulate_arun"},
        under={"of": "answers", "component": "pan", "config": "pan_tilt"},
    ).ours
    own, default = (measure(ours, runs.all[1], runs, role) for role in ("thesis", "default"))
    assert own is not None
    assert default is not None
    assert own.number == pytest.approx(4.0)
    assert default.number == pytest.approx(40.0)
    assert measure(ours, runs.all[1], Runs((runs.all[1],)), "thesis") is None


def test_quantities_are_found_by_name_case_and_component() -> None:
    table = made.quantities(("codes", "a", "", 10.0), ("codes", "b", "", 16.0), ("codes", "b", "x", 1.0))
    run = run_at(Path("nowhere"), "stereo_codes", "study", table)
    runs = Runs((run,))
    found = measure(claim(of="quantity", quantity="codes", case="b").ours, run, runs, "thesis")
    assert found is not None
    assert found.number == 16.0
    assert measure(claim(of="quantity", quantity="codes").ours, run, runs, "thesis") is None
    both = claim(of="quantity", quantity="codes", case="a", default="b").ours
    default = measure(both, run, runs, "default")
    assert default is not None
    assert default.number == 16.0


@given(
    settled=st.integers(20, 300),
    final=st.floats(1e-3, 1e3),
    far=st.floats(1.0 + 2 * NEAR, 100.0),
    trials=st.sampled_from([None, 1, 5]),
)
def test_a_step_is_stable_where_it_steps(settled: int, final: float, far: float, trials: int | None) -> None:
    frames = np.tile(np.arange(1.0, 1001.0), trials or 1)
    values = np.where(frames < settled, far * final, final)
    number = None if trials is None else np.repeat(np.arange(trials), 1000)
    found = first_stable(frames, values, number)
    assert found is not None
    # A window that is partly before the step may be near already; frames are tried in steps of 1 %.
    assert (settled / WINDOW - 1) / 1.01 <= found <= 1.01 * settled + 1
    # Exact in binary.
    assert first_stable(frames, values * 8.0, number) == found
    order = np.random.default_rng(1).permutation(len(frames))
    shuffled = None if number is None else number[order]
    # Sums in another order may differ in their last digits.
    again = first_stable(frames[order], values[order] * (1 + 1e-9 * (frames[order] < settled)), shuffled)
    assert again == pytest.approx(found, rel=0.02)


def test_chance_does_not_unsettle_a_curve_that_has_settled() -> None:
    """|N(0, 1)| about a constant scale has no trend: it settles at once, however few the trials."""
    rng = np.random.default_rng(3)
    frames = np.tile(np.arange(1.0, 2001.0, 10.0), 5)
    trials = np.repeat(np.arange(5), 200)
    error = np.abs(rng.standard_normal(len(frames)))
    decaying = error * (1.0 + 20.0 * np.exp(-frames / 60.0))
    found = first_stable(frames, decaying, trials)
    assert found is not None
    # The scale is within 25 % of its final value from 60 ln(80) = 263 frames on, and far outside of it at 60.
    assert 60 < found < 300


def test_wild_answers_unsettle_a_curve_however_uncertain_they_make_it() -> None:
    """Of three trials one has an answer a thousand times as far off, late: its standard error covers it."""
    frames, trials = np.tile(np.arange(1.0, 1001.0), 3), np.repeat(np.arange(3), 1000)
    calm = np.ones(3000)
    assert first_stable(frames, calm, trials) == 1.0
    wild = np.where((frames == 400) & (trials == 1), 1000.0, calm)
    found = first_stable(frames, wild, trials)
    assert found is not None
    assert found > 400 / 1.01


@pytest.mark.parametrize(("thesis", "short_by"), [(100, None), (500, None), (501, 1000)])
def test_a_curve_says_nothing_of_frames_in_its_last_half(
    thesis: int, short_by: int | None, tmp_path: Path
) -> None:
    error = np.where(np.arange(1000) < 50, 9.0, 1.0)[None]
    path = made.write_run(tmp_path / "a", SPEC, made.answers("vmf[thesis]", "pan", error))
    run = run_at(path, "pan_tilt")
    asked = Claim.model_validate({"what": "w", "thesis": thesis, "ours": STABLE})
    found = measure(asked.ours, run, Runs((run,)), "thesis")
    assert found is not None
    assert found.too_short == short_by
    assert (found.number is None) == (short_by is not None)


def test_what_never_settles_is_said_to_never_settle() -> None:
    frames = np.arange(1.0, 1001.0)
    assert first_stable(frames, frames**2) is None
    assert first_stable(frames, np.ones(1000)) == 1.0
    assert first_stable(frames[:3], np.ones(3)) is None
    assert first_stable(frames, np.full(1000, np.nan)) is None


def test_what_is_mostly_unanswered_has_not_settled() -> None:
    """Four of five questions of the first 300 frames are refused; the rest is as it stays."""
    frames = np.arange(1.0, 1001.0)
    values = np.where((frames <= 300) & (frames % 5 != 0), np.nan, 2.0)
    found = first_stable(frames, values)
    assert found is not None
    # A window of which most lies beyond frame 300 is mostly answered.
    assert 300 / WINDOW < found <= 300
    assert first_stable(frames, np.where(frames > 400, np.nan, 2.0)) is None
    # A few that are missing unsettle nothing.
    assert first_stable(frames, np.where(frames % 5 == 0, np.nan, 2.0)) == 1.0


@given(thesis_says=st.floats(1e-9, 1e9), factor=st.floats(1.0, 1e3))
def test_verdicts_are_the_same_either_way(thesis_says: float, factor: float) -> None:
    from vmf.report.page.measure import Value

    said = {"what": "w", "thesis": thesis_says, "ours": {"of": "stable", "component": "pan"}}
    near = math.log(factor) < math.log(1.25) - 1e-9
    far = math.log(factor) > math.log(1.25) + 1e-9
    for reading in ("error", "value", "at_most", "at_least"):
        one = Claim.model_validate(said | {"reading": reading})
        above, below = verdict(one, Value(thesis_says * factor)), verdict(one, Value(thesis_says / factor))
        if near:
            assert (above, below) == (Verdict.REPRODUCED, Verdict.REPRODUCED)
        elif far:
            kept = (reading == "at_least", reading == "at_most")
            expected = [Verdict.REPRODUCED if k else Verdict.NOT for k in kept]
            if reading == "error":
                expected[1] = Verdict.BETTER
            assert [above, below] == expected
    assert verdict(one, Value(None)) is Verdict.NOT
    assert verdict(one, None, ran=False) is Verdict.NOT_RUN
    assert verdict(one, None) is Verdict.NO_NUMBER


def test_the_sweep_over_the_unknown_is_searched_for_the_nearest(tmp_path: Path) -> None:
    runs = []
    for number, (depth, error) in enumerate(((1.0, 4.0), (2.0, 1.0), (4.0, 0.55))):
        spec = {"name": "u", "data": {"simulate": {"frames": 8, "low": [depth]}}}
        path = tmp_path / str(number)
        made.write_run(path, spec, made.answers("vmf[thesis]", "pan", np.full((1, 8), error)))
        runs.append(Run("u", path, {}, flat(spec), None, None, ()))
    axes = [Axis(name="targets from", unit="m", key="data.simulate.low.0")]
    swept = Runs(tuple(runs))
    found = made.swept_evidence(claim(of="answers", component="pan"), axes, swept.named("u"), swept)
    assert found is not None
    assert (found.points, found.low, found.high) == (3, 0.55, 4.0)
    assert found.within == {tmp_path / "2"}
    assert (found.nearest, found.at) == (0.55, "targets from 4\u00a0m")
    assert made.swept_evidence(claim(of="answers", component="tilt"), axes, swept.named("u"), swept) is None


def test_a_point_is_held_against_the_other_experiment_s_with_the_same_assumptions(tmp_path: Path) -> None:
    """Errors of 4 and 1 without a disturbance, of 5 and 2 with one: 1.25 and 2, and no other ratio."""
    runs = []
    for name, means in (("pan_tilt_unknowns", (4.0, 1.0)), ("disturbed_unknowns", (5.0, 2.0, 9.0))):
        for depth, error in enumerate(means):
            spec = {"name": name, "data": {"simulate": {"frames": 8, "low": [depth]}}}
            path = tmp_path / name / str(depth)
            made.write_run(path, spec, made.answers("vmf[thesis]", "pan", np.full((1, 8), error)))
            runs.append(Run(name, path, {}, flat(spec), None, None, ()))
    usual = tmp_path / "usual"
    made.write_run(usual, SPEC, made.answers("vmf[thesis]", "pan", np.full((1, 8), 0.1)))
    swept = Runs((*runs, run_at(usual, "pan_tilt")))
    axes = [Axis(name="targets from", unit="m", key="data.simulate.low.0")]
    both = {"of": "answers", "component": "pan"}
    ratio = {"of": "ratio", "over": both, "under": both | {"config": "pan_tilt"}}
    said = Claim.model_validate({"what": "times", "thesis": 2, "ours": ratio})
    found = made.swept_evidence(said, axes, swept.named("disturbed_unknowns"), swept)
    assert found is not None
    # The point at 2 m has no partner.
    assert (found.points, found.low, found.high, found.at) == (2, 1.25, 2.0, "targets from 1\u00a0m")
    assert made.swept_evidence(said, axes, swept.named("disturbed_unknowns"), Runs(swept.all[2:])) is None


def test_every_number_of_the_thesis_is_on_the_page_whatever_was_run() -> None:
    written = sections(thesis(), Runs(()))
    assert [s.anchor for s in written] == [f.anchor for f in thesis().figures]
    assert all(row.own.verdict is Verdict.NOT_RUN for s in written for row in s.rows)
    assert sum(len(s.rows) for s in written) == sum(len(f.claims) for f in thesis().figures)


def test_every_config_of_the_page_is_there_and_the_other_way_round() -> None:
    files = {path.stem for path in CONFIGS.glob("*.yaml")}
    grids = {path.stem for path in CONFIGS.glob("unknowns/*.yaml")}
    shown = {figure.config for figure in thesis().figures}
    assert grids == {figure.config for figure in thesis().figures if figure.unknowns}
    assert shown == files


def swept_points(config: str) -> list[dict[str, Any]]:
    """The settings of every point of the sweep over what an experiment leaves open."""
    path, grid = CONFIGS / f"{config}.yaml", variants((), CONFIGS / "unknowns" / f"{config}.yaml")
    given = [variant.overrides for variant in grid]
    if is_study(path):
        return [flat(one.spec.model_dump(mode="json")) for one in load_studies(path, given)]
    loaded = load_all(path, given)
    for one in loaded:
        check(one.spec, None)
    return [flat(one.spec.model_dump(mode="json")) for one in loaded]


@pytest.mark.parametrize("figure", [f for f in thesis().figures if f.unknowns], ids=lambda f: f.config)
def test_every_sweep_over_the_unknown_varies_what_the_page_says(figure: ThesisFigure) -> None:
    points = swept_points(figure.config)
    assert {point["name"] for point in points} == {figure.sweep}
    for axis in figure.unknowns:
        values = [point[axis.key] for point in points]
        assert all(isinstance(value, int | float) for value in values)
        assert len(set(values)) > 1


@pytest.mark.parametrize("figure", [f for f in thesis().figures if f.unknowns], ids=lambda f: f.config)
def test_every_point_has_one_partner_in_the_sweep_of_another_experiment(figure: ThesisFigure) -> None:
    """A claim over another experiment's number finds it once, whatever the assumptions."""
    ratios = [claim.ours for claim in figure.claims if isinstance(claim.ours, Ratio)]
    others = {part.config for ratio in ratios for part in (ratio.over, ratio.under) if part.config}
    for other in others:
        points = swept_points(other)
        for point in swept_points(figure.config):
            assert sum(all(p[axis.key] == point[axis.key] for axis in figure.unknowns) for p in points) == 1


def test_what_has_rivals_is_compared_with_them() -> None:
    for figure in thesis().figures:
        path = CONFIGS / f"{figure.config}.yaml"
        assert (figure.command == "study") == is_study(path)
        assert (figure.command == "compare-3d") == ("\nrivals:" in path.read_text()), figure.config


@pytest.mark.parametrize(
    ("claim_of", "wrong"),
    [
        ({"what": "w", "ours": STABLE}, "neither a number nor words"),
        ({"what": "w", "thesis": 1, "because": ["nobody"], "ours": STABLE}, "nobody"),
        ({"what": "w", "thesis": 1, "ours": {"of": "guess"}}, "guess"),
        ({"what": "w", "thesis": -1, "ours": STABLE}, "greater than 0"),
        ({"what": "w", "thesis": 1, "our": STABLE}, "our"),
    ],
)
def test_a_mistake_in_what_the_thesis_printed_is_refused(claim_of: dict[str, object], wrong: str) -> None:
    figure = {"id": "1", "title": "t", "protocol": "p", "config": "c", "claims": [claim_of]}
    with pytest.raises(ValidationError, match=wrong):
        Thesis.model_validate({"title": "t", "author": "a", "figures": [figure]})


def test_two_figures_cannot_have_one_place() -> None:
    figure = {"id": "5.1", "title": "t", "protocol": "p", "config": "c", "claims": []}
    with pytest.raises(ValidationError, match="fig-5-1"):
        Thesis.model_validate({"title": "t", "author": "a", "figures": [figure, figure | {"id": "5-1"}]})


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (0.0, "0"),
        (0.12345, "0.123"),
        (12.0, "12"),
        (30720000.0, "30\u202f720\u202f000"),
        (1.23e-13, "1.2·10⁻¹³"),
        (1234.5, "1\u202f234"),
        (math.nan, "–"),
        (math.inf, "∞"),
    ],
)
def test_numbers_are_short(value: float | None, text: str) -> None:
    assert short(value) == text


def test_the_thesis_s_numbers_keep_their_digits() -> None:
    assert [printed(v) for v in (0.1135, 30720000, 0.52, 1e-10, 10)] == [
        "0.1135",
        "30\u202f720\u202f000",
        "0.52",
        "1.0·10⁻¹⁰",
        "10",
    ]


def test_a_directory_without_runs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no finished run"):
        report([tmp_path], tmp_path / "report.html")
    with pytest.raises(InputError, match="no such directory"):
        report([tmp_path / "nowhere"], tmp_path / "report.html")


@pytest.mark.parametrize(
    ("means", "number", "expected"),
    [
        ({"above": 1.25}, 2.0, Verdict.AGREES),
        ({"above": 1.25}, 1.0, Verdict.DIFFERS),
        ({"below": 1.0}, 0.5, Verdict.AGREES),
        ({"above": 0.0, "below": 1.0}, 1.5, Verdict.DIFFERS),
        ({"above": 0.0}, None, Verdict.DIFFERS),
        (None, 2.0, Verdict.WORDS),
    ],
)
def test_words_may_say_on_which_side_a_number_is(
    means: dict[str, float] | None, number: float | None, expected: Verdict
) -> None:
    ours = {"of": "answers", "component": "pan"}
    said = Claim.model_validate({"what": "w", "says": "much greater", "means": means, "ours": ours})
    assert verdict(said, Value(number, 9)) is expected
    # Of few answers nothing is said that agrees.
    if means is not None:
        assert verdict(said, Value(number, 4, 5)) is Verdict.DIFFERS
        with pytest.raises(ValueError, match="what is held against a number"):
            Claim.model_validate({"what": "w", "thesis": 1, "means": means, "ours": ours})


def test_a_ratio_counts_the_side_that_answered_less_and_no_other(tmp_path: Path) -> None:
    """Of 8 questions 6 were answered, of 80 elsewhere 70: neither is mostly unanswered, nor is the ratio."""
    few = made.answers("vmf[thesis]", "pan", np.full((1, 16), 1.0), refused=10)
    many = made.answers("vmf[thesis]", "pan", np.full((1, 160), 0.5), refused=90)
    here = run_at(made.write_run(tmp_path / "here", SPEC, few), "disturbed")
    there = run_at(made.write_run(tmp_path / "there", SPEC, many), "pan_tilt")
    both = {"of": "answers", "component": "pan"}
    for ratio in (
        {"of": "ratio", "over": both, "under": both | {"config": "pan_tilt"}},
        {"of": "ratio", "over": both | {"config": "pan_tilt"}, "under": both},
    ):
        said = Claim.model_validate({"what": "times", "thesis": 2, "ours": ratio})
        found = measure(said.ours, here, Runs((here, there)), "thesis")
        assert found is not None
        assert (found.n, found.refused, found.diverged) == (6, 2, 0)
        assert not found.mostly_lost
