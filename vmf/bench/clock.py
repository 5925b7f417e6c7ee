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
Clock = Callable[[], float]

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


def once(work: Callable[[], Any], clock: Clock = process_time) -> tuple[float, Any]:
    """Return the processor's seconds that work in this process takes, or another clock's; and its result."""
    with undisturbed():
        begin = clock()
        result = work()
        return clock() - begin, result


def in_turns(
    candidates: Mapping[str, Callable[[], Any]], repeats: int, clock: Clock = process_time
) -> dict[str, Times]:
    """Return the times of candidates that take turns, after one round that does not count.

    Work that is too short to be measured is repeated within a turn; the times are those of one piece of it.
    `clock` is the processor's unless what counts is how long threads take together.
    """
    rounds = {}
    for name, work in candidates.items():
        work()
        seconds, _ = once(work, clock)
        rounds[name] = max(1, int(np.ceil(_LEAST_S / max(seconds, 1e-9))))
    seconds_of: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(repeats):
        for name, work in candidates.items():
            with undisturbed():
                begin = clock()
                for _ in range(rounds[name]):
                    work()
                seconds_of[name].append((clock() - begin) / rounds[name])
    return {name: Times(np.array(seconds)) for name, seconds in seconds_of.items()}
