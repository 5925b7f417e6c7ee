"""Trials on two cores against one."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from vmf.bench.clock import Times
from vmf.bench.figure import Effort, Figure, faster
from vmf.experiment.parallel import Crew, Failure, crew, run_all
from vmf.experiment.trial import Outcome, simulated_trial
from vmf.spec import Spec, loads

Floats = NDArray[np.float64]

_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: 6, seed: 1}}
learner: {{kind: transport}}
evaluate: {{trials: {trials}, queries: {queries}, curve_points: {points}}}
"""


@dataclass(frozen=True)
class Piece:
    """One trial as a piece of work."""

    spec: Spec
    number: int

    def __call__(self) -> Outcome:
        """Run the trial, without rivals and without a model on disk."""
        return simulated_trial(self.spec, self.number, with_rivals=False)


def results(spec: Spec, jobs: int) -> list[Floats]:
    """Return what the trials of an experiment found, with so many workers."""
    pieces = [Piece(spec, number) for number in range(spec.evaluate.trials)]
    found = {}
    workers: Crew[Piece, Outcome] = crew(jobs, len(pieces))
    with workers:
        for piece, outcome in run_all(workers, pieces):
            if isinstance(outcome, Failure):
                raise outcome.error()
            found[piece.number] = outcome.errors["estimate"].to_numpy(float)
    return [found[piece.number] for piece in pieces]


def figure(effort: Effort) -> Figure:
    """Measure the trials of an experiment with one worker and with two."""
    trials, frames, queries, points = (2, 30, 4, 2) if effort.quick else (64, 1000, 60, 20)
    spec = loads(_SPEC.format(frames=frames, trials=trials, queries=queries, points=points), "bench").spec
    seconds: dict[int, list[float]] = {1: [], 2: []}
    found = {}
    for _ in range(1 if effort.quick else 2):
        for jobs in (1, 2):
            begin = perf_counter()
            found[jobs] = results(spec, jobs)
            seconds[jobs].append(perf_counter() - begin)
    same = all(np.array_equal(a, b, equal_nan=True) for a, b in zip(found[1], found[2], strict=True))
    row = faster(
        f"{trials} trials",
        ("two workers", Times(np.array(seconds[2]))),
        ("one", Times(np.array(seconds[1]))),
        "results equal bit for bit, start of the workers included" if same else "RESULTS DIFFER",
    )
    return Figure(
        "cores", "trials of an experiment by the wall clock, each worker with one BLAS thread", (row,)
    )
