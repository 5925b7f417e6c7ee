"""A sweep on the workers of a Dask scheduler: the same results, whoever dies; loopback only."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import distributed
import psutil
import pytest
from polling import DEADLINE_S, until
from vmf_command import CONFIGS, MINI, vmf

from vmf.errors import InputError, UnfinishedError
from vmf.experiment.cluster import Cluster
from vmf.experiment.parallel import Failure, Why, run_all
from vmf.experiment.program import program

QUICKSTART = CONFIGS / "quickstart.yaml"
SMALL = (*MINI, "learner.kind=transport", "data.simulate.seed=1,2,3,4,5", "noise.pixel_px=0,3")
SAME = ("errors.parquet", "summary.csv", "model.npz", "spec.yaml")


@pytest.fixture(scope="module")
def cluster() -> Iterator[distributed.LocalCluster]:
    """A scheduler and two workers, each a process of its own; nobody replaces one that dies for good."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=100
    ) as running:
        yield running


def contents(out: Path) -> dict[str, bytes]:
    return {str(p.relative_to(out)): p.read_bytes() for name in SAME for p in out.glob(f"*/*/{name}")}


@pytest.mark.long
def test_results_are_the_same_bytes_though_a_worker_is_killed(
    tmp_path: Path, cluster: distributed.LocalCluster
) -> None:
    alone, there = tmp_path / "alone", tmp_path / "there"
    assert vmf("sweep", QUICKSTART, *SMALL, "--out", alone, "--jobs", 1, "--quiet").code == 0
    address = cluster.scheduler_address
    with distributed.Client(address, set_as_default=False) as client:
        pids = client.run(os.getpid)
    command = [sys.executable, "-m", "vmf", "sweep", str(QUICKSTART), *SMALL, "--out", str(there)]
    with subprocess.Popen(
        [*command, "--scheduler", address, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        until(lambda: process.poll() is not None or list(there.glob("*/*/trials/*.parquet")))
        listening = [c for c in psutil.Process(process.pid).net_connections() if c.status == "LISTEN"]
        os.kill(next(iter(pids.values())), signal.SIGKILL)
        out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    assert listening == []
    assert [point["status"] for point in json.loads(out)["points"]] == ["done"] * 10
    assert contents(there) == contents(alone)
    assert len(contents(there)) == 10 * len(SAME)


@dataclass(frozen=True)
class Deadly:
    """Kills every worker that takes it."""

    deadly: bool

    def __call__(self) -> int:
        if self.deadly:
            os.kill(os.getpid(), signal.SIGKILL)
        return 1


@pytest.mark.long
def test_work_that_kills_its_workers_is_given_up(cluster: distributed.LocalCluster) -> None:
    workers: Cluster[Deadly, int] = Cluster(cluster.scheduler_address)
    with workers:
        found = [
            (work.deadly, result) for work, result in run_all(workers, map(Deadly, [False, True, False]))
        ]
    (lost,) = [result for deadly, result in found if deadly]
    assert isinstance(lost, Failure)
    assert lost.why is Why.LOST
    assert [result for deadly, result in found if not deadly] == [1, 1]


@dataclass(frozen=True)
class Where:
    """Says which process did it."""

    def __call__(self) -> int:
        return os.getpid()


@pytest.mark.long
def test_a_result_that_died_with_its_worker_is_worked_out_again(cluster: distributed.LocalCluster) -> None:
    workers: Cluster[Where, int] = Cluster(cluster.scheduler_address)
    with workers:
        workers.submit(Where())
        (future,) = workers._works
        until(lambda: future.status == "finished")
        with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
            pids = client.run(os.getpid).values()
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        until(lambda: future.status != "finished")
        ((_, found),) = workers.wait()
    assert isinstance(found, int)
    assert found not in pids


@pytest.mark.long
def test_work_that_the_scheduler_gives_back_undone_is_said_in_one_line(
    cluster: distributed.LocalCluster,
) -> None:
    """As it does with all of it when the connection is lost."""
    workers: Cluster[Where, int] = Cluster(cluster.scheduler_address)
    with workers:
        workers.submit(Where())
        (future,) = workers._works
        future.cancel()
        with pytest.raises(UnfinishedError, match=r"it went away.*the same command goes on from there"):
            workers.wait()


@pytest.mark.long
def test_failures_name_the_worker(tmp_path: Path, cluster: distributed.LocalCluster) -> None:
    recording = tmp_path / "a.mcap"
    spec = tmp_path / "spec.yaml"
    recording.write_bytes(b"nonsense")
    spec.write_text(
        "task: translation\n"
        "data: {recording: {path: a.mcap, pose: {topic: /robot/pose}, tracks: {topic: /stereo/tracks}}}\n"
    )
    address = cluster.scheduler_address
    said = vmf("sweep", spec, "--out", tmp_path / "out", "--scheduler", address, "--quiet")
    assert said.code == 2
    (line,) = said.err.splitlines()
    assert "a.mcap" in line
    assert "(on worker tcp://127.0.0.1:" in line


@pytest.mark.long
def test_workers_with_another_program_are_refused(
    cluster: distributed.LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = replace(program(), version="0.0.0")
    monkeypatch.setattr("vmf.experiment.cluster.program", lambda: mine)
    workers: Cluster[Deadly, int] = Cluster(cluster.scheduler_address)
    with (
        pytest.raises(
            InputError, match=r"worker tcp://.*: found vmf 0\.\d.*accepted is .*: vmf 0\.0\.0, commit"
        ),
        workers,
    ):
        pass


def test_a_scheduler_that_is_not_there_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vmf.experiment.cluster._PATIENCE_S", 0.5)
    for address in ("tcp://127.0.0.1:1", "nonsense://x:1"):
        said = vmf("sweep", QUICKSTART, *SMALL, "--out", tmp_path, "--scheduler", address)
        said.refused(f"--scheduler {address}: no Dask scheduler answers there")
    for address in ("nonsense", "127.0.0.1:8786", "tcp://host"):
        said = vmf("sweep", QUICKSTART, *SMALL, "--out", tmp_path, "--scheduler", address)
        said.refused(f"--scheduler: found {address}", "tcp://127.0.0.1:8786")


def test_without_the_package_one_line_says_what_brings_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "vmf.experiment.cluster", raising=False)
    said = vmf("sweep", QUICKSTART, *SMALL, "--out", tmp_path, "--scheduler", "tcp://127.0.0.1:1")
    said.refused("--scheduler: the package distributed is not installed", "vmf[cluster]")
