"""The command line over the file, and the file over the defaults."""

from __future__ import annotations

import pytest

from vmf.spec import CmacApproximator, NoApproximator, PipelineLearner, Rig, Rival, loads
from vmf.spec import overrides as overrides_module
from vmf.spec.model import Spec

from .test_load import BASE, problem, problems, spec


def test_precedence() -> None:
    assert spec("").noise.pixel_px == Spec.model_fields["noise"].default.pixel_px
    assert spec("noise: {pixel_px: 2, point_m: 1}").noise.pixel_px == 2.0
    found = spec("noise: {pixel_px: 2, point_m: 1}", "noise.pixel_px=1e-3").noise
    assert (found.pixel_px, found.point_m) == (1e-3, 1.0)


def test_values_are_yaml() -> None:
    found = spec(
        "", "evaluate.checkpoints=[50, 100]", "solver.cost = geometric", 'name="1"', "lift=thesis # x"
    )
    assert found.evaluate.checkpoints == (50, 100)
    assert (found.solver.cost, found.name, found.lift) == ("geometric", "1", "thesis")


def test_nothing_after_the_sign_is_null() -> None:
    assert spec("name: a", "name=").name is None
    assert "found nothing, a number" in problem(BASE, "noise.pixel_px=")


def test_a_value_may_hold_an_equals_sign() -> None:
    assert spec("", "name=a=b").name == "a=b"


def test_a_mapping_replaces_a_mapping() -> None:
    found = spec("noise: {pixel_px: 2, point_m: 1}", "noise={pixel_px: 5}").noise
    assert (found.pixel_px, found.point_m) == (5.0, 0.0)


def test_a_mapping_takes_the_place_of_what_has_no_keys() -> None:
    assert spec("", "data.simulate.rig.fx_px=300").data.simulate.rig == Rig(fx_px=300)  # type: ignore[union-attr]
    text = "task: planar\ndata: {simulate: {rig: dragonfly, workspace: }}"
    simulate = loads(
        text, overrides=["data.simulate.rig.fx_px=3", "data.simulate.workspace.angle_rad=1"]
    ).spec.data
    assert simulate.simulate is not None
    assert simulate.simulate.rig == Rig(fx_px=3)
    assert simulate.simulate.workspace.angle_rad == 1.0


def test_the_last_of_two_wins() -> None:
    assert spec("", "noise.point_m=1", "noise.point_m=2").noise.point_m == 2.0
    assert spec("", "noise.point_m=1", "noise={point_m: 3}").noise.point_m == 3.0
    assert spec("", "noise.point_m=x", "noise.point_m=2").noise.point_m == 2.0


def test_lists_by_index() -> None:
    rivals = spec("rivals: [{method: bundle}]", "rivals.0.error.rotation_deg=2").rivals
    assert rivals[0].method == "bundle"
    assert rivals[0].error.rotation_deg == 2.0
    assert spec("", "evaluate.gaps.0=7").evaluate.gaps == (7,)


def test_an_index_into_a_default_list_keeps_its_other_entries() -> None:
    default: tuple[Rival, ...] = Spec.model_fields["rivals"].default
    assert spec("", "rivals.0.method=pnp").rivals == (Rival(method="pnp"), *default[1:])


def test_a_wrong_index() -> None:
    text = BASE + "rivals: [{method: pnp}]\nevaluate: {gaps: []}"
    assert problems(text, "rivals.1.method=pnp", "rivals.method=pnp", "evaluate.gaps.0=1", "rivals.-1=1") == (
        "command line: rivals.1.method=pnp: found '1' as an index of rivals, "
        "an index from 0 to 0 is accepted",
        "command line: rivals.method=pnp: found 'method' as an index of rivals, "
        "an index from 0 to 0 is accepted",
        "command line: evaluate.gaps.0=1: found '0' as an index of evaluate.gaps, no index, it is empty, "
        "is accepted",
        "command line: rivals.-1=1: found '-1' as an index of rivals, an index from 0 to 0 is accepted",
    )


def test_another_kind_drops_the_files_keys_of_the_old_kind() -> None:
    cmac = "approximator: {kind: cmac, tile_px: 8, gauge: thesis}"
    assert spec(cmac, "approximator.kind=none").approximator == NoApproximator()
    assert spec(cmac, "approximator.kind=polynomial").approximator.gauge == "thesis"  # type: ignore[union-attr]
    assert spec("approximator: {degree: 3}", "approximator.kind=cmac").approximator == CmacApproximator()
    assert (
        spec("learner: {kind: transport, loss: huber}", "learner.kind=pipeline").learner == PipelineLearner()
    )


def test_the_same_kind_drops_nothing() -> None:
    cmac = "approximator: {kind: cmac, tile_px: 8}"
    for override in (["approximator.kind=cmac"], ["approximator.kind=none", "approximator.kind=cmac"]):
        assert spec(cmac, *override).approximator == CmacApproximator(tile_px=8.0)


def test_another_kind_does_not_excuse_what_never_fitted() -> None:
    line = problem(BASE + "approximator: {kind: cmac, degree: 3}", "approximator.kind=none")
    assert line.startswith("q.yaml:3:28: approximator.degree: unknown key for kind: none, degree belongs to")


def test_the_command_lines_own_keys_are_not_dropped() -> None:
    line = problem(BASE, "approximator.degree=3", "approximator.kind=cmac")
    assert line.startswith(
        "command line: approximator.degree=3: unknown key for kind: cmac, degree belongs to "
    )


@pytest.mark.parametrize(
    ("override", "rest"),
    [
        ("approximator.gaug=thesis", "unknown key, did you mean gauge? (accepted: kind, degree, gauge)"),
        ("noise.pixel_px=-1", "found -1, a number of at least 0 is accepted"),
        ("noise={pixel_px: -1}", "noise.pixel_px: found -1, a number of at least 0 is accepted"),
        ("noise.pixel_px.x=1", "noise.pixel_px: found {x: 1}, a number of at least 0 is accepted"),
        ("solver.cost=&a b", "anchor &a, specs have no anchors and aliases"),
        ("noise={point_m: 1, point_m: 2}", "noise.point_m: given twice, first at "),
        ("name=[", "not valid YAML: "),
        ("name=`", "not valid YAML: found character '`' that cannot start any token; put the text in quotes"),
        ("name=a\nb", "found several lines, a value on one line is accepted"),
        ("name=a: b", "found {a: 'b'}, text or null is accepted"),
        ("name", "not an override, key=value is accepted, such as noise.pixel_px=1.5"),
        ("=1", "not an override, key=value is accepted, such as noise.pixel_px=1.5"),
        ("noise..pixel_px=1", "not an override, key=value is accepted, such as noise.pixel_px=1.5"),
        ("", "not an override, key=value is accepted, such as noise.pixel_px=1.5"),
    ],
)
def test_a_wrong_override(override: str, rest: str) -> None:
    shown = " ".join(override.splitlines())
    assert problem(BASE, override).startswith(f"command line: {shown}: {rest}")


def test_the_example_of_the_right_form_is_right() -> None:
    example = overrides_module._FORM.rsplit(" ", 1)[1]
    assert spec("", example).noise.pixel_px == 1.5


def test_overrides_leave_a_file_that_is_no_mapping_alone() -> None:
    assert problem("[1]", "name=a").startswith("q.yaml:1:1: found [1], accepted: a mapping of ")


def test_what_the_command_line_left_out_is_told_of_the_command_line() -> None:
    lines = problems("task: planar\ndata: {}", "data.recording.path=x")
    assert lines == (
        "command line: data.recording.path=x: data.recording: give exactly one of pose / joints",
    )
