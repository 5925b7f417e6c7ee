"""A spec says its results: however often, on however many cores, after whatever interruptions."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import psutil
import pytest
from polling import DEADLINE_S, until
from vmf_command import CONFIGS, QUICK, errors, record, same_results, train, vmf

from vmf.experiment import outcome_file
from vmf.experiment.parallel import Crew, Failure, Why
from vmf.experiment.work import TrialResult, TrialWork

QUICKSTART = CONFIGS / "quickstart.yaml"
LONG = (*QUICK, "data.simulate.frames=20", "evaluate.trials=40")
# Trials seen on disk before a run is stopped.
ENOUGH = 3


def test_the_same_spec_gives_the_same_bytes(tmp_path: Path) -> None:
    a, b = (train(QUICKSTART, tmp_path, *QUICK) for _ in range(2))
    assert a != b
    assert same_results(a, b)
    assert (a / "model.npz").read_bytes() == (b / "model.npz").read_bytes()
    assert (a / "spec.yaml").read_bytes() == (b / "spec.yaml").read_bytes()
    assert not same_results(a, train(QUICKSTART, tmp_path, *QUICK, "data.simulate.seed=2"))


def test_comparison_is_as_repeatable(tmp_path: Path) -> None:
    a, b = (train(QUICKSTART, tmp_path, *QUICK, command="compare-3d") for _ in range(2))
    assert same_results(a, b)
    assert (a / "paired.csv").read_bytes() == (b / "paired.csv").read_bytes()


def test_the_number_of_processes_changes_nothing(tmp_path: Path) -> None:
    more = (*QUICK, "evaluate.trials=4", "noise.outlier_ratio=0.05", "learner.loss=tukey")
    alone = train(QUICKSTART, tmp_path, *more)
    said = vmf("train", QUICKSTART, *more, "--out", tmp_path, "--jobs", 2, "--json", "--quiet")
    assert said.code == 0
    assert same_results(alone, said.run)
    assert (alone / "model.npz").read_bytes() == (said.run / "model.npz").read_bytes()


def test_a_trial_does_not_depend_on_how_many_there_are(tmp_path: Path) -> None:
    few = (train(QUICKSTART, tmp_path, *QUICK) / "model.npz").read_bytes()
    two = errors(train(QUICKSTART, tmp_path, *QUICK))
    three_run = train(QUICKSTART, tmp_path, *QUICK, "evaluate.trials=3")
    three = errors(three_run)
    assert three[three["trial"] < 2].reset_index(drop=True).equals(two)
    # The spec in it differs in the number of trials, so the bytes do.
    assert (three_run / "model.npz").read_bytes() != few


def stopped(out: Path, how: signal.Signals, jobs: int = 1) -> tuple[Path, int, str]:
    """Start a long run and stop all its processes when some trials are done; directory, code, stderr."""
    command = [sys.executable, "-m", "vmf", "train", str(QUICKSTART), *LONG]
    command += ["--out", str(out), "--jobs", str(jobs)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        finished: list[Path] = []
        while len(finished) < ENOUGH:
            finished = list(out.glob("quickstart/latest/trials/*.parquet"))
            try:
                process.wait(0.01)
            except subprocess.TimeoutExpired:
                continue
            raise AssertionError(f"it ended by itself: {process.communicate()[1]}")
        os.killpg(process.pid, how)
        err = process.communicate()[1]
    return (out / "quickstart" / "latest").resolve(), process.returncode, err


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return train(QUICKSTART, tmp_path_factory.mktemp("undisturbed"), *LONG)


def resumed(out: Path) -> Path:
    said = vmf("train", QUICKSTART, *LONG, "--out", out, "--jobs", 1, "--json", "--resume", "--quiet")
    assert said.code == 0, said.err
    return said.run.resolve()


def test_a_killed_run_goes_on_where_it_was(tmp_path: Path, undisturbed: Path) -> None:
    run, code, _ = stopped(tmp_path, signal.SIGKILL)
    assert code == -signal.SIGKILL
    assert record(run)["status"] == "running"
    assert not (run / "errors.parquet").exists()
    first = run / "trials" / "000000.parquet"
    # If a finished trial were done again, its file would come back.
    kept = first.stat().st_ino, first.stat().st_mtime_ns
    seen: list[tuple[int, int]] = []
    with when_gathered(first, seen):
        again = resumed(tmp_path)
    assert again == run
    assert seen == [kept]
    assert same_results(run, undisturbed)
    assert record(run)["status"] == "done"
    assert record(run)["resumed"] == 1
    assert not (run / "trials").exists()


def when_gathered(path: Path, seen: list[tuple[int, int]]) -> AbstractContextManager[object]:
    """Note the identity of a trial's file when results are gathered."""
    load = outcome_file.load

    def noting(trial: Path) -> object:
        if trial.name == path.name:
            seen.append((trial.stat().st_ino, trial.stat().st_mtime_ns))
        return load(trial)

    return patch.object(outcome_file, "load", noting)


def test_resume_without_an_unfinished_run_begins_a_new_one(tmp_path: Path) -> None:
    done = train(QUICKSTART, tmp_path, *QUICK)
    said = vmf("train", QUICKSTART, *QUICK, "--out", tmp_path, "--jobs", 1, "--json", "--resume", "--quiet")
    assert said.code == 0
    assert said.run != done
    assert same_results(done, said.run)


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.long)])
def test_an_interrupted_run_says_so_and_goes_on_where_it_was(
    tmp_path: Path, undisturbed: Path, jobs: int
) -> None:
    run, code, _ = stopped(tmp_path, signal.SIGINT, jobs)
    assert code != 0
    assert record(run)["status"] == "interrupted"
    assert len(list((run / "trials").glob("*.parquet"))) >= ENOUGH
    assert resumed(tmp_path) == run
    assert same_results(run, undisturbed)
    assert record(run)["status"] == "done"


def test_an_interrupted_run_exits_with_130(tmp_path: Path) -> None:
    _, code, err = stopped(tmp_path, signal.SIGINT)
    assert code == 130
    assert "--resume" in err


def test_an_interrupted_run_prints_no_traceback(tmp_path: Path) -> None:
    _, _, err = stopped(tmp_path, signal.SIGINT)
    assert "Traceback" not in err


def test_a_failed_run_says_so_and_why(tmp_path: Path) -> None:
    behind = "data.simulate.workspace={target_low_m: [0, 0, -5], target_high_m: [1, 1, -4]}"
    vmf("train", QUICKSTART, *QUICK, behind, "--out", tmp_path, "--jobs", 1).refused("workspace")
    said = record(tmp_path / "quickstart" / "latest")
    assert said["status"] == "failed"
    assert "workspace" in said["error"]
    vmf("table", tmp_path / "quickstart" / "latest").refused("failed", "a finished run is expected")


def test_a_resumed_run_records_the_inputs_it_used_and_no_stale_error(tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text(
        "task: translation\nlearner: {kind: transport}\n"
        "evaluate: {min_targets: 3, curve_points: 3, bootstrap: 20}\n"
        "data: {recording: {path: a.mcap, pose: {topic: /robot/pose}, tracks: {topic: /stereo/tracks}}}\n"
    )
    recording = tmp_path / "a.mcap"
    vmf("simulate", QUICKSTART, "-o", recording, "data.simulate.frames=20", "data.simulate.targets=2")
    vmf("train", spec, "--out", tmp_path).refused("share 3 targets")
    vmf("simulate", QUICKSTART, "-o", recording, "data.simulate.frames=20")
    said = vmf("train", spec, "--out", tmp_path, "--resume", "--json", "--quiet")
    assert said.code == 0
    assert record(said.run)["inputs"] == {str(recording): hashlib.sha256(recording.read_bytes()).hexdigest()}
    assert "error" not in record(said.run)


def test_a_trial_that_kills_its_workers_is_reported_and_the_others_are_kept(
    tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def losing(workers: Crew[TrialWork, TrialResult], works: list[TrialWork]) -> Iterator[Any]:
        for work in works:
            yield work, Failure(Why.LOST, ("its worker was killed",)) if work.number == 7 else work()

    monkeypatch.setattr("vmf.experiment.run.run_all", losing)
    said = vmf("train", QUICKSTART, *LONG, "--out", tmp_path, "--jobs", 1, "--quiet")
    assert (said.code, said.out) == (3, "")
    assert said.err.splitlines() == [
        "trial 7: its worker was killed",
        "39 of 40 trials are on disk, --resume goes on from there",
    ]
    run = (tmp_path / "quickstart" / "latest").resolve()
    assert record(run)["status"] == "failed"
    monkeypatch.undo()
    assert resumed(tmp_path) == run
    assert same_results(run, undisturbed)


@pytest.mark.long
def test_a_worker_that_is_killed_costs_no_result(tmp_path: Path, undisturbed: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "vmf",
        "train",
        str(QUICKSTART),
        *LONG,
        "--out",
        str(tmp_path),
        "--jobs",
        "2",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        until(lambda: process.poll() is not None or list(tmp_path.glob("*/latest/trials/*.parquet")))
        children = psutil.Process(process.pid).children()
        next(child for child in children if "spawn_main" in " ".join(child.cmdline())).kill()
        err = process.communicate(timeout=DEADLINE_S)[1]
    assert process.returncode == 0, err
    assert same_results(tmp_path / "quickstart" / "latest", undisturbed)
