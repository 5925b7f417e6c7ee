"""Sweeps: every point a run of its own, done once, whatever stops the sweep on the way."""

from __future__ import annotations

import fcntl
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import psutil
import pytest
from polling import DEADLINE_S, alive, until
from vmf_command import CONFIGS, QUICK, Said, record, same_results, train, vmf

from vmf.experiment import SweepOptions, sweep
from vmf.spec import load

QUICKSTART = CONFIGS / "quickstart.yaml"
SMALL = (*QUICK, "approximator.kind=none", "data.simulate.frames=10")
GRID = ("noise.pixel_px=0,3", "data.simulate.seed=1,2")
# Nothing that the cameras could see.
BEHIND = "{target_low_m: [0, 0, -5], target_high_m: [1, 1, -4]}"
# What has to be the same byte for byte, however a point came about; `run.json` tells times and resumptions.
SAME = ("condition.csv", "errors.parquet", "summary.csv", "model.npz", "spec.yaml")


def run_sweep(out: Path, *arguments: object, code: int = 0, small: tuple[str, ...] = SMALL) -> Said:
    jobs = () if "--jobs" in arguments else ("--jobs", 1)
    said = vmf("sweep", QUICKSTART, *small, *arguments, "--out", out, *jobs, "--quiet")
    assert said.code == code, said
    return said


def points(out: Path) -> dict[str, Path]:
    return {path.parent.name: path.parent for path in sorted(out.glob("*-sweep/*/run.json"))}


def contents(out: Path) -> dict[str, dict[str, bytes]]:
    """What every point holds, by name: bytes of what is to be the same, nothing of the rest."""
    return {
        name: {file.name: file.read_bytes() if file.name in SAME else b"" for file in sorted(path.iterdir())}
        for name, path in points(out).items()
    }


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed")
    run_sweep(out, *GRID)
    return out


def test_every_point_is_the_run_that_train_makes(tmp_path: Path, undisturbed: Path) -> None:
    found = points(undisturbed)
    assert len(found) == 4
    for noise in ("0", "3"):
        for seed in ("1", "2"):
            run = train(QUICKSTART, tmp_path, *SMALL, f"noise.pixel_px={noise}", f"data.simulate.seed={seed}")
            name = run.name.split("-")[0]
            assert same_results(run, found[name])
            for file in SAME:
                assert (run / file).read_bytes() == (found[name] / file).read_bytes()
            theirs, ours = record(run), record(found[name])
            assert theirs.keys() == ours.keys()
            assert ours["status"] == "done"
            assert ours["overrides"][-2:] == theirs["overrides"][-2:]
            assert ours["cpu_s"] > 0
            assert ours["peak_memory_mib"] > 0
    files = sorted({file.name for path in found.values() for file in path.iterdir()})
    assert files == sorted([*SAME, "run.json"])


def test_the_table_and_the_json_list_every_point(tmp_path: Path, undisturbed: Path) -> None:
    said = run_sweep(undisturbed, *GRID)
    assert "points: 4 (0 done now, 4 before, 0 failed)" in said.out
    assert "noise.pixel_px" in said.out
    found = json.loads(run_sweep(undisturbed, *GRID, "--json").out)
    assert found.keys() == {"sweep_dir", "points", "rows", "notes"}
    assert [point["settings"] for point in found["points"]] == [
        {"noise.pixel_px": noise, "data.simulate.seed": seed} for noise in "03" for seed in "12"
    ]
    assert all(Path(point["run_dir"]).is_dir() for point in found["points"])
    methods = ("vmf", "cramer_rao", "no_motion")
    assert len(found["rows"]) == 4 * 2 * len(methods)
    assert {row["method"] for row in found["rows"]} == set(methods)


def test_what_is_done_is_left_alone_and_new_points_join(tmp_path: Path, undisturbed: Path) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    before = {name: (path / "run.json").stat().st_ino for name, path in points(out).items()}
    said = json.loads(run_sweep(out, "noise.pixel_px=0,3,5", "data.simulate.seed=1,2", "--json").out)
    assert [point["status"] for point in said["points"]] == ["kept"] * 4 + ["done"] * 2
    after = {name: (path / "run.json").stat().st_ino for name, path in points(out).items()}
    assert len(after) == 6
    assert before.items() <= after.items()


@pytest.mark.parametrize("damage", [lambda file: file.write_bytes(b""), Path.unlink], ids=["empty", "gone"])
@pytest.mark.parametrize("name", ["errors.parquet", "model.npz", "run.json"])
def test_a_point_that_is_not_whole_is_done_again(
    tmp_path: Path, undisturbed: Path, name: str, damage: Any
) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    damage(next(iter(points(out).values())) / name)
    said = json.loads(run_sweep(out, *GRID, "--json").out)
    assert sorted(point["status"] for point in said["points"]) == ["done", "kept", "kept", "kept"]
    assert contents(out) == contents(undisturbed)


def test_what_a_killed_call_left_beside_results_is_removed(tmp_path: Path, undisturbed: Path) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    point = next(iter(points(out).values()))
    (point / "trials").mkdir()
    (point / "trials" / "000000.parquet").write_bytes(b"PAR1")
    run_sweep(out, *GRID)
    assert contents(out) == contents(undisturbed)


@pytest.mark.parametrize("content", [b"", b"PAR", b"PAR1" + bytes(100)])
def test_a_trial_without_its_end_is_done_again(tmp_path: Path, undisturbed: Path, content: bytes) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    point = next(iter(points(out).values()))
    (point / "run.json").write_text(json.dumps({**record(point), "status": "running"}))
    (point / "trials").mkdir()
    (point / "trials" / "000001.parquet").write_bytes(content)
    (point / ".errors.parquet.x8f2").write_bytes(b"half")
    run_sweep(out, *GRID)
    assert contents(out) == contents(undisturbed)
    assert record(point)["resumed"] == 1


def test_equal_points_are_one(tmp_path: Path) -> None:
    said = vmf("sweep", QUICKSTART, *SMALL, "noise.pixel_px=1,1.0,1e0", "--out", tmp_path, "--jobs", 1)
    assert said.code == 0
    assert "2 points say the same as another one" in said.err
    assert len(points(tmp_path)) == 1


def test_comparisons_have_a_directory_of_their_own(tmp_path: Path) -> None:
    run_sweep(tmp_path, "noise.pixel_px=3", "name=mine")
    run_sweep(tmp_path, "noise.pixel_px=3", "name=mine", "--command", "compare-3d")
    (trained,) = (tmp_path / "mine-sweep").glob("*/run.json")
    (compared,) = (tmp_path / "mine-compare-3d-sweep").glob("*/paired.csv")
    assert trained.parent.name == compared.parent.name
    other = train(QUICKSTART, tmp_path, *SMALL, "name=mine", command="compare-3d")
    assert (other / "paired.csv").read_bytes() == compared.read_bytes()
    assert same_results(other, compared.parent)


def test_comparisons_have_their_calibration_errors_with_them(tmp_path: Path) -> None:
    errors = (
        "calibration_sweep={focal_percent: [1], principal_px: [], rotation_deg: [4], baseline_percent: [], "
        "questions: 4}"
    )
    (point,) = points_of_comparison(tmp_path, errors)
    run = train(QUICKSTART, tmp_path, *SMALL, "noise.pixel_px=3", errors, command="compare-3d")
    for file in (*SAME, "paired.csv", "crossover.csv"):
        assert (run / file).read_bytes() == (point / file).read_bytes()
    assert record(run)["swept"] == record(point)["swept"] == ["bundle[focal=1%]", "bundle[rot=4deg]"]
    assert "focal=1%" not in vmf("table", point).out
    # An answer that the calibration sweep alone asked for is no part of what a point did not reach.
    assert record(run)["losses"] == record(point)["losses"]
    (point / "summary.csv").write_bytes(b"")
    (again,) = points_of_comparison(tmp_path, errors)
    assert (again / "crossover.csv").read_bytes() == (run / "crossover.csv").read_bytes()


def points_of_comparison(out: Path, errors: str) -> list[Path]:
    run_sweep(out, "noise.pixel_px=3", errors, "--command", "compare-3d")
    return [path.parent for path in out.glob("quickstart-compare-3d-sweep/*/run.json")]


def test_figures_are_drawn_if_asked_for(tmp_path: Path) -> None:
    # Drawing itself is left out here; its directory is made by who draws.
    run_sweep(tmp_path, "noise.pixel_px=1")
    run_sweep(tmp_path, "noise.pixel_px=1,2", "--plots")
    assert [(point / "plots").is_dir() for point in points(tmp_path).values()].count(True) == 1


# --- failures


def test_a_point_that_fails_is_said_at_once_and_tried_again(tmp_path: Path) -> None:
    heard: list[str] = []
    texts = (*SMALL, f"data.simulate.workspace={BEHIND},{{}}", "noise.pixel_px=1,2")
    result = sweep(
        QUICKSTART,
        texts,
        None,
        "train",
        SweepOptions(tmp_path),
        progress=lambda done, total, what: heard.append(f"{done}/{total}"),
        say=heard.append,
    )
    assert [point.failure is None for point in result.points] == [False, False, True, True]
    assert not result.all_wrong
    failures = [i for i, line in enumerate(heard) if line.startswith("failed: ")]
    assert len(failures) == 2
    assert failures[0] < heard.index("4/8")
    assert heard[-1] == "8/8"
    first = heard[failures[0]]
    assert str(result.points[0].point.path) in first
    assert "noise.pixel_px=1" in first
    assert "workspace" in first
    assert "\n" not in first

    failed = record(result.points[0].point.path)
    assert failed["status"] == "failed"
    assert "workspace" in failed["error"]
    said = run_sweep(tmp_path, *texts, code=3)
    assert len([line for line in said.err.splitlines() if line.startswith("failed: ")]) == 2
    assert "2 before, 2 failed" in said.out
    assert record(result.points[0].point.path)["resumed"] == 1


def test_if_every_points_input_is_wrong_so_is_the_sweeps(tmp_path: Path) -> None:
    said = run_sweep(tmp_path, f"data.simulate.workspace={BEHIND}", "noise.pixel_px=1,2", code=2)
    assert len(said.err.splitlines()) == 2


def test_an_error_in_the_program_is_one_line_and_a_trace_in_the_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ArithmeticError("impossible")

    monkeypatch.setattr("vmf.experiment.work.simulated_trial", broken)
    said = run_sweep(tmp_path, code=3)
    assert len(said.err.splitlines()) == 1
    assert "ArithmeticError: impossible" in said.err
    (point,) = points(tmp_path).values()
    assert "Traceback" in record(point)["trace"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("noise.pixel_px=0,-1",), "command line: noise.pixel_px=-1: found -1"),
        (("evaluate.checkpoints=[5],[500]",), "evaluate.checkpoints: found 500"),
        (("solver.known=none,rotation",), "solver.known: rotation has no meaning"),
        (("name=a,b",), "a sweep has one directory"),
        (("noise.pixel_px=1,,2",), "values separated by commas"),
        (("--command", "evaluate"), "--command: found 'evaluate'"),
        (("--grid", "/nowhere.yaml"), "no such file, a grid in YAML"),
    ],
)
def test_what_is_wrong_with_a_point_is_said_before_any_work(
    tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    vmf("sweep", QUICKSTART, *SMALL, *arguments, "--out", tmp_path / "out").refused(said)
    assert not (tmp_path / "out").exists()


def test_a_point_whose_directory_is_of_no_use_fails_alone(tmp_path: Path, undisturbed: Path) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    name, point = next(iter(points(out).items()))
    shutil.rmtree(point)
    point.write_text("a file")
    said = run_sweep(out, *GRID, code=3)
    (line,) = (line for line in said.err.splitlines() if line.startswith("failed: "))
    assert name in line
    assert "3 before, 1 failed" in said.out


def test_a_trial_that_cannot_be_read_is_made_again_next_time(tmp_path: Path, undisturbed: Path) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    point = next(iter(points(out).values()))
    (point / "run.json").write_text(json.dumps({**record(point), "status": "running"}))
    (point / "trials").mkdir()
    # Whole by its ends.
    (point / "trials" / "000000.parquet").write_bytes(b"PAR1" + bytes(100) + b"PAR1")
    said = run_sweep(out, *GRID, code=3)
    assert "000000.parquet: damaged and removed" in said.err
    run_sweep(out, *GRID)
    assert contents(out) == contents(undisturbed)


@pytest.mark.parametrize(
    "other", [{"packages": {"numpy": "1.0.0"}}, {"git_commit": "0" * 40}, {"git_dirty": "perhaps"}]
)
def test_trials_of_another_program_are_not_used(
    tmp_path: Path, undisturbed: Path, other: dict[str, Any]
) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    point = next(iter(points(out).values()))
    (point / "run.json").write_text(json.dumps({**record(point), "status": "interrupted", **other}))
    run_sweep(out, *GRID)
    assert "resumed" not in record(point)
    assert contents(out) == contents(undisturbed)


def test_figures_of_what_was_done_before_are_missed_aloud(tmp_path: Path, undisturbed: Path) -> None:
    out = tmp_path / "copy"
    shutil.copytree(undisturbed, out)
    said = vmf("sweep", QUICKSTART, *SMALL, *GRID, "--plots", "--out", out, "--jobs", 1)
    assert said.code == 0
    assert "figures of 4 points that were done before are not drawn" in said.err


def test_two_sweeps_do_not_work_in_one_directory(tmp_path: Path) -> None:
    (tmp_path / "quickstart-sweep").mkdir()
    with (tmp_path / "quickstart-sweep" / ".lock").open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        vmf("sweep", QUICKSTART, *SMALL, "--out", tmp_path).refused("another sweep is at work here")
    run_sweep(tmp_path)


def test_a_directory_that_cannot_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    vmf("sweep", QUICKSTART, *SMALL, "--out", tmp_path / "file").refused("--out")


# --- recordings


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A spec about two recordings, of which one is there."""
    vmf("simulate", QUICKSTART, "-o", tmp_path / "a.mcap", "data.simulate.frames=20")
    spec = tmp_path / "spec.yaml"
    spec.write_text(
        "task: translation\nlearner: {kind: transport}\nevaluate: {curve_points: 3, bootstrap: 20}\n"
        "data: {recording: {path: a.mcap, pose: {topic: /robot/pose}, tracks: {topic: /stereo/tracks}}}\n"
    )
    return spec


def test_recordings_are_points_like_any_other(tmp_path: Path, recorded: Path) -> None:
    out = tmp_path / "out"
    arguments = ("data.recording.path=a.mcap,b.mcap", "evaluate.gaps=[1],[2]", "--out", out, "--quiet")
    said = vmf("sweep", recorded, *arguments, "--jobs", 2)
    assert said.code == 3
    assert said.err.count("b.mcap: No such file or directory") == 2
    vmf("simulate", QUICKSTART, "-o", tmp_path / "b.mcap", "data.simulate.frames=20", "data.simulate.seed=2")
    again = vmf("sweep", recorded, *arguments, "--jobs", 1, "--json")
    assert again.code == 0
    statuses = [point["status"] for point in json.loads(again.out)["points"]]
    assert statuses == ["kept", "kept", "done", "done"]
    run = train(recorded, tmp_path, "evaluate.gaps=[2]")
    point = points(out)[run.name.split("-")[0]]
    for file in SAME:
        assert (run / file).read_bytes() == (point / file).read_bytes()
    assert record(run)["inputs"] == record(point)["inputs"]

    # Another recording under the same name is another input.
    old = contents(out)
    vmf("simulate", QUICKSTART, "-o", tmp_path / "b.mcap", "data.simulate.frames=20", "data.simulate.seed=3")
    changed = json.loads(vmf("sweep", recorded, *arguments, "--jobs", 1, "--json").out)
    assert [point["status"] for point in changed["points"]] == ["kept", "kept", "done", "done"]
    assert sum(contents(out)[name] == old[name] for name in old) == 2


# --- interruptions


def started(out: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "vmf", "sweep", str(QUICKSTART), *SMALL, *arguments, "--out", str(out)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def workers_of(process: subprocess.Popen[str]) -> tuple[list[psutil.Process], list[psutil.Process]]:
    """The workers of a sweep, and Python's own helper beside them, which ends when it has seen all end."""
    children = psutil.Process(process.pid).children()
    workers = [child for child in children if "spawn_main" in " ".join(child.cmdline())]
    return workers, [child for child in children if child not in workers]


def finished_trials(out: Path) -> set[tuple[str, str]]:
    """All trials that no later call has to do again."""
    found = set()
    for name, path in points(out).items():
        kept = (path / "trials").glob("[0-9]*.parquet")
        done = record(path)["status"] == "done"
        found |= {(name, f"{n:06d}") for n in range(2)} if done else {(name, file.stem) for file in kept}
    return found


def test_a_worker_that_is_killed_costs_no_result(tmp_path: Path, undisturbed: Path) -> None:
    with started(tmp_path, *GRID, "--jobs", "2") as process:
        until(lambda: finished_trials(tmp_path))
        workers_of(process)[0][0].kill()
        err = process.communicate(timeout=DEADLINE_S)[1]
    assert process.returncode == 0, err
    assert contents(tmp_path) == contents(undisturbed)


def test_ctrl_c_ends_a_sweep_at_once_and_the_next_call_goes_on(tmp_path: Path, undisturbed: Path) -> None:
    with started(tmp_path, *GRID, "--jobs", "2") as process:
        until(lambda: finished_trials(tmp_path))
        workers, helpers = workers_of(process)
        os.killpg(process.pid, signal.SIGINT)
        err = process.communicate(timeout=DEADLINE_S)[1]
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "the same command goes on from there" in err
    assert not any(alive(worker.pid) for worker in workers)
    until(lambda: not any(alive(helper.pid) for helper in helpers))
    assert {record(path)["status"] for path in points(tmp_path).values()} <= {"done", "interrupted"}
    kept = finished_trials(tmp_path)
    run_sweep(tmp_path, *GRID)
    assert kept <= finished_trials(tmp_path)
    assert contents(tmp_path) == contents(undisturbed)


@pytest.mark.parametrize("kills", [3, pytest.param(20, marks=pytest.mark.long)])
def test_a_sweep_killed_at_random_moments_ends_as_an_undisturbed_one(tmp_path: Path, kills: int) -> None:
    texts = (*SMALL, "noise.pixel_px=0,1,3", "data.simulate.seed=1,2,3,4")
    whole, out = tmp_path / "whole", tmp_path / "killed"
    run_sweep(whole, *texts)
    # Forked from a process that has everything loaded, so that most of the time is work.
    context = get_context("forkserver")
    context.set_forkserver_preload(["vmf.experiment", "vmf.cli"])
    moments = random.Random(kills)
    kept: set[tuple[str, str]] = set()
    killed = 0
    while killed < kills:
        options = SweepOptions(out, jobs=1 + (killed % 5 == 0))
        process = context.Process(target=sweep, args=(QUICKSTART, texts, None, "train", options))
        process.start()
        enough = len(kept) + moments.randrange(3)
        until(lambda p=process, n=enough: not p.is_alive() or len(finished_trials(out)) >= n)
        process.join(moments.uniform(0.0, 0.1))
        process.kill()
        process.join()
        now = finished_trials(out)
        assert kept <= now
        kept = now
        killed += process.exitcode == -signal.SIGKILL
        if process.exitcode == 0 and killed < kills:
            assert contents(out) == contents(whole)
            shutil.rmtree(out)
            kept = set()
    run_sweep(out, *texts)
    assert contents(out) == contents(whole)


class Died(BaseException):
    """The end of a process, after which nothing is written."""


@pytest.mark.parametrize("end", [Died, KeyboardInterrupt])
def test_a_sweep_ended_after_any_of_its_writes_ends_as_an_undisturbed_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: type[BaseException]
) -> None:
    texts, options = (*SMALL, "noise.pixel_px=1"), SweepOptions
    written: list[Path] = []
    real, last = os.replace, -1

    def replace(source: str, target: Path) -> None:
        if end is Died and len(written) > last >= 0:
            raise Died
        real(source, target)
        written.append(target)
        if len(written) - 1 == last:
            raise end

    monkeypatch.setattr("vmf.experiment.atomic.os.replace", replace)
    sweep(QUICKSTART, texts, None, "train", options(tmp_path / "whole"))
    whole, n = contents(tmp_path / "whole"), len(written)
    assert n > len(SAME)
    for last in range(n):
        out = tmp_path / str(last)
        written.clear()
        with pytest.raises(end):
            sweep(QUICKSTART, texts, None, "train", options(out))
        if end is KeyboardInterrupt:
            assert {record(path)["status"] for path in points(out).values()} <= {"interrupted", "done"}
        last = -1
        sweep(QUICKSTART, texts, None, "train", options(out))
        assert contents(out) == whole
        written.clear()
        sweep(QUICKSTART, texts, None, "train", options(out))
        assert written == []


def test_the_name_of_a_point_is_the_hash_of_its_spec(undisturbed: Path) -> None:
    from vmf.spec import spec_hash

    for name, path in points(undisturbed).items():
        assert spec_hash(load(path / "spec.yaml").spec) == name
