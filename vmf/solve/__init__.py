"""One motion from one pair of views (§3.2)."""

from vmf.data.query import Query
from vmf.solve.ask import ask
from vmf.solve.costs import COSTS
from vmf.solve.solution import Solution, Solutions, StopReason, command, concatenate
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
    "concatenate",
    "solve",
]
