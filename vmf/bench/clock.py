"""Taking times in turns, so that whatever disturbs the machine disturbs all candidates alike.

Times are the processor's, which others who use the machine lengthen less than they do the wall clock's. On a
machine that nobody else uses both are the same, but for work in several processes.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# A measurement shorter than this says more about the clock and the caches than about the work.
_LEAST_S = 0.02


@dataclass(frozen=True)
class Times:
    """Seconds (n,) that one piece of work took, in n repeats."""

    seconds: Floats

    @property
    def median(self) -> float:
        """The median in seconds."""
        return float(np.median(self.seconds))


@contextmanager
def undisturbed() -> Iterator[None]:
    """Keep the garbage collector out of what is measured."""
    gc.collect()
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def once(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor's seconds that work in this process takes, and what it returns."""
    with undisturbed():
        begin = process_time()
        result = work()
        return process_time() - begin, result


def in_turns(candidates: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, Times]:
    """Return the times of candidates that take turns, after one round that does not count.

    Work that is too short to be measured is repeated within a turn; the times are those of one piece of it.
    """
    rounds = {}
    for name, work in candidates.items():
        work()
        seconds, _ = once(work)
        rounds[name] = max(1, int(np.ceil(_LEAST_S / max(seconds, 1e-9))))
    seconds_of: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(repeats):
        for name, work in candidates.items():
            with undisturbed():
                begin = process_time()
                for _ in range(rounds[name]):
                    work()
                seconds_of[name].append((process_time() - begin) / rounds[name])
    return {name: Times(np.array(seconds)) for name, seconds in seconds_of.items()}
