"""One motion from one pair of views (§3.2)."""

from vmf.solve.costs import COSTS
from vmf.solve.query import Query, ask
from vmf.solve.solution import Solution, Solutions, StopReason, command
from vmf.solve.solver import SolverOptions, solve

__all__ = [
    "COSTS",
    "Query",
    "Solution",
    "Solutions",
    "SolverOptions",
    "StopReason",
    "ask",
    "command",
    "solve",
]
