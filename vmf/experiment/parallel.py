"""Work on several cores, each with one BLAS thread, in any order with the same results."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from functools import cache
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from threadpoolctl import threadpool_limits

from vmf.errors import InputError, UnfinishedError

W = TypeVar("W", bound=Callable[[], Any])
T = TypeVar("T")

# A worker that dies takes its work with it. The work is done anew, alone, until as many workers have died
# of it: then it is the work that kills them.
DEATHS = 3
# Pieces handed out beyond one per worker, so that no worker waits for the next one.
_AHEAD = 2


class Why(Enum):
    """What kept work from being done."""

    INPUT = "the input is wrong"
    LOST = "the worker died"
    BUG = "an error in the program"


@dataclass(frozen=True)
class Failure:
    """Work that could not be done.

    Attributes
    ----------
    why : the sort of failure.
    lines : the reason in words.
    trace : where in the program, empty unless it is a bug.
    """

    why: Why
    lines: tuple[str, ...]
    trace: str = ""

    def __str__(self) -> str:
        return "; ".join(self.lines)

    def error(self) -> Exception:
        """Return the exception that says the same."""
        if self.why is Why.INPUT:
            return InputError(*self.lines)
        return UnfinishedError(*self.lines) if self.why is Why.LOST else RuntimeError(self.trace or str(self))


class Crew(Protocol[W, T]):
    """Workers: they take pieces of work while there is room and hand them back when done."""

    shares_disk: bool

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    @property
    def room(self) -> bool:
        """Whether another piece may be submitted."""
        ...

    @property
    def busy(self) -> bool:
        """Whether submitted pieces have not come back."""
        ...

    def submit(self, work: W) -> None:
        """Hand out a picklable piece of work."""
        ...

    def wait(self) -> list[tuple[W, T | Failure]]:
        """Return some pieces that are done, one at least; only when busy."""
        ...


def crew(jobs: int, pieces: int) -> Crew[W, T]:
    """Return a crew for so many pieces of work: this process alone, or as many processes as are of use."""
    if jobs <= 1 or pieces <= 1:
        return Alone[W, T]()
    return Pool[W, T](min(jobs, pieces))


def run_all(workers: Crew[W, T], works: Iterable[W]) -> Iterator[tuple[W, T | Failure]]:
    """Yield each piece of work with its result, as they are done."""
    todo = iter(works)
    more = True
    while more or workers.busy:
        while more and workers.room:
            work = next(todo, None)
            more = work is not None
            if work is not None:
                workers.submit(work)
        if workers.busy:
            yield from workers.wait()


def attempt(work: Callable[[], T]) -> T | Failure:
    """Do a piece of work, or say why it could not be done."""
    try:
        return work()
    except InputError as error:
        return Failure(Why.INPUT, error.lines)
    except Exception as error:
        return Failure(Why.BUG, (f"{type(error).__name__}: {error}",), traceback.format_exc())


@cache
def one_blas_thread() -> None:
    """Limit this process to one BLAS thread: more are slower here and change the last bits."""
    threadpool_limits(1)


class Alone(Generic[W, T]):
    """Nobody but this process, one piece after the other."""

    shares_disk = True

    def __init__(self) -> None:
        self._next: list[W] = []

    def __enter__(self) -> Self:
        self._limits = threadpool_limits(1)
        return self

    def __exit__(self, *_: object) -> None:
        self._limits.restore_original_limits()

    @property
    def room(self) -> bool:
        return not self._next

    @property
    def busy(self) -> bool:
        return bool(self._next)

    def submit(self, work: W) -> None:
        self._next.append(work)

    def wait(self) -> list[tuple[W, T | Failure]]:
        work = self._next.pop()
        return [(work, attempt(work))]


@dataclass
class _Piece(Generic[W]):
    work: W
    deaths: int = 0


class Pool(Generic[W, T]):
    """Processes of this machine, which end with this one however it ends.

    A worker that dies breaks the whole pool, and which piece it was at is not known. A new pool does all
    pieces that were under way once more, one at a time, so that one that kills its worker is told from those
    that were under way beside it.
    """

    shares_disk = True

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._waiting: dict[Future[T | Failure], _Piece[W]] = {}
        self._suspects: deque[_Piece[W]] = deque()

    def __enter__(self) -> Self:
        self._open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._close(at_once=kind is not None)

    @property
    def room(self) -> bool:
        return not self._suspects and len(self._waiting) < self._jobs + _AHEAD

    @property
    def busy(self) -> bool:
        return bool(self._waiting or self._suspects)

    def submit(self, work: W) -> None:
        self._start(_Piece(work))

    def wait(self) -> list[tuple[W, T | Failure]]:
        while True:
            if not self._waiting:
                self._start(self._suspects.popleft())
            alone = len(self._waiting) == 1
            finished, _ = wait(self._waiting, return_when=FIRST_COMPLETED)
            done, lost = self._collected(finished)
            if lost:
                # All others come back now, most of them lost too.
                finished, _ = wait(self._waiting)
                more, others = self._collected(finished)
                done, lost = done + more, lost + others
                self._close(at_once=True)
                self._open()
                for piece in lost:
                    piece.deaths += alone
                done += [(p.work, _killed(p.deaths)) for p in lost if p.deaths >= DEATHS]
                self._suspects.extend(p for p in lost if p.deaths < DEATHS)
            if done:
                return done

    def _collected(
        self, finished: Iterable[Future[T | Failure]]
    ) -> tuple[list[tuple[W, T | Failure]], list[_Piece[W]]]:
        done: list[tuple[W, T | Failure]] = []
        lost = []
        for future in finished:
            piece = self._waiting.pop(future)
            try:
                done.append((piece.work, future.result()))
            except BrokenProcessPool:
                lost.append(piece)
        return done, lost

    def _start(self, piece: _Piece[W]) -> None:
        try:
            with _interrupts_held_back():
                future = self._pool.submit(attempt, piece.work)
        except BrokenProcessPool:
            # Nobody knows yet but the pool: the pieces under way will tell.
            future = Future()
            future.set_exception(BrokenProcessPool())
        self._waiting[future] = piece

    def _open(self) -> None:
        context = multiprocessing.get_context("spawn")
        ours, self._lifeline = context.Pipe(duplex=False)
        self._pool = ProcessPoolExecutor(self._jobs, context, initializer=_begin, initargs=(ours,))

    def _close(self, at_once: bool) -> None:
        if at_once:
            self._lifeline.close()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._lifeline.close()


def _killed(times: int) -> Failure:
    return Failure(Why.LOST, (f"its worker process was killed {times} times (out of memory?)",))


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Start processes that never hear of Ctrl-C: it is this one's to say what becomes of them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(lifeline: Connection) -> None:
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    one_blas_thread()


def _end_with(lifeline: Connection) -> None:
    """End this process when the other end of the lifeline is closed, as the kernel does for the dead."""
    lifeline.poll(None)
    os._exit(1)
