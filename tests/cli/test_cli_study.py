"""`vmf study`, and a study's points in a sweep: a run directory, the same bytes, and errors in one line."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from vmf_command import CONFIGS, QUICK, Said, record, train, vmf

STUDY = CONFIGS / "thesis" / "stereo_codes.yaml"
SMALL = ("study.pixels=2", "study.images=[{width_px: 32, height_px: 16}]")
COLUMNS = ["quantity", "case", "component", "unit", "value", "n", "ci_low", "ci_high"]


def study(*arguments: object, plots: bool = False) -> Said:
    return vmf("study", STUDY, *SMALL, *arguments, plots=plots)


def sweep(out: Path, *arguments: object, plots: bool = False) -> Said:
    jobs = () if "--jobs" in arguments else ("--jobs", 1)
    return vmf("sweep", STUDY, *SMALL, *arguments, "--out", out, *jobs, "--quiet", plots=plots)


def files(run: Path) -> dict[str, bytes]:
    """What a run holds apart from its record, by path."""
    found = (path for path in run.rglob("*") if path.is_file() and path.name != "run.json")
    return {str(path.relative_to(run)): path.read_bytes() for path in found}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    said = study("--out", tmp_path_factory.mktemp("study"), "--json", plots=True)
    assert said.code == 0, said
    return said.run


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep with one point, the study of `run`."""
    out = tmp_path_factory.mktemp("swept")
    assert sweep(out, "study.pixels=2", plots=True).code == 0
    return out


def test_a_study_leaves_a_run_directory(run: Path) -> None:
    assert {path.name for path in run.iterdir()} == {
        "run.json",
        "spec.yaml",
        "quantities.csv",
        "codes.csv",
        "plots",
    }
    stems = ("code_tables", "line_rigs")
    drawn = {path.name for path in (run / "plots").iterdir()}
    assert drawn == {f"{stem}.{kind}" for stem in stems for kind in ("png", "pdf")}
    said = record(run)
    assert (said["status"], said["command"], said["seeds"]) == ("done", "study", {})
    assert said["overrides"] == list(SMALL)
    assert said["spec"]["study"]["pixels"] == 2
    assert said["wall_s"] > 0
    assert re.fullmatch(r"[0-9a-f]{10}-\d{8}T\d{6}\.\d+Z", run.name)
    assert (run.parent / "latest").resolve() == run.resolve()
    assert run.parent.name == "stereo_codes"
    table = pd.read_csv(run / "quantities.csv")
    assert list(table) == COLUMNS


def test_what_it_prints_is_what_it_wrote(run: Path, tmp_path: Path) -> None:
    said = study("--out", tmp_path)
    assert said.code == 0
    assert re.search(r"^visible_codes +identical +2$", said.out, re.MULTILINE)
    content = json.loads(study("--out", tmp_path, "--json").out)
    assert content.keys() == {"run_dir", "quantities", "plots", "losses", "notes"}
    table = pd.read_csv(run / "quantities.csv")
    assert [row["value"] for row in content["quantities"]] == table["value"].tolist()
    assert all(list(row) == COLUMNS for row in content["quantities"])
    assert content["plots"] == []


def test_the_written_spec_gives_the_same_bytes(run: Path, tmp_path: Path) -> None:
    again = vmf("study", run / "spec.yaml", "--out", tmp_path, "--json", plots=True)
    assert files(again.run) == files(run)
    shown = [Path(path) for path in json.loads(again.out)["plots"]]
    assert [path.name for path in shown] == ["code_tables.png", "line_rigs.png"]
    assert all(path.is_file() for path in shown)


def test_info_and_table_take_a_study(run: Path) -> None:
    said = vmf("info", run)
    assert said.code == 0
    assert "command: study" in said.out
    assert "visible_codes translated: 3" in said.out
    table = vmf("table", run)
    assert table.code == 0
    assert "| visible_codes | translated |" in table.out


def test_a_study_beside_an_experiment_is_refused_in_one_line(run: Path, tmp_path: Path) -> None:
    other = train(CONFIGS / "quickstart.yaml", tmp_path, *QUICK)
    vmf("table", run, other).refused(str(run), "found a study beside experiments")


def test_commands_that_want_an_experiment_say_what_runs_a_study(tmp_path: Path) -> None:
    for command in (("train",), ("compare-3d",), ("simulate", "-o", tmp_path / "x.mcap")):
        vmf(command[0], STUDY, *command[1:]).refused("found a study", f"`vmf study {STUDY}` runs it")
    quickstart = CONFIGS / "quickstart.yaml"
    vmf("study", quickstart).refused("found an experiment", f"`vmf train {quickstart}` runs it")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("study.pixel=3", "did you mean pixels?"),
        ("study.pixels=0", "found 0"),
        ("study.kind=stereo_code", "did you mean stereo_codes?"),
        ("study.tile_px=.nan", "finite"),
        ("study.images=[{width_px: 3, height_px: 3}, {width_px: 3, height_px: 3}]", "twice"),
        ("study.rigs.1.name=identical", "found identical twice"),
        ("nonsense", "not an override"),
    ],
)
def test_a_wrong_setting_is_one_line(override: str, said: str, tmp_path: Path) -> None:
    study(override, "--out", tmp_path / "runs").refused(said)
    assert not (tmp_path / "runs").exists()


def test_a_setting_that_is_handed_on_to_an_experiment_is_refused_by_its_own_name(tmp_path: Path) -> None:
    said = vmf(
        "study", CONFIGS / "thesis/planar_sift.yaml", "study.image_noise=1000", "--out", tmp_path / "runs"
    )
    said.refused("study.image_noise=1000: found 1000", "at most 255")
    assert not (tmp_path / "runs").exists()


def test_a_sweep_makes_each_point_once_with_the_bytes_of_the_study(run: Path, tmp_path: Path) -> None:
    content = json.loads(sweep(tmp_path, "study.pixels=2,3", "--json", plots=True).out)
    assert content["sweep_dir"] == str(tmp_path / "stereo_codes-sweep")
    assert [point["status"] for point in content["points"]] == ["done", "done"]
    assert [point["settings"] for point in content["points"]] == [{"study.pixels": p} for p in "23"]
    first = Path(content["points"][0]["run_dir"])
    assert first.name == run.name.split("-")[0]
    assert files(first) == files(run)
    counted = {
        row["study.pixels"]: row["value"]
        for row in content["rows"]
        if (row["quantity"], row["case"]) == ("visible_codes", "translated")
    }
    assert counted == {2: 3.0, 3: 6.0}
    inode = (first / "run.json").stat().st_ino
    again = json.loads(sweep(tmp_path, "study.pixels=2,3,4", "--json").out)
    assert [point["status"] for point in again["points"]] == ["kept", "kept", "done"]
    assert (first / "run.json").stat().st_ino == inode


def test_a_sweep_on_two_processes_writes_the_same_bytes(run: Path, tmp_path: Path) -> None:
    said = sweep(tmp_path, "study.pixels=2,3", "--jobs", 2)
    assert said.code == 0, said
    assert "points: 2 (2 done now, 0 before, 0 failed)" in said.out
    assert files(tmp_path / "stereo_codes-sweep" / run.name.split("-")[0]) == files(run)


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("quantities.csv", lambda file: file.write_bytes(b"")),
        ("plots/line_rigs.png", Path.unlink),
        ("run.json", Path.unlink),
    ],
)
def test_a_point_that_is_not_whole_is_done_again(
    name: str, damage: Callable[[Path], object], run: Path, swept: Path, tmp_path: Path
) -> None:
    point = tmp_path / "stereo_codes-sweep" / run.name.split("-")[0]
    shutil.copytree(swept / "stereo_codes-sweep" / point.name, point)
    damage(point / name)
    (point / "stray.csv").write_text("left by an older version\n")
    content = json.loads(sweep(tmp_path, "study.pixels=2", "--json", plots=True).out)
    assert [one["status"] for one in content["points"]] == ["done"]
    assert files(point) == files(run)


def test_a_study_has_no_other_command(tmp_path: Path) -> None:
    sweep(tmp_path, "--command", "compare-3d").refused("--command: found compare-3d", "none is accepted")


def test_a_sweep_with_two_names_is_refused(tmp_path: Path) -> None:
    sweep(tmp_path, "name=a,b").refused("name: found 'a' and 'b'")


def test_a_directory_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    study("--out", tmp_path / "file").refused("--out: ")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_directory_without_permission_is_one_line(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    study("--out", tmp_path / "runs").refused("--out: ")


def test_a_point_that_fails_is_told_and_tried_again(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import vmf.study

    def broken(settings: object) -> None:
        raise ZeroDivisionError("of no use")

    with monkeypatch.context() as patch:
        patch.setattr(vmf.study, "carry_out", broken)
        said = sweep(tmp_path, "study.pixels=2")
    assert said.code == 3
    point = tmp_path / "stereo_codes-sweep" / run.name.split("-")[0]
    assert record(point)["status"] == "failed"
    assert "ZeroDivisionError" in record(point)["trace"]
    assert sweep(tmp_path, "study.pixels=2", plots=True).code == 0
    assert files(point) == files(run)


def test_a_sweep_leaves_out_pdfs_that_are_not_wanted(run: Path, tmp_path: Path) -> None:
    assert sweep(tmp_path, "study.pixels=2", "--no-pdf", plots=True).code == 0
    point = tmp_path / "stereo_codes-sweep" / run.name.split("-")[0]
    assert files(point) == {
        name: content for name, content in files(run).items() if not name.endswith(".pdf")
    }


def test_ctrl_c_says_so_and_leaves_a_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import vmf.study

    def interrupted(settings: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(vmf.study, "carry_out", interrupted)
    said = study("--out", tmp_path)
    assert (said.code, said.err) == (130, "interrupted; nothing was finished\n")
    assert record(tmp_path / "stereo_codes" / "latest")["status"] == "interrupted"
    swept = sweep(tmp_path, "study.pixels=2")
    assert swept.code == 130
    (point,) = (tmp_path / "stereo_codes-sweep").glob("*/run.json")
    assert record(point.parent)["status"] == "interrupted"


def test_many_quantities_are_printed_without_their_components(tmp_path: Path) -> None:
    config = CONFIGS / "thesis" / "cmac_parameters.yaml"
    small = ("study.points=60", "study.tests=10", "study.parameters=[1, 3, 7]", "study.grid=3")
    said = vmf("study", config, *small, "--out", tmp_path, "--quiet")
    assert said.code == 0, said
    lines = said.out.splitlines()
    assert len(lines) < 60
    assert re.search(r"^and \d+ of components, see quantities.csv$", said.out, re.MULTILINE)
    shown = vmf("info", tmp_path / "cmac_parameters" / "latest").out
    assert "theta_1" not in shown
    assert "constant_error_max thesis" in shown


def test_a_finished_study_without_quantities_is_told(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    (copy / "quantities.csv").write_text("a,b\n1,2\n")
    vmf("table", copy).refused("found columns a, b, not those of quantities")
    vmf("info", copy).refused("found columns a, b, not those of quantities")


@pytest.fixture(scope="module")
def unanswered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Said]:
    """A study of one training point, to which no test point is near enough."""
    out = tmp_path_factory.mktemp("unanswered")
    return out, vmf("sweep", CMAC, *ONE_POINT, "study.tests=2", "--out", out, "--jobs", 1, "--quiet")


CMAC = CONFIGS / "thesis" / "cmac_parameters.yaml"
ONE_POINT = ("study.points=1", "study.parameters=[1]", "study.grid=3", "study.other_tilt_deg=null")
LOST = "thesis: no test point has an answer: none is near enough to those of training (2)"


def test_a_study_that_answers_nothing_is_a_loss(tmp_path: Path) -> None:
    said = vmf("study", CMAC, *ONE_POINT, "study.tests=2", "--out", tmp_path, "--json")
    assert said.code == 3
    assert f"lost: {LOST}" in said.err.splitlines()
    assert LOST in json.loads(said.out)["losses"]
    stored = record(tmp_path / "cmac_parameters" / "latest")
    assert stored["status"] == "done"
    assert LOST in stored["losses"]


def test_a_sweep_says_what_its_studies_lost_now_and_when_they_are_kept(
    unanswered: tuple[Path, Said],
) -> None:
    out, first = unanswered
    again = vmf("sweep", CMAC, *ONE_POINT, "study.tests=2", "--out", out, "--jobs", 1, "--quiet")
    for said in (first, again):
        assert said.code == 3
        assert LOST.removesuffix(" (2)") in said.err
    assert "(0 done now, 1 before, 0 failed)" in again.out
