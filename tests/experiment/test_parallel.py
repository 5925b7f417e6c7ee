"""Workers: every piece of work comes back once, whoever dies on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
from polling import DEADLINE_S, alive, until
from threadpoolctl import threadpool_info

from vmf.errors import InputError
from vmf.experiment.parallel import DEATHS, Alone, Crew, Failure, Pool, Why, crew, run_all


@dataclass(frozen=True)
class Square:
    number: int

    def __call__(self) -> int:
        return self.number**2


@dataclass(frozen=True)
class Deadly(Square):
    """Kills its process as often as it is told to, and counts."""

    deaths: int
    tally: Path

    def __call__(self) -> int:
        with self.tally.open("a") as stream:
            stream.write("x")
        if self.tally.stat().st_size <= self.deaths:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().__call__()


@dataclass(frozen=True)
class Wrong(Square):
    def __call__(self) -> int:
        raise InputError("noise: found -1", "task: missing")


@dataclass(frozen=True)
class Broken(Square):
    def __call__(self) -> int:
        return 1 // (self.number - self.number)


@dataclass(frozen=True)
class Me(Square):
    def __call__(self) -> int:
        return os.getpid()


@dataclass(frozen=True)
class BlasThreads(Square):
    def __call__(self) -> int:
        import scipy.linalg  # noqa: F401

        return max(pool["num_threads"] for pool in threadpool_info())


def results(workers: Crew[Square, int], works: list[Square]) -> dict[int, int | Failure]:
    found = []
    with workers:
        found = [(work.number, result) for work, result in run_all(workers, works)]
    assert len(found) == len(dict(found)) == len(works)
    return dict(found)


@pytest.mark.parametrize("jobs", [1, 2])
def test_all_work_comes_back_once(jobs: int) -> None:
    found = results(crew(jobs, 20), [Square(n) for n in range(20)])
    assert found == {n: n**2 for n in range(20)}


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_fails_says_why_and_stops_nobody(jobs: int) -> None:
    found = results(crew(jobs, 4), [Wrong(0), Square(1), Broken(2), Square(3)])
    assert found[1] == 1
    assert found[3] == 9
    wrong, broken = found[0], found[2]
    assert wrong == Failure(Why.INPUT, ("noise: found -1", "task: missing"))
    assert isinstance(broken, Failure)
    assert broken.why is Why.BUG
    assert "ZeroDivisionError" in str(broken)
    assert "Traceback" not in str(broken)
    assert "test_parallel.py" in broken.trace


@pytest.mark.parametrize("jobs", [1, 2])
def test_workers_have_one_blas_thread(jobs: int) -> None:
    found = results(crew(jobs, 2), [BlasThreads(0), BlasThreads(1)])
    assert found == {0: 1, 1: 1}


def test_work_of_a_worker_that_dies_is_redone_unless_it_is_the_work_that_kills(tmp_path: Path) -> None:
    deaths = {2: 10**6, 3: 1}
    works: list[Square] = [Deadly(n, deaths.get(n, 0), tmp_path / str(n)) for n in range(6)]
    found = results(Pool(2), works)
    lost = found.pop(2)
    assert found == {n: n**2 for n in (0, 1, 3, 4, 5)}
    assert isinstance(lost, Failure)
    assert lost.why is Why.LOST
    assert str(DEATHS) in str(lost)
    assert (tmp_path / "2").stat().st_size == DEATHS
    assert (tmp_path / "3").stat().st_size == 2


@dataclass(frozen=True)
class Large:
    """Returns more than a pipe holds, and says which process is about to."""

    pids: Path

    def __call__(self) -> bytes:
        (self.pids / str(os.getpid())).touch()
        return bytes(10**7)


def test_a_worker_that_is_killed_halfway_through_its_answer_is_replaced(tmp_path: Path) -> None:
    pool: Pool[Large, bytes] = Pool(2)
    with pool:
        pool.submit(Large(tmp_path))
        until(lambda: list(tmp_path.iterdir()))
        pid = int(next(tmp_path.iterdir()).name)
        # Nobody reads what it writes, so that it cannot get to the end.
        until(lambda: psutil.Process(pid).status() == psutil.STATUS_SLEEPING)
        os.kill(pid, signal.SIGKILL)
        ((_, result),) = pool.wait()
    assert result == bytes(10**7)
    assert len(list(tmp_path.iterdir())) == 2


def test_a_worker_that_is_killed_with_nothing_to_do_is_replaced() -> None:
    pool: Pool[Me, int] = Pool(2)
    with pool:
        pool.submit(Me(0))
        ((_, pid),) = pool.wait()
        assert isinstance(pid, int)
        os.kill(pid, signal.SIGKILL)
        until(lambda: not alive(pid))
        pool.submit(Me(1))
        ((_, other),) = pool.wait()
    assert other not in (pid, os.getpid())


def test_alone_there_is_no_other_process() -> None:
    assert results(Alone(), [Me(0)]) == {0: os.getpid()}


WAITERS = """
import os, signal, sys
from dataclasses import dataclass
from pathlib import Path
from vmf.experiment.parallel import Pool, run_all

@dataclass(frozen=True)
class Wait:
    directory: Path

    def __call__(self):
        (self.directory / str(os.getpid())).touch()
        signal.pause()

if __name__ == "__main__":
    pool = Pool(2)
    with pool:
        list(run_all(pool, [Wait(Path(sys.argv[1]))] * 2))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_process_that_started_them(tmp_path: Path, how: signal.Signals) -> None:
    script, pids = tmp_path / "waiters.py", tmp_path / "pids"
    script.write_text(WAITERS)
    pids.mkdir()
    # In a group of its own, which Ctrl-C goes to as a whole, while the others mean the one process.
    with subprocess.Popen(
        [sys.executable, str(script), str(pids)], stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        until(lambda: len(list(pids.iterdir())) == 2)
        workers = [int(path.name) for path in pids.iterdir()]
        if how is signal.SIGINT:
            os.killpg(process.pid, how)
        else:
            process.send_signal(how)
        err = process.communicate(timeout=DEADLINE_S)[1]
    until(lambda: not any(alive(pid) for pid in workers))
    # The script does not catch Ctrl-C, so it has a traceback; its workers have none.
    assert err.count("Traceback") <= (how is signal.SIGINT)
