"""One motion from one pair of views (§3.2)."""

from vmf.data.query import Query
from vmf.solve.ask import ask, ask_known, ask_most_likely
from vmf.solve.costs import COSTS
from vmf.solve.function_views import Function
from vmf.solve.lifted_views import LiftedViews, by_row, views
from vmf.solve.maximum_likelihood import drafted, most_likely
from vmf.solve.outcome import Draft, refusals
from vmf.solve.solution import Solution, Solutions, StopReason, command, concatenate
from vmf.solve.solver import SolverOptions, solve
from vmf.solve.two_view import TwoViews
from vmf.solve.unknowns import Unknowns, moved

__all__ = [
    "COSTS",
    "Draft",
    "Function",
    "LiftedViews",
    "Query",
    "Solution",
    "Solutions",
    "SolverOptions",
    "StopReason",
    "TwoViews",
    "Unknowns",
    "ask",
    "ask_known",
    "ask_most_likely",
    "by_row",
    "command",
    "concatenate",
    "drafted",
    "most_likely",
    "moved",
    "refusals",
    "solve",
    "views",
]
