"""On-line use: learn from a frame, answer, and be ready before the next frame comes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from vmf.bench.clock import Times, once
from vmf.bench.figure import Effort, Figure, Row, faster, share
from vmf.data import Query, Tracks
from vmf.data.simulate import simulate, trial_streams
from vmf.experiment.asking import answer
from vmf.experiment.build import build_learner
from vmf.learn import Learner
from vmf.solve import Solutions
from vmf.spec import Spec, loads

Floats = NDArray[np.float64]

_RATE_HZ = 30.0
_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: {targets}, motion: hand_guided, seed: 1}}
"""
_PIPELINE = "learner: {{kind: pipeline, readout: {}}}\napproximator: {{kind: {}}}\n"
_LEARNERS = {
    "structured learner": "",
    "compressed pipeline, visited codes": _PIPELINE.format("mean", "none"),
    "compressed pipeline, tiles pooled": _PIPELINE.format("pooled", "cmac"),
    "compressed pipeline, mean of the tiles": _PIPELINE.format("mean", "cmac"),
}
# Frames come to an end when this much time is gone, however many are left.
_PATIENCE_S, _QUICK_PATIENCE_S = 30.0, 0.5


@dataclass(frozen=True)
class _Stream:
    """Frames as they come, and the question after each: from the first view to the newest."""

    tracks: Tracks
    pixels: Floats
    patience_s: float

    def frame(self, i: int) -> Tracks:
        return self.tracks.select_frames(i, i + 1)

    def question(self, i: int) -> Query:
        E = self.tracks.E_S_from_W
        return Query(self.pixels[:1], self.pixels[i : i + 1], E[:1], E[i : i + 1])


def figure(effort: Effort) -> Figure:
    """Measure the delay of each of many frames, solving after each, of several learners."""
    targets, first, frames = (6, 60, 64) if effort.quick else (100, 60, 360)
    text = _SPEC.format(frames=frames, targets=targets)
    spec = loads(text, "bench").spec
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    pixels = np.full((frames, targets, 4), np.nan)
    pixels[tracks.frame, tracks.target] = tracks.pixels
    stream = _Stream(tracks, pixels, _QUICK_PATIENCE_S if effort.quick else _PATIENCE_S)
    rows = []
    for name, more in _LEARNERS.items():
        rows += _rows(name, loads(text + more, "bench").spec, stream, first)
    title = f"on-line at {_RATE_HZ:.0f} Hz on one core, a motion after every frame"
    return Figure("online", title, tuple(rows))


def _rows(name: str, spec: Spec, stream: _Stream, first: int) -> list[Row]:
    learner = build_learner(spec)
    starts, _ = _delays(spec, learner, stream, range(first))
    # What was not looked at for lack of patience is learned before the robot goes on.
    learner.partial_fit(stream.tracks.select_frames(len(starts), first))
    answer(spec, learner, stream.question(first - 1))
    delays, solved = _delays(spec, learner, stream, range(first, stream.tracks.n_frames))
    seen = first + len(delays)
    anew = [once(partial(_anew, spec, stream, seen))[0] for _ in range(3)]
    period = 1.0 / _RATE_HZ
    case = f"{stream.tracks.n_targets} targets, frames {first + 1} to {seen}"
    note = f"{solved} of {len(delays)} motions solved"
    rows = [
        share(case, (f"{name}: {of} delay", value), (f"a frame's {1e3 * period:.1f} ms", period), "s", note)
        for of, value in (
            ("median", float(np.median(delays))),
            ("99th percentile", float(np.quantile(delays, 0.99))),
            ("longest", max(delays)),
        )
    ]
    rows.append(
        share(
            f"{stream.tracks.n_targets} targets, frames 1 to {len(starts)}",
            (f"{name}: longest delay while nothing is known yet", max(starts)),
            (f"a frame's {1e3 * period:.1f} ms", period),
            "s",
            "an answer is asked for after each",
        )
    )
    ours = (f"{name}: a frame more, and an answer", Times(np.array(delays)))
    return [*rows, faster(case, ours, ("learning anew from all of them", Times(np.array(anew))), note)]


def _delays(spec: Spec, learner: Learner, stream: _Stream, frames: range) -> tuple[list[float], int]:
    """Return the delays of frames with a question after each, and how many were answered with a motion."""
    delays, solved = [], 0
    begin = perf_counter()
    for i in frames:
        seconds, solution = once(partial(_step, spec, learner, stream, i))
        delays.append(seconds)
        solved += int(solution[0].converged)
        if perf_counter() - begin > stream.patience_s:
            break
    return delays, solved


def _step(spec: Spec, learner: Learner, stream: _Stream, i: int) -> Solutions:
    learner.partial_fit(stream.frame(i))
    return answer(spec, learner, stream.question(i))


def _anew(spec: Spec, stream: _Stream, frames: int) -> Solutions:
    learner = build_learner(spec)
    learner.partial_fit(stream.tracks.select_frames(0, frames))
    return answer(spec, learner, stream.question(frames - 1))
