"""Every figure draws every kind of run, says what it shows, and shows the numbers of the table."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator

import error_tables as tables
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox, BboxBase

from vmf import report
from vmf.report import (
    calibration_crossover,
    comparison,
    condition_number,
    mean_std_error,
    paired_differences,
    truth_vs_estimate,
)
from vmf.report.absolute_error import absolute_error
from vmf.report.mean_std_error import MAX_POINTS, Curve, blocks, frame_bins, least_trials
from vmf.report.tables import select


@pytest.fixture(autouse=True)
def _no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture(scope="module", params=list(tables.DATA_SETS))
def errors(request: pytest.FixtureRequest) -> pd.DataFrame:
    return tables.DATA_SETS[request.param]()


def texts(figure: Figure) -> str:
    found = [t.get_text() for t in figure.findobj(match=lambda a: hasattr(a, "get_text"))]  # type: ignore[attr-defined]
    return "\n".join(found).replace("\n", " ")


def has(errors: pd.DataFrame, protocol: str) -> bool:
    return bool((errors["protocol"] == protocol).any())


def figures(errors: pd.DataFrame) -> dict[str, Figure]:
    drawn = {f"comparison_{p}": comparison(errors, p) for p in ("trained_code", "held_out") if has(errors, p)}
    if has(errors, "trained_code"):
        drawn |= {f.__name__: f(errors) for f in (truth_vs_estimate, absolute_error, mean_std_error)}
    paired = tables.paired(errors)
    if len(paired):
        drawn["paired_differences"] = paired_differences(paired)
    return drawn


def test_every_figure_of_every_run_has_units_and_nothing_overlaps(errors: pd.DataFrame) -> None:
    for name, figure in figures(errors).items():
        check_layout(name, figure)
        for ax in figure.axes:
            assert re.search(r"\((rad|m)\)", ax.get_ylabel() + ax.get_xlabel()), f"{name}: no unit"


def check_layout(name: str, figure: Figure) -> None:
    """Nothing is empty, cut off or drawn over."""
    layout = figure.get_layout_engine()
    assert layout is not None
    if figure.axes:
        layout.execute(figure)
    canvas = Bbox(figure.bbox.padded(1.0))
    boxes = [box for ax in figure.axes if (box := ax.get_tightbbox()) is not None]
    boxes += [legend.get_window_extent() for legend in figure.legends]
    for ax in figure.axes:
        assert ax.lines or ax.collections, f"{name}: empty panel"
    for i, box in enumerate(boxes):
        assert canvas.containsx(box.x0) and canvas.containsx(box.x1), f"{name}: clipped"  # noqa: PT018
        assert canvas.containsy(box.y0) and canvas.containsy(box.y1), f"{name}: clipped"  # noqa: PT018
        assert not any(overlap(box, other) for other in boxes[:i]), f"{name}: overlap"


def overlap(one: BboxBase, other: BboxBase, slack_px: float = 2.0) -> bool:
    across = min(one.x1, other.x1) - max(one.x0, other.x0)
    down = min(one.y1, other.y1) - max(one.y0, other.y0)
    return bool(min(across, down) > slack_px)


def test_components_the_task_never_moves_are_left_out() -> None:
    assert len(mean_std_error(tables.pan_tilt()).axes) == 3
    assert len(comparison(tables.translation(), "held_out").axes) == 4
    assert len(mean_std_error(tables.six_dof()).axes) == 8


def test_truth_and_estimate_are_those_of_the_last_frames_asked() -> None:
    errors = tables.pan_tilt()
    figure = truth_vs_estimate(errors, trial=3, last=25)
    shown = errors.query("method == 'vmf' and trial == 3 and component == 'pan'").tail(25)
    lines = {str(line.get_label()): line for line in figure.axes[0].lines}
    np.testing.assert_array_equal(lines["true"].get_xdata(), shown["frame"])
    np.testing.assert_array_equal(lines["true"].get_ydata(), shown["truth"])
    np.testing.assert_array_equal(lines["vmf"].get_ydata(), shown["estimate"])
    n_solved = int((shown["status"] == "ok").sum())
    assert np.isfinite(np.asarray(lines["vmf"].get_ydata(), float)).sum() == n_solved
    first, last = shown["frame"].iloc[[0, -1]]
    assert f"the last 25 frames, from {first} to {last}" in texts(figure)
    assert f"vmf: solved {n_solved} of 25" in texts(figure)


def test_frames_that_are_some_of_the_last_are_not_called_the_last() -> None:
    errors = tables.pan_tilt().query("frame % 3 == 1")
    frames = errors["frame"].unique()[-10:]
    assert f"the last 10 frames asked, from {frames[0]} to {frames[-1]}" in texts(
        truth_vs_estimate(errors, trial=3, last=10)
    )


def test_what_was_last_solved_is_shown_where_nothing_since_was() -> None:
    errors = tables.single_trial()
    end = errors["frame"].max()
    lost = (errors["frame"] > end - 30) & (errors["method"] == "vmf")
    errors = errors.assign(
        status=errors["status"].where(~lost, "refused"), estimate=errors["estimate"].mask(lost)
    )
    ax = truth_vs_estimate(errors, last=20).axes[0]
    line = next(line for line in ax.lines if line.get_label() == "vmf")
    assert np.isfinite(np.asarray(line.get_ydata(), float)).sum() == 20


def test_everyone_is_counted_beside_its_points_and_who_has_none_says_so() -> None:
    errors = tables.pan_tilt()
    mine = errors.query("method == 'vmf'")
    last = mine["frame"].max()
    other = mine.assign(method="vmf[other]", status="diverged", estimate=np.nan, abs_error=np.nan)
    early = mine.query("frame < @last - 40").assign(method="vmf[early]")
    some = mine.query("frame > @last - 4").assign(method="vmf[some]")
    some.loc[some["frame"] == last, ["status", "estimate", "abs_error"]] = ["ok", 0.1, 0.1]
    some.loc[some["frame"] < last, ["status", "estimate", "abs_error"]] = ["refused", np.nan, np.nan]
    figure = truth_vs_estimate(pd.concat([errors, other, early, some], ignore_index=True), trial=3, last=30)
    written = texts(figure)
    assert "vmf (other): no point, solved 0 of 30 (30 diverged)" in written
    assert "vmf (early): not asked in these frames" in written
    assert "vmf (some): solved 1 of 4 (3 refused)" in written
    entries = {h.get_label(): h.get_marker() for h in figure.legends[0].legend_handles}  # type: ignore[union-attr]
    assert [marker for label, marker in entries.items() if "other" in label or "early" in label] == [
        "None"
    ] * 2


def test_frames_without_an_answer_are_marked_and_counted() -> None:
    errors = tables.single_trial()
    rows = errors.query("method == 'vmf' and component == 't_x'")
    for figure, asked in ((truth_vs_estimate(errors, last=10_000), rows), (absolute_error(errors), rows)):
        for status in ("refused", "diverged"):
            frames = asked.loc[asked["status"] == status, "frame"]
            marks = next(line for line in figure.axes[2].lines if line.get_label() == f"_{status}")
            np.testing.assert_array_equal(marks.get_xdata(), frames)
            assert f"vmf {status} ({len(frames)} of 160 frames)" in texts(figure)


def test_absolute_error_leaves_gaps_where_there_is_no_answer() -> None:
    errors = tables.single_trial()
    ax = absolute_error(errors).axes[0]
    rows = errors.query("method == 'vmf' and component == 'heading'")
    line = next(line for line in ax.lines if line.get_label() == "vmf")
    np.testing.assert_array_equal(line.get_ydata(), rows["abs_error"])
    assert ax.get_yscale() == "log"


@pytest.fixture(scope="module")
def mean_of_six_methods() -> Figure:
    return mean_std_error(tables.six_dof())


@pytest.mark.parametrize("method", tables.SIX)
def test_mean_and_std_are_over_the_trials_that_answered(method: str, mean_of_six_methods: Figure) -> None:
    errors = tables.six_dof()
    figure = mean_of_six_methods
    ax = next(ax for ax in figure.axes if ax.get_title(loc="left") == "rotation y")
    rows = errors.query("protocol == 'trained_code' and component == 'rot_y' and method == @method")
    by_frame = rows.groupby("frame")["abs_error"]
    line = next(line for line in ax.lines if line.get_label() == method)
    np.testing.assert_allclose(np.asarray(line.get_ydata(), float), by_frame.mean(), rtol=1e-12)
    bands = [
        c for c in ax.collections if isinstance(c, FillBetweenPolyCollection) and c.get_label() == method
    ]
    assert len(bands) == (method == "vmf")
    for band in bands:
        top = (by_frame.mean() + by_frame.std()).max()
        vertices = band.get_paths()[0].vertices
        assert np.max(np.asarray(vertices)[:, 1]) == pytest.approx(top)
        assert np.min(np.asarray(vertices)[:, 1]) >= ax.get_ylim()[0]
    n_solved = int((rows["status"] == "ok").sum())
    assert method in ("cramer_rao", "no_motion") or f"{n_solved:,} of 4,500" in texts(figure)


def test_one_trial_has_no_band() -> None:
    figure = mean_std_error(tables.single_trial())
    assert all(len(ax.collections) == 0 for ax in figure.axes)
    assert "one trial" in texts(figure)


def test_many_frames_are_averaged_within_bins_equally_wide_on_the_axis() -> None:
    frames = np.arange(1.0, 401.0)
    bins = frame_bins(frames, logarithmic=False)
    assert bins.span == "4 frames"
    curve = Curve(frames, frames**2, np.ones(400), np.full(400, 9.0))
    short = blocks(curve, bins)
    np.testing.assert_allclose(short.frames, frames.reshape(-1, 4).mean(axis=1))
    np.testing.assert_allclose(short.mean, (frames**2).reshape(-1, 4).mean(axis=1))
    # Who was asked less is averaged over what there is in the same bins.
    rare = Curve(*(values[::2] for values in (curve.frames, curve.mean, curve.std, curve.trials)))
    np.testing.assert_allclose(blocks(rare, bins).mean, (frames[::2] ** 2).reshape(-1, 2).mean(axis=1))
    line = mean_std_error(tables.pan_tilt()).axes[0].lines[0]
    assert len(np.asarray(line.get_xdata())) <= MAX_POINTS


def test_the_last_frames_leave_a_curve_over_a_logarithmic_axis_as_it_is() -> None:
    curve = np.unique(np.geomspace(2, 1700, 40).round())
    frames = np.union1d(curve, np.arange(1921.0, 2001.0))
    dense = Curve(frames, frames, frames, np.full(len(frames), 9.0))
    drawn = blocks(dense, frame_bins(frames, logarithmic=True))
    np.testing.assert_array_equal(drawn.frames[: len(curve)], curve)
    np.testing.assert_array_equal(drawn.mean[: len(curve)], curve)
    assert len(drawn.frames) <= len(curve) + 2
    assert mean_std_error(_of_frames(frames, 9)).axes[0].get_xscale() == "log"
    assert mean_std_error(_of_frames(frames[-80:], 9)).axes[0].get_xscale() == "linear"


def test_errors_over_a_logarithmic_axis_leave_out_all_but_the_last_of_a_run_and_say_so() -> None:
    curve = np.unique(np.geomspace(2, 1700, 40).round())
    figure = absolute_error(_of_frames(np.union1d(curve, np.arange(1921.0, 2001.0)), 1))
    line = next(line for line in figure.axes[0].lines if line.get_label() == "vmf")
    np.testing.assert_array_equal(line.get_xdata(), [*curve, 2000])
    assert "Of the last 80 frames" in texts(figure)
    assert f"solved {len(curve) + 1} of {len(curve) + 1} frames" in texts(figure)
    every = absolute_error(_of_frames(np.arange(2.0, 52.0), 1))
    assert "Of the last" not in texts(every)


def test_ways_to_end_that_did_not_happen_are_not_counted() -> None:
    errors = _of_frames(np.arange(2.0, 12.0), 1)
    errors["status"] = pd.Categorical(errors["status"], categories=["diverged", "ok", "refused"])
    for figure in (truth_vs_estimate(errors), absolute_error(errors), mean_std_error(errors)):
        assert "refused" not in texts(figure)


def _of_frames(frames: np.ndarray, trials: int) -> pd.DataFrame:
    """Return a table with an answer of vmf after each of some frames in each trial."""
    grid = np.array([(trial, frame) for trial in range(trials) for frame in frames])
    same = {"protocol": "trained_code", "method": "vmf", "component": "pan", "unit": "rad", "status": "ok"}
    return pd.DataFrame({"trial": grid[:, 0].astype(int), "frame": grid[:, 1].astype(int)}).assign(
        **same, case="frame", truth=0.2, estimate=0.3, abs_error=0.1
    )


def test_means_over_a_few_of_the_trials_are_left_out_and_not_bridged() -> None:
    errors = _of_frames(np.arange(2.0, 52.0), 40)
    rare = errors["frame"].between(10, 14) & (errors["trial"] >= 3) | (errors["frame"] == 30)
    # Alone between two frames without a mean.
    rare |= errors["frame"].isin([40, 42])
    errors.loc[rare, ["status", "estimate", "abs_error"]] = ["refused", np.nan, np.nan]
    figure = mean_std_error(errors)
    lines = {str(line.get_label()): line for line in figure.axes[0].lines}
    drawn = pd.Series(
        np.asarray(lines["vmf"].get_ydata(), float), np.asarray(lines["vmf"].get_xdata(), float)
    )
    assert set(drawn.index[drawn.isna()]) == {10, 11, 12, 13, 14, 30, 40, 42}
    assert list(np.asarray(lines["_vmf"].get_xdata())) == [41]
    assert "Lines leave out means over fewer than 4 of the 40 trials." in texts(figure)
    assert "leave out" not in texts(mean_std_error(_of_frames(np.arange(2.0, 52.0), 40)))
    assert [least_trials(n) for n in (1, 2, 3, 5, 30, 31, 100)] == [1, 1, 2, 3, 3, 4, 10]
    # Nothing else to draw: then what there is.
    few = errors[errors["frame"].between(10, 14)]
    assert np.isfinite(np.asarray(mean_std_error(few).axes[0].lines[0].get_ydata(), float)).all()


def test_two_functions_have_their_bands_beside_rivals() -> None:
    errors = tables.six_dof()
    other = errors.query("method == 'vmf'").assign(method="vmf[thesis]")
    figure = mean_std_error(pd.concat([errors, other], ignore_index=True))
    bands = {c.get_label() for c in figure.axes[0].collections if isinstance(c, FillBetweenPolyCollection)}
    assert bands == {"vmf", "vmf[thesis]"}
    assert "over trials of vmf and vmf (thesis)" in texts(figure)


def test_comparison_shows_medians_and_counts_of_each_case() -> None:
    errors = tables.held_out()
    figure = comparison(errors, "held_out")
    ax = next(ax for ax in figure.axes if ax.get_title() == "translation z")
    medians = {line.get_label(): line.get_xdata() for line in ax.lines if ":" in str(line.get_label())}
    written = texts(figure)
    for (case, method), rows in errors[errors["component"] == "t_z"].groupby(["case", "method"]):
        assert float(np.asarray(medians[f"{case}:{method}"])[0]) == pytest.approx(rows["abs_error"].median())
        assert f"{int((rows['status'] == 'ok').sum())}" in written
    assert {"gap = 5", "gap = 20"} <= {t.get_text() for t in figure.axes[0].get_yticklabels()}
    assert all(heading in written for heading in ("answers", "refused", "diverged"))


def test_comparison_of_a_learning_curve_takes_its_last_frame() -> None:
    errors = tables.six_dof()
    figure = comparison(errors, "trained_code")
    last = errors.query("case == 'frame=450' and protocol == 'trained_code' and component == 'rot_x'")
    line = next(line for line in figure.axes[0].lines if line.get_label() == "frame=450:vmf")
    median = last.loc[last["method"] == "vmf", "abs_error"].median()
    assert float(np.asarray(line.get_xdata())[0]) == pytest.approx(median)
    assert "frame = 450, the last of 45" in texts(figure)


def test_paired_differences_are_drawn_where_the_table_says() -> None:
    paired = tables.paired(tables.held_out())
    figure = paired_differences(paired)
    for ax, component in zip(figure.axes, ("rot_x", "rot_y"), strict=False):
        rows = paired[paired["component"] == component]
        points = {line.get_label(): line for line in ax.lines if "|" in str(line.get_label())}
        assert len(points) == len(rows)
        for row in rows.itertuples():
            point = points[f"{row.protocol}|{row.case}:{row.method}"]
            assert float(np.asarray(point.get_xdata())[0]) == pytest.approx(row.mean_difference)
            certain = row.ci_low > 0 or row.ci_high < 0
            assert (point.get_markerfacecolor() != "white") == certain
    assert "← rival" in texts(figure)
    assert "vmf →" in texts(figure)


def test_paired_differences_orders_apart_get_a_symmetric_logarithmic_axis() -> None:
    paired = tables.paired(tables.far_apart())
    assert paired_differences(paired).axes[0].get_xscale() == "symlog"
    near = paired[paired["method"] == "bundle"]
    assert paired_differences(near).axes[0].get_xscale() == "linear"


def test_paired_differences_without_an_interval_or_without_pairs() -> None:
    one = tables.paired(tables.held_out()).head(1).assign(ci_low=np.nan, ci_high=np.nan, n=1)
    assert len(paired_differences(one).axes) == 1
    none = one.assign(mean_difference=np.nan)
    assert "no paired difference" in texts(paired_differences(none))


def test_all_refused_says_so_in_words() -> None:
    errors = tables.all_refused()
    assert "vmf: no point, solved 0 of 40 (28 refused, 12 diverged)" in texts(truth_vs_estimate(errors))
    for figure in (absolute_error(errors), mean_std_error(errors)):
        assert "no frame was solved" in texts(figure) or "nothing was solved" in texts(figure)
    assert "nothing was answered: vmf 0 of 30" in texts(comparison(errors, "held_out"))


BOTH = ("bundle", "triangulate_arun")
SWEEPS = {
    "one rival": tables.calibration_sweep(),
    "two rivals": tables.calibration_sweep(BOTH),
    "two gaps": tables.calibration_sweep(cases=("gap=1", "gap=5")),
    "no distance": tables.calibration_sweep(task="pan_tilt"),
}


@pytest.mark.parametrize("sweep", SWEEPS.values(), ids=SWEEPS)
def test_calibration_crossover_shows_every_case_component_and_kind(
    sweep: tuple[pd.DataFrame, pd.DataFrame],
) -> None:
    curves, crossovers = sweep
    figure = calibration_crossover(curves, crossovers)
    panels = curves.groupby(["case", "component", "kind"]).ngroups
    assert len(figure.axes) == panels
    check_layout("calibration_crossover", figure)
    # Panels of one row share the label of their unit.
    units = [re.findall(r"\((rad|m)\)", ax.get_ylabel()) for ax in figure.axes[::4]]
    assert all(len(unit) == 1 for unit in units)
    written = texts(figure)
    assert "200 questions" in written
    for kind in ("focal length off by (%)", "principal point off by (px)", "rotation off by (°)"):
        assert kind in written


def test_calibration_crossover_draws_the_medians_and_marks_where_the_rival_falls_behind() -> None:
    curves, crossovers = tables.calibration_sweep(BOTH)
    figure = calibration_crossover(curves, crossovers)
    row = [ax for ax in figure.axes if ax.get_position().y0 == figure.axes[-1].get_position().y0]
    for ax, kind in zip(row, ("focal", "principal", "rotation", "baseline"), strict=True):
        for rival in BOTH:
            mine = select(curves, component="distance", kind=kind, method=rival)
            line = next(line for line in ax.lines if line.get_label() == rival)
            np.testing.assert_array_equal(line.get_xdata(), mine["magnitude"])
            np.testing.assert_array_equal(line.get_ydata(), mine["median"])
            end = select(crossovers, component="distance", kind=kind, method=rival)
            where = end["crossover"].item()
            marks = [line for line in ax.lines if line.get_label() == f"end:{rival}"]
            said = "\n".join(text.get_text() for text in ax.texts)
            assert len(marks) == np.isfinite(where)
            for mark in marks:
                assert float(np.asarray(mark.get_xdata())[0]) == where
                assert f"from {where:.2g}" in said
            if not marks:
                assert f"not up to {end['largest'].item():g}" in said
        for method in ("vmf", "cramer_rao"):
            level = select(curves, component="distance", kind=kind, method=method)["median"]
            heights = [float(np.asarray(line.get_ydata())[0]) for line in ax.lines]
            assert any(height == level.iloc[0] for height in heights)


def test_calibration_crossover_without_an_answer_says_so() -> None:
    curves, crossovers = tables.calibration_sweep()
    assert "nothing was answered" in texts(calibration_crossover(curves.assign(n=0), crossovers))
    assert "nothing was answered" in texts(calibration_crossover(curves.head(0), crossovers.assign(n=0)))


def test_the_line_of_the_bound_is_its_mean_and_not_its_draw() -> None:
    errors = tables.single_trial()
    bound = errors["method"] == "cramer_rao"
    mean = np.where(bound, 0.01, np.nan)
    drawn = errors.assign(expected_error=mean)
    for figure in (mean_std_error(drawn), absolute_error(drawn)):
        for ax in figure.axes:
            line = next(line for line in ax.lines if line.get_label() == "cramer_rao")
            np.testing.assert_allclose(np.asarray(line.get_ydata(), float), 0.01)
        assert "Cramér–Rao bound" in texts(figure)
    for figure in (mean_std_error(errors), absolute_error(errors)):
        line = next(line for line in figure.axes[0].lines if line.get_label() == "cramer_rao")
        assert not np.allclose(np.asarray(line.get_ydata(), float), 0.01)


def test_comparison_has_lines_at_the_medians_of_the_bound_and_of_no_motion() -> None:
    errors = tables.six_dof().query("protocol == 'held_out'")
    figure = comparison(errors, "held_out")
    written = texts(figure)
    assert "Dashed line: median that the Cramér–Rao bound allows." in written
    assert "Dotted line: median of no motion." in written
    ax = next(ax for ax in figure.axes if ax.get_title() == "translation z")
    at = {float(c.get_segments()[0][0, 0]) for c in ax.collections if hasattr(c, "get_segments")}
    for method in ("cramer_rao", "no_motion"):
        rows = errors[(errors["method"] == method) & (errors["component"] == "t_z")]
        assert any(x == pytest.approx(rows["abs_error"].median()) for x in at)


def test_condition_number_is_the_median_and_range_over_trials() -> None:
    frames, values = tables.condition(trials=20)
    figure = condition_number(frames, values)
    line = figure.axes[0].lines[0]
    np.testing.assert_allclose(np.asarray(line.get_ydata(), float)[6:], np.median(values, axis=0)[6:])
    assert "120 of 10,000" in texts(figure)
    assert figure.axes[0].get_ylabel() == "condition number (1)"
    one = condition_number(*tables.condition())
    np.testing.assert_array_equal(np.asarray(one.axes[0].lines[0].get_ydata())[6:], tables.condition()[1][6:])
    assert "singular at every frame" in texts(condition_number([1, 2], [np.inf, np.nan]))
    with pytest.raises(ValueError, match="do not fit"):
        condition_number([1, 2, 3], [1.0, 2.0])


def test_a_table_without_its_columns_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="lacks unit, status"):
        comparison(tables.few_answers().drop(columns=["unit", "status"]), "held_out")
    with pytest.raises(ValueError, match="lacks ci_low"):
        paired_differences(tables.paired(tables.few_answers()).drop(columns="ci_low"))


def test_categorical_columns_draw_the_same_numbers() -> None:
    errors = tables.few_answers()
    words = ("protocol", "method", "component", "unit", "case", "status")
    packed = errors.astype(dict.fromkeys(words, "category"))
    plain, same = comparison(errors, "held_out"), comparison(packed, "held_out")
    for one, other in zip(plain.axes[0].lines, same.axes[0].lines, strict=True):
        np.testing.assert_array_equal(one.get_xdata(), other.get_xdata())


def test_the_door_exports_every_figure() -> None:
    assert all(callable(getattr(report, name)) for name in report.__all__ if name != "PLOTS")


def test_functions_learned_beside_vmf_are_drawn_where_they_answered() -> None:
    errors = tables.pan_tilt()
    beside = errors.query("method == 'vmf' and frame % 5 == 0").assign(method="vmf[thesis]")
    both = pd.concat([errors, beside], ignore_index=True)
    mine = beside.query("trial == 3 and component == 'pan'")
    shown = truth_vs_estimate(both, trial=3, last=25)
    drawn = {str(line.get_label()): line for line in shown.axes[0].lines}["vmf (thesis)"]
    frames = np.asarray(drawn.get_xdata(), float)
    assert len(frames) == (mine["frame"] >= frames.min()).sum() > 2
    by_frame = mine.set_index("frame")["estimate"]
    np.testing.assert_array_equal(np.asarray(drawn.get_ydata(), float), by_frame[frames])
    assert "vmf (thesis)" in texts(shown)
    curve = absolute_error(both, trial=3)
    drawn = {str(line.get_label()): line for line in curve.axes[0].lines}["vmf (thesis)"]
    np.testing.assert_array_equal(drawn.get_xdata(), mine["frame"])
    assert "vmf (thesis)" in texts(curve)


def test_rivals_are_points_below_what_was_learned() -> None:
    errors = tables.pan_tilt()
    rival = errors.query("method == 'vmf' and frame % 5 == 0").assign(method="bundle")
    both = pd.concat([errors.query("method != 'bundle'"), rival], ignore_index=True)
    mine = rival.query("trial == 3 and component == 'pan'")
    for figure, column in (
        (truth_vs_estimate(both, trial=3), "estimate"),
        (absolute_error(both, trial=3), "abs_error"),
    ):
        drawn = {str(line.get_label()): line for line in figure.axes[0].lines}
        points = drawn["bundle"]
        assert points.get_linestyle() == "None"
        assert points.get_zorder() < drawn["vmf"].get_zorder()
        frames = np.asarray(points.get_xdata(), float)
        assert len(frames) == (mine["frame"] >= frames.min()).sum() > 2
        by_frame = mine.set_index("frame")[column]
        np.testing.assert_array_equal(np.asarray(points.get_ydata(), float), by_frame[frames])
        assert "bundle" in texts(figure)
