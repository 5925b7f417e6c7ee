"""Performance figures of this machine, each a ratio against an alternative measured in the same run."""

from vmf.bench.figure import Effort, Figure, Reading, Row
from vmf.bench.registry import FIGURES
from vmf.bench.report import Report, as_text, to_json, writable, write
from vmf.bench.run import run

__all__ = [
    "FIGURES",
    "Effort",
    "Figure",
    "Reading",
    "Report",
    "Row",
    "as_text",
    "run",
    "to_json",
    "writable",
    "write",
]
