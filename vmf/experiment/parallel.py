"""Trials on several cores, each with one BLAS thread, in any order with the same results."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from threadpoolctl import threadpool_limits

T = TypeVar("T")

# A worker that was killed takes its trial with it; the trial is done anew this often.
_ATTEMPTS = 3


def one_blas_thread() -> None:
    """Limit this process to one BLAS thread: more are slower here and change the last bits."""
    threadpool_limits(1)


def run_all(work: Callable[[int], T], numbers: Iterable[int], jobs: int) -> Iterator[tuple[int, T]]:
    """Yield `(number, work(number))` as they finish.

    Parameters
    ----------
    work : a picklable function.
    numbers : its arguments.
    jobs : processes to use; 1 works in this one.

    Raises
    ------
    BrokenProcessPool : workers died time and again.
    """
    todo = list(numbers)
    if jobs <= 1 or len(todo) <= 1:
        with threadpool_limits(1):
            for number in todo:
                yield number, work(number)
        return
    for attempt in range(_ATTEMPTS):
        done: set[int] = set()
        try:
            for number, result in _pool(work, todo, min(jobs, len(todo))):
                done.add(number)
                yield number, result
            return
        except BrokenProcessPool:
            todo = [number for number in todo if number not in done]
            if attempt == _ATTEMPTS - 1:
                raise


def _pool(work: Callable[[int], T], numbers: list[int], jobs: int) -> Iterator[tuple[int, T]]:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, initializer=one_blas_thread) as pool:
        waiting = {pool.submit(work, number): number for number in numbers}
        try:
            while waiting:
                finished, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield waiting.pop(future), future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
