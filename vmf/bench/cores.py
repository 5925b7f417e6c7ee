"""Trials on two cores against one."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from vmf.bench.clock import Times, once
from vmf.bench.figure import Effort, Figure, faster
from vmf.experiment.parallel import run_all
from vmf.experiment.trial import Outcome, simulated_trial
from vmf.spec import Spec, loads

_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: 6, seed: 1}}
learner: {{kind: transport}}
evaluate: {{queries: {queries}, curve_points: {points}}}
"""


def trial(spec: Spec, number: int) -> Outcome:
    """Run one trial of the experiment, without rivals and without a model on disk."""
    return simulated_trial(spec, number, with_rivals=False)


def _all(work: Callable[[int], Outcome], trials: int, jobs: int) -> dict[int, Outcome]:
    return dict(run_all(work, range(trials), jobs))


def figure(effort: Effort) -> Figure:
    """Measure the trials of an experiment with one worker and with two."""
    trials, frames, queries, points = (2, 30, 4, 2) if effort.quick else (16, 1000, 60, 20)
    text = _SPEC.format(frames=frames, queries=queries, points=points)
    work = partial(trial, loads(text, "bench").spec)
    seconds: dict[int, list[float]] = {1: [], 2: []}
    found = {}
    for _ in range(1 if effort.quick else 3):
        for jobs in (1, 2):
            taken, results = once(partial(_all, work, trials, jobs))
            seconds[jobs].append(taken)
            found[jobs] = [results[i].errors["estimate"].to_numpy() for i in range(trials)]
    same = all(np.array_equal(a, b, equal_nan=True) for a, b in zip(found[1], found[2], strict=True))
    row = faster(
        f"{trials} trials",
        ("two workers", Times(np.array(seconds[2]))),
        ("one", Times(np.array(seconds[1]))),
        "results equal bit for bit, start of the workers included" if same else "RESULTS DIFFER",
    )
    return Figure("cores", "trials of an experiment, each worker with one BLAS thread", (row,))
