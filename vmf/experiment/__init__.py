"""Experiments: from a spec to a run directory."""

from vmf.experiment.evaluate import evaluate
from vmf.experiment.run import Progress, RunOptions, RunResult, run_experiment
from vmf.experiment.simulated import write_simulation
from vmf.experiment.solve_views import solve_views
from vmf.experiment.study import StudyRun, run_study
from vmf.experiment.sweep import SweepOptions, SweepResult, sweep
from vmf.experiment.views import Sources

__all__ = [
    "Progress",
    "RunOptions",
    "RunResult",
    "Sources",
    "StudyRun",
    "SweepOptions",
    "SweepResult",
    "evaluate",
    "run_experiment",
    "run_study",
    "solve_views",
    "sweep",
    "write_simulation",
]
