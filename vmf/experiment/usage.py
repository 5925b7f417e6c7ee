"""What work costs: time and memory."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass

_WHO = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)


@dataclass(frozen=True)
class Usage:
    """Wall time and CPU time (s), and the most memory that one process had (MiB)."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_memory_mib: float = 0.0

    def __add__(self, other: Usage) -> Usage:
        peak = max(self.peak_memory_mib, other.peak_memory_mib)
        return Usage(self.wall_s + other.wall_s, self.cpu_s + other.cpu_s, peak)


class Stopwatch:
    """Measures what this process, or this thread alone, uses from now on."""

    def __init__(self, thread_only: bool = False) -> None:
        self._thread_only = thread_only
        self._wall_s, self._cpu_s = time.perf_counter(), self._cpu()

    def read(self) -> Usage:
        """Return the usage so far."""
        most = max(resource.getrusage(who).ru_maxrss for who in _WHO)
        # Linux counts in KiB, macOS in bytes.
        peak = most / (1024**2 if sys.platform == "darwin" else 1024)
        return Usage(time.perf_counter() - self._wall_s, self._cpu() - self._cpu_s, peak)

    def _cpu(self) -> float:
        if self._thread_only:
            return time.thread_time()
        usage = [resource.getrusage(who) for who in _WHO]
        return sum(u.ru_utime + u.ru_stime for u in usage)
