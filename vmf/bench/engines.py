"""The thesis experiment, its own way and faster ones: one target, all updates, a code after each frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtrtrs

from vmf.approximate import Lookup, Tiling
from vmf.bench.blocked import Blocked
from vmf.bench.clock import Times, once
from vmf.bench.figure import Effort, Figure, Row, faster, growth
from vmf.bench.literal import ThesisWay
from vmf.data import Tracks
from vmf.data.simulate import simulate, trial_streams
from vmf.estimate import in_gauge, update_rank_k
from vmf.learn import CompressedPipeline
from vmf.learn.pipeline import Readout
from vmf.spec import loads
from vmf.tasks import Task, make_task

Floats = NDArray[np.float64]

# An alternative goes on to the next size if it should end within this.
_PATIENCE_S = 60.0
_REPEATS = 3
# Runs shorter than this are repeated.
_SHORT_S = 5.0

_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: 1, seed: 1}}
"""


class Engine(Protocol):
    """An alternative: takes in observations, and has the factors of the first code's tiles."""

    def observe(self, E: Floats, code: Floats) -> None:
        """Take in one observation."""

    def finish(self) -> None:
        """Make up for updates that were postponed."""

    def factors(self) -> Floats:
        """Return the factors (T, 2, 3k+3, 3k+3)."""


@dataclass
class Runs:
    """How long a way took at each size, and what it found for the trained code, by read-out."""

    name: str
    seconds: dict[int, list[float]] = field(default_factory=dict)
    found: dict[tuple[int, Readout], Floats] = field(default_factory=dict)

    def times(self, size: int) -> Times:
        """Return the times measured at a size."""
        return Times(np.array(self.seconds[size]))

    @property
    def law(self) -> tuple[float, float]:
        """Factor and exponent of seconds against size, by least squares on logarithms."""
        sizes = sorted(self.seconds)
        exponent, logarithm = np.polyfit(
            np.log(sizes), [np.log(np.median(self.seconds[n])) for n in sizes], 1
        )
        return float(np.exp(logarithm)), float(exponent)

    def expected(self, size: int) -> float:
        """Return the seconds that the law gives for a size."""
        factor, exponent = self.law
        return float(factor * float(size) ** exponent)


@dataclass(frozen=True)
class _Experiment:
    task: Task
    tiling: Tiling
    frames: list[Tracks]

    def compressed(self, size: int, readout: Readout) -> Floats:
        learner = CompressedPipeline(self.task, self.tiling, Lookup, readout=readout, min_support=0.0)
        code = self.frames[0].pixels
        for frame in self.frames[:size]:
            learner.partial_fit(frame)
            rows = learner.parameters(code).rows
        return np.asarray(rows[0])

    def pairwise(self, engine: Engine, size: int) -> Floats:
        for frame in self.frames[:size]:
            engine.observe(frame.E_S_from_W[0], frame.pixels[0])
            pooled(engine.factors())
        engine.finish()
        return engine.factors()


def pooled(factors: Floats) -> Floats:
    """Return the parameters (2, 3, k+1) of the stacked factors (T, 2, 3k+3, 3k+3) of a code's tiles."""
    n = factors.shape[-1]
    R = update_rank_k(np.zeros((2, n, n)), factors.swapaxes(0, 1).reshape(2, -1, n))
    return np.array([_substituted(factor) for factor in R])


def mean(factors: Floats, task: Task) -> Floats:
    """Return the mean of the tiles' own parameters, in the unit-depth gauge."""
    each = np.array([[_substituted(factor) for factor in tile] for tile in factors])
    return np.asarray(in_gauge(each, "unit_depth", task.identity_lift).mean(axis=0))


def _substituted(R: Floats) -> Floats:
    theta, singular = dtrtrs(R[:-1, :-1], R[:-1, -1])
    theta = np.full(len(theta), np.nan) if singular else theta
    return np.append(theta, 1.0).reshape(3, -1)


def figure(effort: Effort) -> Figure:
    """Measure the compressed engine against pair-by-pair engines, and how each grows with N."""
    sizes = (24, 36, 48, 96) if effort.quick else (125, 250, 500, 1000, 2000)
    tiling = Tiling(overlays=4 if effort.quick else 32)
    patience = 0.0 if effort.quick else _PATIENCE_S
    experiment = _experiment(sizes[-1], tiling)
    ours: dict[Readout, Runs] = {
        "pooled": Runs("compressed, tiles pooled"),
        "mean": Runs("compressed, mean of the tiles"),
    }
    alternatives: Mapping[str, Callable[[], Engine]] = {
        "thesis's own way (a dgeqrf per tile update)": lambda: ThesisWay(experiment.task, tiling),
        "sequential at its best (blocked)": lambda: Blocked(experiment.task, tiling, shared=False),
        "the same, tiles sharing their centres' factors": lambda: Blocked(
            experiment.task, tiling, shared=True
        ),
    }
    others = {name: Runs(name) for name in alternatives}
    # Sizes take turns too: their growth is of interest.
    for _ in range(_REPEATS):
        for size in sizes:
            for readout, runs in ours.items():
                _compressed(runs, size, experiment, readout)
    for number, size in enumerate(sizes):
        for name, make in alternatives.items():
            runs = others[name]
            if number < 3 or runs.expected(size) <= patience:
                _alternative(runs, size, experiment, make)
    return Figure(
        "engines",
        f"all updates of one 6-DOF target on {tiling.overlays} overlays, and the trained code's parameters "
        "after every frame",
        tuple(_rows(sizes, ours, list(others.values()))),
    )


def _experiment(frames: int, tiling: Tiling) -> _Experiment:
    spec = loads(_SPEC.format(frames=frames), "bench").spec
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    return _Experiment(make_task("six_dof"), tiling, [tracks.select_frames(i, i + 1) for i in range(frames)])


def _compressed(runs: Runs, size: int, experiment: _Experiment, readout: Readout) -> None:
    seconds, runs.found[size, readout] = once(lambda: experiment.compressed(size, readout))
    runs.seconds.setdefault(size, []).append(seconds)


def _alternative(runs: Runs, size: int, experiment: _Experiment, make: Callable[[], Engine]) -> None:
    total = 0.0
    while total == 0.0 or (total < _SHORT_S and len(runs.seconds[size]) < _REPEATS):
        seconds, factors = once(partial(experiment.pairwise, make(), size))
        runs.seconds.setdefault(size, []).append(seconds)
        total += seconds
    runs.found[size, "pooled"] = in_gauge(pooled(factors), "unit_depth", experiment.task.identity_lift)
    runs.found[size, "mean"] = mean(factors, experiment.task)


def _rows(sizes: tuple[int, ...], ours: Mapping[Readout, Runs], others: list[Runs]) -> list[Row]:
    rows = []
    for other in others:
        for readout, mine in ours.items():
            # The other read-out tells nothing new at every size.
            shown = sizes if readout == "pooled" else sizes[-1:]
            rows += [_ratio(size, readout, mine, other) for size in shown]
            rows.append(
                growth(
                    f"N = {sizes[0]} to {sizes[-1]}",
                    (mine.name, mine.law[1]),
                    (other.name, other.law[1]),
                    "",
                    "exponents of N; the alternative's from "
                    f"N = {min(other.seconds)} to {max(other.seconds)}",
                )
            )
    return rows


def _ratio(size: int, readout: Readout, mine: Runs, other: Runs) -> Row:
    measured = size in other.seconds
    if measured:
        gap = _gap(mine.found[size, readout], other.found[size, readout])
        times, note = other.times(size), f"parameters equal to {gap:.0e}"
    else:
        times = Times(np.array([other.expected(size)]))
        last = max(other.seconds)
        gap = _gap(mine.found[last, readout], other.found[last, readout])
        note = f"from N = {last} by its exponent {other.law[1]:.2f}; there equal to {gap:.0e}"
    ours = (mine.name, mine.times(size))
    return faster(f"N = {size}", ours, (other.name, times), note, extrapolated=not measured)


def _gap(one: Floats, other: Floats) -> float:
    return float((np.linalg.norm(one - other, axis=-1) / np.linalg.norm(other, axis=-1)).max())
