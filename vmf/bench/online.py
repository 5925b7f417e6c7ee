"""On-line use: learn from a frame, answer, and be ready before the next frame comes."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from vmf.bench.clock import Times, undisturbed
from vmf.bench.figure import Effort, Figure, Row, faster, share
from vmf.data import Query
from vmf.data.simulate import simulate, trial_streams
from vmf.experiment.asking import answer
from vmf.experiment.build import build_learner
from vmf.spec import loads

_RATE_HZ = 30.0
_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: {targets}, motion: hand_guided, seed: 1}}
"""
# Frames come to an end when this much time is gone, however many are left.
_PATIENCE_S = 45.0


def figure(effort: Effort) -> Figure:
    """Measure the delay of each of many frames, solving after each, with the default learner."""
    targets, first, frames = (6, 60, 64) if effort.quick else (100, 60, 360)
    spec = loads(_SPEC.format(frames=frames, targets=targets), "bench").spec
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    pixels = np.full((frames, targets, 4), np.nan)
    pixels[tracks.frame, tracks.target] = tracks.pixels
    blocks = [tracks.select_frames(i, i + 1) for i in range(first, frames)]
    learner = build_learner(spec)
    learner.partial_fit(tracks.select_frames(0, first))
    delays, solved = [], 0
    with undisturbed():
        begin = perf_counter()
        for i, block in enumerate(blocks, start=first):
            query = Query(pixels[:1], pixels[i : i + 1], tracks.E_S_from_W[:1], tracks.E_S_from_W[i : i + 1])
            came = perf_counter()
            learner.partial_fit(block)
            solution = answer(spec, learner, query)
            delays.append(perf_counter() - came)
            solved += int(solution[0].converged)
            if perf_counter() - begin > _PATIENCE_S:
                break
    seen = first + len(delays)
    anew = []
    for _ in range(3):
        came = perf_counter()
        fresh = build_learner(spec)
        fresh.partial_fit(tracks.select_frames(0, seen))
        answer(spec, fresh, query)
        anew.append(perf_counter() - came)
    period = 1.0 / _RATE_HZ
    case = f"{targets} targets, frames {first + 1} to {seen}"
    note = f"{solved} of {len(delays)} motions solved"
    rows: list[Row] = [
        share(case, (f"delay, {name}", value), (f"a frame's {1e3 * period:.1f} ms", period), "s", note)
        for name, value in (
            ("median", float(np.median(delays))),
            ("99th percentile", float(np.quantile(delays, 0.99))),
        )
    ]
    rows.append(
        faster(
            case,
            ("a frame more, and an answer", Times(np.array(delays))),
            ("learning anew from all of them", Times(np.array(anew))),
            note,
        )
    )
    title = (
        f"on-line at {_RATE_HZ:.0f} Hz on one core: {spec.learner.kind} learner, a motion after every frame"
    )
    return Figure("online", title, tuple(rows))
