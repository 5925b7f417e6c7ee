"""All figures by name, in the order in which they are measured."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from vmf.bench import codes, cores, engines, hot_loops, memory, motions, online, recordings, tracking, updates
from vmf.bench.figure import Effort, Figure

FIGURES: Mapping[str, Callable[[Effort], Figure]] = MappingProxyType(
    {
        "engines": engines.figure,
        "motions": motions.figure,
        "updates": updates.figure,
        "codes": codes.figure,
        "recordings": recordings.figure,
        "tracking": tracking.figure,
        "hot_loops": hot_loops.figure,
        "online": online.figure,
        "cores": cores.figure,
        "memory": memory.figure,
    }
)
