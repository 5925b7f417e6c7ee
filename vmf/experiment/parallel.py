"""Work on several cores, each with one BLAS thread, in any order with the same results."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from functools import cache
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar, cast

from threadpoolctl import threadpool_limits

from vmf.errors import InputError, UnfinishedError

W = TypeVar("W", bound=Callable[[], Any])
T = TypeVar("T")

# A worker that dies takes its work with it. The work is done anew until as many workers have died of it:
# then it is the work that kills them.
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


@dataclass
class _Worker(Generic[W]):
    """A process, our end of its pipe, and the piece it is at."""

    process: BaseProcess
    pipe: Connection
    piece: _Piece[W] | None = None


class Pool(Generic[W, T]):
    """Processes of this machine, which end with this one however it ends.

    Each has a pipe of its own: what it was at when it was killed is known, and half an answer ends with its
    pipe. Where all answers go through one pipe, as in `concurrent.futures`, the rest waits behind that half.
    """

    shares_disk = True

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._todo: deque[_Piece[W]] = deque()
        self._workers: list[_Worker[W]] = []
        self._context = multiprocessing.get_context("spawn")

    def __enter__(self) -> Self:
        # Python's helper of its processes unblocks interrupts when it starts: not while they are held back.
        resource_tracker.ensure_running()
        self._theirs, self._lifeline = self._context.Pipe(duplex=False)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for worker in self._workers:
            if kind is not None:
                worker.process.kill()
            worker.pipe.close()
        for worker in self._workers:
            worker.process.join()
        self._workers.clear()
        self._lifeline.close()
        self._theirs.close()

    @property
    def _under_way(self) -> list[_Worker[W]]:
        return [worker for worker in self._workers if worker.piece is not None]

    @property
    def room(self) -> bool:
        return len(self._todo) + len(self._under_way) < self._jobs + _AHEAD

    @property
    def busy(self) -> bool:
        return bool(self._todo or self._under_way)

    def submit(self, work: W) -> None:
        self._todo.append(_Piece(work))
        self._hand_out()

    def wait(self) -> list[tuple[W, T | Failure]]:
        done: list[tuple[W, T | Failure]] = []
        while not done:
            at = {worker.pipe: worker for worker in self._under_way}
            for pipe in wait(list(at)):
                done += self._answer(at[cast(Connection, pipe)])
            self._hand_out()
        return done

    def _answer(self, worker: _Worker[W]) -> list[tuple[W, T | Failure]]:
        piece, worker.piece = worker.piece, None
        assert piece is not None
        try:
            return [(piece.work, worker.pipe.recv())]
        except (EOFError, OSError):
            self._bury(worker)
        piece.deaths += 1
        if piece.deaths == DEATHS:
            return [(piece.work, _killed(piece.deaths))]
        self._todo.appendleft(piece)
        return []

    def _hand_out(self) -> None:
        while self._todo:
            idle = next((worker for worker in self._workers if worker.piece is None), None)
            if idle is None and len(self._workers) == self._jobs:
                return
            worker = idle or self._hire()
            try:
                worker.pipe.send(self._todo[0].work)
            except OSError:
                # It was killed while it had nothing to do.
                self._bury(worker)
            else:
                worker.piece = self._todo.popleft()

    def _hire(self) -> _Worker[W]:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs, self._theirs), daemon=True)
        worker: _Worker[W] = _Worker(process, ours)
        with _interrupts_held_back(), theirs:
            process.start()
            self._workers.append(worker)
        return worker

    def _bury(self, worker: _Worker[W]) -> None:
        self._workers.remove(worker)
        worker.process.kill()
        worker.pipe.close()
        worker.process.join()


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


def _serve(pipe: Connection, lifeline: Connection) -> None:
    """Do what comes through the pipe until it is closed."""
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()
    one_blas_thread()
    with suppress(EOFError, OSError):
        while True:
            pipe.send(attempt(pipe.recv()))


def _end_with(lifeline: Connection) -> None:
    """End this process when the other end of the lifeline is closed, as the kernel does for the dead."""
    lifeline.poll(None)
    os._exit(1)
