"""Experiments: from a spec to a run directory."""

from vmf.experiment.evaluate import evaluate
from vmf.experiment.run import Progress, RunOptions, RunResult, run_experiment
from vmf.experiment.simulated import write_simulation

__all__ = ["Progress", "RunOptions", "RunResult", "evaluate", "run_experiment", "write_simulation"]
