"""Work on the workers of a Dask scheduler that is already there."""

from __future__ import annotations

import logging
import re
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from typing import Any, Generic, Self

import distributed
from threadpoolctl import threadpool_info

from vmf.errors import InputError, UnfinishedError
from vmf.experiment.parallel import Failure, T, W, Why, attempt, one_blas_thread
from vmf.experiment.program import program

# Pieces handed out at once: more than clusters have threads, fewer than weigh on a scheduler.
_AHEAD = 1000
_PATIENCE_S = 10
_ADDRESS = re.compile(r"[a-z]+://.+:\d+")


class Cluster(Generic[W, T]):
    """The workers of a Dask scheduler, reached as a client: nothing here listens.

    The scheduler gives the work of a worker that died to another one, and gives it up when as many have died
    of it as its `allowed-failures` says. It cannot tell which of the pieces that a worker had has killed it,
    so what it gives up is tried again when nothing else is under way, one piece at a time.
    """

    shares_disk = False

    def __init__(self, address: str) -> None:
        self._address = address
        self._works: dict[distributed.Future[Any], W] = {}
        self._suspects: deque[W] = deque()
        self._alone = False

    def __enter__(self) -> Self:
        if not _ADDRESS.fullmatch(self._address):
            raise InputError(
                f"--scheduler: found {self._address}, an address such as tcp://127.0.0.1:8786 is accepted"
            )
        with ExitStack() as opened:
            # What goes wrong is said once, in our words.
            for name in [n for n in logging.root.manager.loggerDict if n.split(".")[0] == "distributed"]:
                log = logging.getLogger(name)
                opened.callback(log.setLevel, log.level)
                log.setLevel(logging.CRITICAL + 1)
            try:
                self._client = distributed.Client(self._address, timeout=_PATIENCE_S, set_as_default=False)
            except (OSError, ValueError, TypeError) as error:
                raise InputError(
                    f"--scheduler {self._address}: no Dask scheduler answers there within {_PATIENCE_S} s, "
                    "an address such as tcp://127.0.0.1:8786 is accepted"
                ) from error
            opened.callback(self._client.close)
            self._refuse_unlike_workers()
            loop = self._client.loop
            self._finished = distributed.as_completed(loop=loop)
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._works.clear()
        self._suspects.clear()
        self._opened.close()

    @property
    def room(self) -> bool:
        return len(self._works) < _AHEAD

    @property
    def busy(self) -> bool:
        return bool(self._works or self._suspects)

    def submit(self, work: W) -> None:
        self._alone = False
        self._hand_out(work)

    def _hand_out(self, work: W) -> None:
        future = self._client.submit(_on_worker, work, _decisive(), pure=False)
        self._works[future] = work
        self._finished.add(future)

    def wait(self) -> list[tuple[W, T | Failure]]:
        if not self._works:
            self._alone = True
            self._hand_out(self._suspects.popleft())
        futures = self._finished.next_batch()
        try:
            # What a worker had not yet handed over when it died is done again by another one. What cannot be
            # had is None.
            answers = self._client.gather({future.key: future for future in futures}, errors="skip")
        except OSError as error:
            raise self._went_away() from error
        return [done for future in futures for done in self._taken(future, answers[future.key])]

    def _taken(
        self, future: distributed.Future[Any], answer: tuple[T | Failure] | None
    ) -> list[tuple[W, T | Failure]]:
        """Return a piece of work with its result, nothing if it has to be tried again."""
        work = self._works.pop(future)
        if answer is not None:
            return [(work, *answer)]
        if future.status != "error":
            raise self._went_away()
        error = future.exception()
        if isinstance(error, distributed.KilledWorker) and not self._alone:
            self._suspects.append(work)
            return []
        return [(work, _failure(error))]

    def _went_away(self) -> UnfinishedError:
        return UnfinishedError(
            f"--scheduler {self._address}: it went away; what is finished is on disk, "
            "the same command goes on from there"
        )

    def _refuse_unlike_workers(self) -> None:
        """Refuse workers on which the same work could have other results."""
        for address, theirs in self._client.run(_decisive, on_error="return").items():
            if theirs != _decisive():
                raise InputError(f"--scheduler {self._address}: {_unlike(address, theirs, _decisive())}")


def _failure(error: BaseException) -> Failure:
    if isinstance(error, distributed.KilledWorker):
        return Failure(Why.LOST, (f"{error.allowed_failures + 1} workers died of it (out of memory?)",))
    return Failure(Why.BUG, (f"{type(error).__name__}: {error}",))


def _decisive() -> tuple[str, ...]:
    """What results depend on beside the work: the program, and the packages that it counts with."""
    mine = program()
    commit = f"commit {mine.git_commit}{' with changes' if mine.git_dirty else ''}"
    return (
        f"vmf {mine.version}",
        commit,
        *mine.counting,
        mine.machine,
        *_kernels(),
    )


@cache
def _kernels() -> tuple[str, ...]:
    """Return which of its kernels NumPy's BLAS has chosen for this processor: their last bits differ.

    They do not change while a process runs, and are asked for with every piece of work.
    """
    found = (info for info in threadpool_info() if "numpy" in info.get("filepath", ""))
    return tuple(sorted({f"{info.get('internal_api')} {info.get('architecture')}" for info in found}))


def _unlike(address: str, theirs: tuple[str, ...] | BaseException, ours: tuple[str, ...]) -> str:
    found = str(theirs) if isinstance(theirs, BaseException) else ", ".join(theirs)
    return f"worker {address}: found {found}; accepted is what is here: {', '.join(ours)}"


def _on_worker(work: Callable[[], T], expected: tuple[str, ...]) -> tuple[T | Failure]:
    """Do a piece of work on a worker, which may have joined after the others were looked at."""
    address = distributed.get_worker().address
    if _decisive() != expected:
        return (Failure(Why.INPUT, (_unlike(address, _decisive(), expected),)),)
    one_blas_thread()
    result = attempt(work)
    if isinstance(result, Failure):
        return (replace(result, lines=tuple(f"{line} (on worker {address})" for line in result.lines)),)
    return (result,)
