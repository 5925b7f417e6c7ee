"""Which runs the page counts: those whose specs are an experiment's, whatever their directories' names."""

from __future__ import annotations

import json
import shlex
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from vmf.report.page import Run, Runs, configs, counted, flat, thesis
from vmf.report.page.contents import rerun, sections
from vmf.report.page.origin import Counted
from vmf.spec import load, load_all, load_studies, load_study, variants

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs/thesis"
GRID = variants((), CONFIGS / "unknowns/pan_tilt.yaml")


COMMANDS = {figure.config: figure.command for figure in thesis().figures}


def run(
    name: str, spec: Any, command: str = COMMANDS["pan_tilt"], path: str = "a", finished: str = "1"
) -> Run:
    """A finished run of a spec in a directory of any name."""
    record = {"command": command, "finished": finished, "spec": spec}
    return Run(name, Path(path), record, flat(spec), None, None, ())


def spec_of(config: str, *overrides: str) -> dict[str, Any]:
    return load(CONFIGS / f"{config}.yaml", overrides).spec.model_dump(mode="json")


def look(*runs: Run) -> Counted:
    return counted(runs, thesis(), CONFIGS)


def test_the_configs_are_found_wherever_one_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert configs() == CONFIGS
    (tmp_path / "configs/thesis").mkdir(parents=True)
    assert configs() == Path("configs/thesis")


def test_a_run_is_known_by_its_spec_and_says_what_makes_it() -> None:
    quick = ("evaluate.trials=2", "data.simulate.frames=40", "evaluate.checkpoints=[20, 40]")
    found = look(run("anything", spec_of("pan_tilt", *quick)))
    (one,) = found.runs
    assert (one.name, found.others, found.notes) == ("pan_tilt", (), ())
    command = rerun(one, "pan_tilt")
    assert command.startswith(f"vmf {COMMANDS['pan_tilt']} configs/thesis/pan_tilt.yaml ")
    # The command leads back to the very spec.
    again = load(ROOT / shlex.split(command)[2], shlex.split(command)[3:]).spec
    assert again.model_dump(mode="json") == one.record["spec"]


@pytest.mark.parametrize(
    "override", ["noise.pixel_px=1", "data.simulate.seed=7", "approximator.gauge=thesis", "also=[]"]
)
def test_a_run_of_the_same_name_that_asks_something_else_is_not_counted(override: str) -> None:
    other = run("pan_tilt", spec_of("pan_tilt", override), path="pan_tilt-sweep/b")
    found = look(other)
    assert (found.runs, found.others) == ((), (other,))
    (note,) = found.notes
    assert note.startswith("not counted: b is no run of pan_tilt: ")
    assert override.partition("=")[0] in note


def test_a_run_by_another_command_is_not_counted() -> None:
    found = look(run("translation_3d", spec_of("translation_3d"), command="train"))
    assert found.runs == ()
    assert "made by `vmf train`, not by `vmf compare-3d`" in found.notes[0]
    assert look(run("x", spec_of("translation_3d"), command="compare-3d")).runs[0].name == "translation_3d"


def test_a_spec_of_before_a_setting_was_added_is_read_with_its_default() -> None:
    old = spec_of("pan_tilt")
    del old["learner"]["distortion"]
    assert [one.name for one in look(run("x", old)).runs] == ["pan_tilt"]


def test_a_study_is_known_too() -> None:
    spec = load_study(CONFIGS / "stereo_codes.yaml").spec.model_dump(mode="json")
    assert [one.name for one in look(run("x", spec, command="study")).runs] == ["stereo_codes"]


def studied(config: str, override: str, **more: Any) -> Run:
    spec = load_study(CONFIGS / f"{config}.yaml", (override,)).spec.model_dump(mode="json")
    return run(config, spec, command="study", path=f"{config}-sweep/b", **more)


@pytest.mark.parametrize(
    ("config", "override", "accepted"),
    [
        ("feedback", "study.gains_per_s=[1000.0]", "[0.5, 1.0, 2.0] or a part of it"),
        ("feedback", "study.gains_per_s=[0.5, 3.0]", "[0.5, 1.0, 2.0] or a part of it"),
        ("approximators", "study.noise=[0.5]", "[0.0, 0.05] or a part of it"),
        ("approximators", "study.codes=[300, 30]", "[100, 300, 1000, 3000] or a part of it"),
        ("joint_space", "study.frames=[50]", "[100, 300, 1000] or a part of it"),
        ("kaczmarz", "study.rank_overlays=[16]", "[2, 4, 8] or a part of it"),
        ("kaczmarz", "study.noise=0.5", "0.1"),
        ("cmac_parameters", "study.other_tilt_deg=[0.0, 0.0, 9.0]", "[0.0, 0.0, 0.0] or null"),
    ],
)
def test_other_cases_than_those_of_a_study_are_another_experiment(
    config: str, override: str, accepted: str
) -> None:
    other = studied(config, override)
    found = look(other)
    assert (found.runs, found.others) == ((), (other,))
    key, _, value = override.partition("=")
    assert found.notes == (f"not counted: b is no run of {config}: {key} is {value}, not {accepted}",)


@pytest.mark.parametrize(
    ("config", "override"),
    [
        ("feedback", "study.gains_per_s=[2.0]"),
        ("feedback", "study.sources=[analytic]"),
        ("approximators", "study.noise=[0.05]"),
        ("approximators", "study.codes=[100, 1000]"),
        ("joint_space", "study.frames=[100, 1000]"),
        ("planar_sift", "study.frames=40"),
        ("kaczmarz", "study.rank_overlays=[2, 8]"),
        ("cmac_parameters", "study.other_tilt_deg=null"),
    ],
)
def test_some_of_the_cases_of_a_study_are_a_matter_of_effort(config: str, override: str) -> None:
    found = look(studied(config, override))
    assert [one.name for one in found.runs] == [config]
    assert found.notes == ()
    ((key, _, value),) = [text.partition("=") for text in found.runs[0].overrides]
    its, _, said = override.partition("=")
    assert (key, json.loads(value)) == (its, yaml.safe_load(said))


def point(number: int, *overrides: str) -> dict[str, Any]:
    """The spec of a point of the sweep over what Figs. 5.4–5.7 leave open."""
    texts = [*GRID[number].overrides, *overrides]
    return load_all(CONFIGS / "pan_tilt.yaml", [texts])[0].spec.model_dump(mode="json")


def test_points_that_are_no_longer_in_the_grid_are_not_counted() -> None:
    stale = run("pan_tilt_unknowns", point(0, "data.simulate.workspace.angle_rad=0.77"), path="stale")
    found = look(run("pan_tilt_unknowns", point(0)), stale)
    assert [one.path.name for one in found.runs] == ["a"]
    assert found.others == ()
    (note,) = found.notes
    assert note.startswith("not counted: 1 run of pan_tilt_unknowns that is no point of ")
    assert found.points["pan_tilt_unknowns"] == len(GRID)


def test_of_several_runs_of_a_point_one_counts() -> None:
    """That with the grid's own effort, though another is newer."""
    quick = run("pan_tilt_unknowns", point(0, "evaluate.trials=1"), path="quick", finished="2")
    whole = run("pan_tilt_unknowns", point(0), path="whole", finished="1")
    found = look(quick, whole)
    assert [one.path.name for one in found.runs] == ["whole"]
    assert found.notes == ("not counted: 1 run of pan_tilt_unknowns, of whose points there are others",)
    newer = replace(quick, path=Path("newer"), record=dict(quick.record) | {"finished": "3"})
    assert [one.path.name for one in look(quick, newer).runs] == ["newer"]


def test_the_command_of_a_sweep_names_what_all_its_points_have_in_common() -> None:
    found = look(*(run("x", point(n, "evaluate.trials=1"), path=str(n)) for n in range(3)))
    written = {s.id: s for s in sections(thesis(), Runs(found.runs, found.points))}["5.4–5.7"]
    assert shlex.split(written.commands[1])[:6] == [
        *("vmf", "sweep", "configs/thesis/pan_tilt.yaml", "--grid"),
        *("configs/thesis/unknowns/pan_tilt.yaml", "evaluate.trials=1"),
    ]
    assert f"3 of {len(GRID)} combinations, 1 trial of 2000 frames each" in written.evidence_words


def test_what_a_grid_varies_is_no_matter_of_effort(tmp_path: Path) -> None:
    """A sweep over the number of frames has a point for each."""
    config = (CONFIGS / "pan_tilt.yaml").read_text()
    (tmp_path / "unknowns").mkdir()
    (tmp_path / "pan_tilt.yaml").write_text(config)
    grid = tmp_path / "unknowns/pan_tilt.yaml"
    grid.write_text(
        "sweep: {name: [pan_tilt_unknowns], data.simulate.frames: [40, 80], evaluate.checkpoints: [null]}"
    )
    points = [one.overrides for one in variants((), grid)]
    specs = [one.spec.model_dump(mode="json") for one in load_all(CONFIGS / "pan_tilt.yaml", points)]
    other = spec_of(
        "pan_tilt", "name=pan_tilt_unknowns", "data.simulate.frames=60", "evaluate.checkpoints=null"
    )
    runs = [run("pan_tilt_unknowns", spec, path=str(n)) for n, spec in enumerate([*specs, other])]
    found = counted(runs, thesis(), tmp_path)
    assert [one.path.name for one in found.runs] == ["0", "1"]
    assert "1 run of pan_tilt_unknowns" in found.notes[0]


def commands(target: str) -> list[list[str]]:
    """The commands that a target of the Makefile would run."""
    done = subprocess.run(
        ["make", "-n", target, "READY=", "BIN=bin", "QUICK_OUT=out", "THESIS_OUT=out"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    lines = [line.partition(">")[0] for line in done.stdout.splitlines() if line.startswith("bin/vmf sweep ")]
    return [shlex.split(line) for line in lines]


@pytest.mark.parametrize("target", ["thesis", "thesis-quick"])
def test_every_run_that_make_makes_is_counted(target: str) -> None:
    made = commands(target)
    assert len(made) == len(list(CONFIGS.rglob("*.yaml")))
    runs = []
    for words in made:
        config, options = ROOT / words[2], dict(zip(words, [*words[1:], ""], strict=True))
        grid = ROOT / options["--grid"] if "--grid" in options else None
        texts = [word for word in words[3:] if "=" in word]
        points = [one.overrides for one in variants(texts, grid)]
        studied = "\nstudy:" in "\n" + config.read_text()
        loaded = load_studies(config, points) if studied else load_all(config, points)
        command = "study" if studied else options.get("--command", "train")
        assert command == COMMANDS[config.stem]
        specs = [one.spec.model_dump(mode="json") for one in loaded]
        runs += [
            run("x", spec, command, path=f"{config.stem}-{bool(grid)}-{n}") for n, spec in enumerate(specs)
        ]
    found = look(*runs)
    assert (found.others, found.notes) == ((), ())
    assert len(found.runs) == len(runs)
    figures = thesis().figures
    assert {one.name for one in found.runs} == {f.config for f in figures} | {
        f.sweep for f in figures if f.unknowns
    }
    if target == "thesis":
        assert all(one.overrides == () for one in found.runs)
        for name, points_in_grid in found.points.items():
            assert sum(one.name == name for one in found.runs) == points_in_grid
