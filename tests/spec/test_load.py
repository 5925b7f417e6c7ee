"""What a file may say, and what a person reads when it says something else."""

from __future__ import annotations

from pathlib import Path

import pytest

from vmf.approximate import APPROXIMATORS
from vmf.errors import InputError
from vmf.spec import CmacApproximator, PipelineLearner, PolynomialApproximator, Rig, load, loads
from vmf.spec.model import Spec

BASE = "task: six_dof\ndata: {simulate: {}}\n"
KINDS = list(APPROXIMATORS)


def problems(text: str, *overrides: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        loads(text, "q.yaml", overrides)
    return caught.value.lines


def problem(text: str, *overrides: str) -> str:
    (line,) = problems(text, *overrides)
    return line


def spec(text: str, *overrides: str) -> Spec:
    return loads(BASE + text, overrides=overrides).spec


def test_a_file_is_loaded_with_its_text(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("# größe\n" + BASE, encoding="utf-8-sig")
    loaded = load(path, ["noise.pixel_px=1"])
    assert loaded.path == path
    assert loaded.text == "# größe\n" + BASE
    assert loaded.overrides == ("noise.pixel_px=1",)
    assert loaded.spec.noise.pixel_px == 1.0


@pytest.mark.parametrize(
    ("written", "number"),
    [("1e-3", 1e-3), ("1E5", 1e5), ("+1e3", 1e3), ("1.e2", 1e2), (".5", 0.5), ("7", 7.0), ("1E+2", 100.0)],
)
def test_every_way_to_write_a_number(written: str, number: float) -> None:
    assert spec(f"noise: {{pixel_px: {written}}}").noise.pixel_px == number


@pytest.mark.parametrize("text", ["on", "off", "yes", "no", "y", "1:30", "2001-01-01", "0x10", "1_000", "="])
def test_other_plain_scalars_are_text(text: str) -> None:
    assert spec(f"name: {text}").name == text


def test_a_whole_float_is_a_whole_number() -> None:
    assert spec("evaluate: {trials: 2.0}").evaluate.trials == 2
    assert spec("approximator: {degree: 3.0}").approximator == PolynomialApproximator(degree=3)


@pytest.mark.parametrize(
    ("value", "rest"),
    [
        ("-3", "found -3, a number of at least 0 is accepted"),
        ("'3'", "found '3', a number of at least 0 is accepted"),
        ("true", "found true, a number of at least 0 is accepted"),
        ("1:30", "found '1:30', a number of at least 0 is accepted"),
        (".inf", "found .inf, a finite number of at least 0 is accepted"),
        ("-.Inf", "found -.Inf, a finite number of at least 0 is accepted"),
        (".nan", "found .nan, a finite number of at least 0 is accepted"),
        ("1e400", "found 1e400, a finite number of at least 0 is accepted"),
        ("null", "found null, a number of at least 0 is accepted"),
        ("", "found nothing, a number of at least 0 is accepted"),
        ("[1]", "found [1], a number of at least 0 is accepted"),
        ("{a: 1}", "found {a: 1}, a number of at least 0 is accepted"),
        ("{a: " + "x" * 99 + "}", "found a mapping, a number of at least 0 is accepted"),
        ("[" + "1, " * 50 + "1]", "found a list of 51, a number of at least 0 is accepted"),
        ("x" * 99, f"found '{'x' * 60}…', a number of at least 0 is accepted"),
    ],
)
def test_a_wrong_number(value: str, rest: str) -> None:
    assert problem(BASE + "noise:\n  pixel_px: " + value).split(": ", 2)[1:] == ["noise.pixel_px", rest]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "task: sixdof\ndata: {simulate: {}}",
            "q.yaml:1:7: task: found 'sixdof', accepted: pan_tilt, translation, planar, six_dof; "
            "did you mean six_dof?",
        ),
        (
            "data: {simulate: {}}",
            "q.yaml:1:1: task: missing, accepted: pan_tilt, translation, planar, six_dof",
        ),
        (
            "task: planar\ndata:\n  recording: {path: a, pose: {topic: /p}}",
            "q.yaml:3:14: data.recording: give exactly one of tracks / images",
        ),
        ("task: planar\ndata: {}", "q.yaml:2:7: data: give exactly one of simulate / recording"),
        (BASE + "name: 3", "q.yaml:3:7: name: found 3, text or null is accepted"),
        (
            BASE + "evaluate: {trials: 2.5}",
            "q.yaml:3:20: evaluate.trials: found 2.5, a whole number greater than 0 is accepted",
        ),
        (
            BASE + "evaluate: {train_fraction: 1}",
            "q.yaml:3:28: evaluate.train_fraction: found 1, "
            "a number greater than 0 and less than 1 is accepted",
        ),
        (
            BASE + "evaluate: {gaps: 5}",
            "q.yaml:3:18: evaluate.gaps: found 5, accepted: a list, each a whole number greater than 0",
        ),
        (
            BASE + "evaluate:\n  gaps:\n  - 1\n  - -2",
            "q.yaml:6:5: evaluate.gaps.1: found -2, a whole number greater than 0 is accepted",
        ),
        (
            BASE + "evaluate: {protocol: [heldout]}",
            "q.yaml:3:23: evaluate.protocol.0: found 'heldout', accepted: trained_code, held_out; "
            "did you mean held_out?",
        ),
        (
            BASE + "rivals: [pnp]",
            "q.yaml:3:10: rivals.0: found 'pnp', accepted: a mapping of method, error, curve_points",
        ),
        (
            "task: planar\ndata: {simulate: {workspace: {travel_m: [1, 2]}}}",
            "q.yaml:2:41: data.simulate.workspace.travel_m: found [1, 2], "
            "accepted: null or a list of 3, each a number",
        ),
        (
            "task: planar\ndata: {simulate: {workspace: {travel_m: [1, 2, 3, 4]}}}",
            "q.yaml:2:41: data.simulate.workspace.travel_m: found [1, 2, 3, 4], "
            "accepted: null or a list of 3, each a number",
        ),
        (
            BASE + "approximator: {degree: 4}",
            "q.yaml:3:24: approximator.degree: found 4, accepted: 1, 2, 3",
        ),
        (
            BASE + "approximator: {degree: true}",
            "q.yaml:3:24: approximator.degree: found true, accepted: 1, 2, 3",
        ),
        ("[1, 2]", "q.yaml:1:1: found [1, 2], accepted: a mapping of " + ", ".join(Spec.model_fields)),
        ("six_dof", "q.yaml:1:1: found 'six_dof', accepted: a mapping of " + ", ".join(Spec.model_fields)),
    ],
)
def test_a_wrong_value(text: str, line: str) -> None:
    assert problem(text) == line


def test_all_problems_are_told_at_once_in_the_order_of_the_file() -> None:
    text = "name: on\nnoise: {pixel_pix: 1, point_m: -1}\ntask: planer\ndata: {simulate: {frames: 1}}\n"
    places = [line.split(": ")[0] for line in problems(text, "solver.cost=x", "foo")]
    file = ["q.yaml:2:9", "q.yaml:2:32", "q.yaml:3:7", "q.yaml:4:27"]
    assert places == [*file, "command line", "command line"]


def test_a_required_key_under_a_wrong_name_is_not_called_missing_too() -> None:
    task, data = problems("tsk: 1\ndta: 2")
    assert "unknown key, did you mean task?" in task
    assert "unknown key, did you mean data?" in data


def test_a_key_at_the_wrong_level_is_told_where_it_belongs() -> None:
    assert ": unknown key, pixel_px belongs in noise (accepted: name, " in problem(BASE + "pixel_px: 1")
    assert ": unknown key, task belongs in the top level (accepted: pixel_px, " in problem(
        "task: planar\ndata: {simulate: {}}\nnoise: {task: 1}"
    )


def test_two_branches_of_a_union() -> None:
    def rig(text: str) -> str:
        return problem(f"task: planar\ndata: {{simulate: {{rig: {text}}}}}").split(": ", 2)[2]

    keys = ", ".join(Rig.model_fields)
    either = f"accepted: dragonfly or a mapping of {keys}"
    assert rig("dragonfli") == f"found 'dragonfli', {either}; did you mean dragonfly?"
    assert rig("3") == f"found 3, {either}"
    assert rig("[3]") == f"found [3], {either}"
    assert rig("{fx_px: -1}") == "found -1, a number greater than 0 is accepted"
    assert rig("{fx_pix: 1}") == f"unknown key, did you mean fx_px? (accepted: {keys})"


def test_the_kind_of_a_section_is_optional() -> None:
    assert spec("approximator: {degree: 3}").approximator == PolynomialApproximator(degree=3)
    assert spec("learner: {kind: pipeline}").learner == PipelineLearner()


def test_a_wrong_kind() -> None:
    kinds = f"accepted: {', '.join(KINDS)}"
    assert (
        problem(BASE + "approximator: {kind: cmak}")
        == f"q.yaml:3:22: approximator.kind: found 'cmak', {kinds}; did you mean cmac?"
    )
    assert problem(BASE + "approximator: {kind: 3}") == f"q.yaml:3:22: approximator.kind: found 3, {kinds}"
    assert problem(BASE + "approximator: {kind: [3]}").endswith(f"kind: found [3], {kinds}")
    assert problem(BASE + "approximator: cmac") == (
        f"q.yaml:3:15: approximator: found 'cmac', accepted: a mapping with kind: {' / '.join(KINDS)}"
    )


def test_a_key_of_another_kind() -> None:
    accepted = "(accepted: kind, degree, gauge)"
    assert problem(BASE + "approximator: {table_size: 3}") == (
        f"q.yaml:3:16: approximator.table_size: unknown key for kind: polynomial, "
        f"table_size belongs to kind: cmac / cmac_linear / cmac_multires {accepted}"
    )
    assert problem(BASE + "approximator: {training: albus}") == (
        f"q.yaml:3:16: approximator.training: unknown key for kind: polynomial, "
        f"training belongs to kind: cmac {accepted}"
    )
    assert problem(BASE + "approximator: {tile_pix: 3}") == (
        f"q.yaml:3:16: approximator.tile_pix: unknown key, did you mean tile_px of kind: cmac? {accepted}"
    )


def test_a_misspelt_kind_does_not_make_the_other_keys_wrong() -> None:
    assert "unknown key, did you mean kind?" in problem(BASE + "approximator: {knid: cmac, tile_px: 3}")


def test_a_models_own_words_are_told_at_its_mapping() -> None:
    text = BASE + "learner: {kind: pipeline, readout: kaczmarz}"
    assert problem(text) == (
        "q.yaml:3:10: learner: readout kaczmarz depends on the order of updates and needs engine: sequential"
    )


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (BASE + "name: a\nname: b", "q.yaml:4:1: name: given twice, first at q.yaml:3:1; once is accepted"),
        (
            BASE + "noise: {point_m: 1, point_m: 1}",
            "q.yaml:3:21: noise.point_m: given twice, first at q.yaml:3:9; once is accepted",
        ),
        (BASE + "name: &a b", "q.yaml:3:7: name: anchor &a, specs have no anchors and aliases"),
        (BASE + "noise: !!map {}", "q.yaml:3:8: noise: tag !!map, specs have no tags"),
        (BASE + "noise: !x {}", "q.yaml:3:8: noise: tag !x, specs have no tags"),
        (BASE + "<<: {}", "q.yaml:3:1: merge key <<, write the values themselves"),
        (BASE + "? [a]\n: 1", "q.yaml:3:3: found a list or mapping as a key, a name is accepted"),
        (BASE + "---\n" + BASE, "q.yaml:3:1: a second document starts here, a spec is one document"),
        ("task: a\n\tb: 1", "q.yaml:2:1: not valid YAML: found a tab, only spaces may separate and indent"),
        ("name: @a", "q.yaml:1:7: not valid YAML: found character '@' that cannot start any token; "),
        ("task: [1", "q.yaml:1:9: not valid YAML: "),
        ("task: a\nb", "q.yaml:2:2: not valid YAML: "),
        ("task: \x01", "q.yaml:1:7: the character '\\x01' is not allowed in YAML"),
        (BASE + 'name: "\\ud800"', "q.yaml:3:7: name: half of a surrogate pair is not a character"),
        ("[" * 99, "q.yaml:1:52: not valid YAML: nested more than 50 deep"),
        ("", "q.yaml: empty, a mapping is accepted (required: task, data)"),
        ("# nothing\n", "q.yaml: empty, a mapping is accepted (required: task, data)"),
        ("---\n", "q.yaml: empty, a mapping is accepted (required: task, data)"),
    ],
)
def test_yaml_that_is_not_a_spec(text: str, line: str) -> None:
    assert problem(text).startswith(line)


def test_an_alias_is_refused_once_and_not_expanded() -> None:
    assert problems(BASE + "name: &a b\nnoise: {pixel_px: *a}")[1:] == (
        "q.yaml:4:19: noise.pixel_px: alias *a, write the value itself",
    )


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    def line(path: Path) -> str:
        with pytest.raises(InputError) as caught:
            load(path)
        (only,) = caught.value.lines
        return only.removeprefix(str(path))

    binary, large = tmp_path / "b.yaml", tmp_path / "l.mcap"
    binary.write_bytes(b"task: planar\nname: \xc3\xa4\xff\n")
    large.write_bytes(b"a" * 1_000_001)
    assert line(binary) == ":2:8: found byte 0xff, text in UTF-8 is accepted"
    assert line(large) == ": larger than 1000000 bytes, a spec in YAML is accepted"
    assert line(tmp_path) == ": a directory, a spec in YAML is accepted"
    assert line(tmp_path / "none.yaml") == ": no such file, a spec in YAML is accepted"
    assert line(binary / "x").startswith(": cannot be read: ")
    assert line(Path("a\0b")).startswith(": cannot be read: ")


def test_the_recordings_path_stays_as_written() -> None:
    text = "task: planar\ndata: {recording: {path: ../a.mcap, pose: {topic: /p}, tracks: {topic: /t}}}"
    recording = loads(text).spec.data.recording
    assert recording is not None
    assert recording.path == "../a.mcap"


def test_kinds_accept_what_they_have() -> None:
    found = spec("approximator: {kind: cmac, tile_px: 16}").approximator
    assert found == CmacApproximator(tile_px=16.0)
