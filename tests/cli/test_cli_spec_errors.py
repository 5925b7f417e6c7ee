"""A wrong spec is told by place, all of it at once, and ends with 2 before any work begins."""

from __future__ import annotations

from pathlib import Path

import pytest
from vmf_command import CONFIGS, vmf

QUICKSTART = CONFIGS / "quickstart.yaml"
COMMANDS = (("train",), ("compare-3d",), ("simulate", "-o", "x.mcap"))


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    return tmp_path / "spec.yaml"


@pytest.fixture(autouse=True)
def _nothing_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c[0])
def test_an_unknown_key_is_told_with_place_and_nearest_name(spec: Path, command: tuple[str, ...]) -> None:
    spec.write_text("task: six_dof\ndata:\n  simulate: {fames: 30}\n")
    line = vmf(command[0], spec, *command[1:]).refused("fames", "did you mean frames?")
    assert line.startswith(f"{spec}:3:14: data.simulate.fames: ")
    assert not (spec.parent / "runs").exists()


@pytest.mark.parametrize(
    ("text", "place", "said"),
    [
        ("task: six_dof\ntaks: planar\ndata: {simulate: {}}\n", "2:1", "did you mean task?"),
        ("task: sixdof\ndata: {simulate: {}}\n", "1:7", "did you mean six_dof?"),
        ("task: six_dof\ndata: {simulate: {}, recording: null}\nnoise: {pixel_px: -1}\n", "3:19", "-1"),
        ("task: six_dof\ntask: planar\ndata: {simulate: {}}\n", "2:1", "task"),
        ("task: six_dof\ndata: {}\n", "2:7", "give exactly one of simulate / recording"),
        ("task: six_dof\ndata: {simulate: {frames: 1}}\n", "2:27", "found 1"),
        ("task: six_dof\ndata: {simulate: {}}\nnoise: {pixel_px: .inf}\n", "3:19", "finite"),
        ("task: six_dof\ndata: {simulate: {}}\nsolver: {cost: [}\n", "3:17", ""),
    ],
    ids=["misspelt", "choice", "range", "duplicate", "neither", "too few", "infinite", "not YAML"],
)
def test_every_mistake_is_one_line_with_its_place(spec: Path, text: str, place: str, said: str) -> None:
    spec.write_text(text)
    line = vmf("train", spec).refused(said)
    assert line.startswith(f"{spec}:{place}: ")


def test_several_mistakes_are_told_at_once_in_order(spec: Path) -> None:
    spec.write_text("task: six_dof\nnoise: {pixel: 3}\ndata: {simulate: {frames: many}}\nsolver: {cots: x}\n")
    said = vmf("train", spec, "learner.kind=magic", "nonsense")
    assert (said.code, said.out) == (2, "")
    starts = [line.split(": ")[0] for line in said.err.splitlines()]
    assert starts == [
        f"{spec}:2:9",
        f"{spec}:3:27",
        f"{spec}:4:10",
        "command line",
        "command line",
    ]


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("noise.pixel=1", "did you mean pixel_px?"),
        ("noise.pixel_px=much", "much"),
        ("nonsense", "key=value"),
        ("=3", "key=value"),
        ("evaluate.gaps.7=3", "index"),
        ("learner.engine=sequential", "learner.kind: pipeline"),
        ("data.simulate.frames=1e3.5", "1e3.5"),
    ],
)
def test_a_wrong_override_is_told_as_the_command_lines(override: str, said: str) -> None:
    line = vmf("train", QUICKSTART, override).refused()
    assert line.startswith(f"command line: {override}")
    if override != "learner.engine=sequential":
        assert said in line
    else:
        assert "pipeline" in line


def test_what_is_no_spec_file_is_refused(tmp_path: Path) -> None:
    vmf("train", tmp_path / "none.yaml").refused(f"{tmp_path / 'none.yaml'}: no such file")
    vmf("train", tmp_path).refused(f"{tmp_path}: a directory")
    empty = tmp_path / "empty.yaml"
    empty.write_text("# nothing\n")
    vmf("train", empty).refused(f"{empty}: empty", "task", "data")
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"task: \xff\n")
    vmf("train", binary).refused(f"{binary}:1:7", "0xff")


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["evaluate.checkpoints=[500]"], "evaluate.checkpoints: found 500"),
        (["evaluate.checkpoints=[1]"], "evaluate.checkpoints: found 1"),
        (["solver.known=rotation"], "solver.known: rotation has no meaning for translation"),
        (
            [
                "data.simulate.workspace.target_low_m=[0,0,-5]",
                "data.simulate.workspace.target_high_m=[1,1,-4]",
                "evaluate.trials=1",
                "evaluate.checkpoints=null",
            ],
            "data.simulate.workspace: the start pose shows no point",
        ),
    ],
)
def test_what_a_spec_asks_in_vain_is_refused(tmp_path: Path, overrides: list[str], said: str) -> None:
    vmf("train", QUICKSTART, *overrides, "--out", tmp_path / "runs", "--jobs", 1).refused(said)


def test_an_output_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    vmf("train", QUICKSTART, "--out", tmp_path / "file").refused("--out: ", str(tmp_path / "file"))
    spec = tmp_path / "none" / "x.mcap"
    vmf("simulate", QUICKSTART, "-o", spec).refused(f"{spec}: cannot be written")
    vmf("simulate", QUICKSTART, "-o", tmp_path / "x.bag").refused("x.bag", ".mcap")
