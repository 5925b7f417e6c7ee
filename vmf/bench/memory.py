"""Peak memory against the number of frames, in processes of their own."""

from __future__ import annotations

import resource
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vmf.approximate import Lookup, Tiling
from vmf.bench.figure import Effort, Figure, growth
from vmf.data import Tracks
from vmf.data.simulate import simulate, trial_streams
from vmf.learn import CompressedPipeline
from vmf.spec import loads
from vmf.tasks import make_task

_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: 1, seed: 1}}
"""
# The trained code's parameters are asked for this often.
_EVERY = 100


def learn(frames: int, after_each: Callable[[int], None]) -> CompressedPipeline:
    """Learn frame by frame, with an answer now and then."""
    spec = loads(_SPEC.format(frames=frames), "bench").spec
    tracks = simulate(spec, trial_streams(spec, 0)[0]).tracks
    learner = CompressedPipeline(make_task("six_dof"), Tiling(), Lookup, readout="pooled", min_support=0.0)
    code = tracks.pixels[:1]
    nought = np.zeros(1, np.int64)
    after_each(-1)
    for i in range(frames):
        now = slice(i, i + 1)
        E, pixels = tracks.E_S_from_W[now], tracks.pixels[now]
        learner.partial_fit(Tracks(tracks.times_ns[now], E, nought, nought, pixels, tracks.ids))
        if (i + 1) % _EVERY == 0:
            learner.parameters(code)
        after_each(i)
    return learner


def resident(frames: int) -> int:
    """Learn in this process, and return the most memory that it ever had."""
    learn(frames, lambda i: None)
    return peak_resident()


def peak_resident() -> int:
    """Return the most memory (bytes) that this process ever had."""
    status = Path("/proc/self/status")
    if status.exists():
        # Linux counts what the parent had before it became this process into `ru_maxrss`.
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
        return 1024 * int(line.split()[1])
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size if sys.platform == "darwin" else 1024 * size


def traced(frames: int) -> tuple[int, float]:
    """Return what is held after learning in this process, and what a frame needs in passing."""
    passing = []
    last = 0

    def after_each(i: int) -> None:
        nonlocal last
        if i < 0:
            tracemalloc.start()
            return
        now, peak = tracemalloc.get_traced_memory()
        passing.append(peak - max(last, now))
        last = now
        tracemalloc.reset_peak()

    try:
        learner = learn(frames, after_each)
        held, _ = tracemalloc.get_traced_memory()
        del learner
    finally:
        tracemalloc.stop()
    return held, float(np.median(passing))


def resident_apart(frames: int) -> int:
    """Return what `resident` finds in a new process."""
    done = subprocess.run(
        [sys.executable, "-m", "vmf.bench.memory", str(frames)], capture_output=True, text=True, check=True
    )
    return int(done.stdout)


def figure(effort: Effort) -> Figure:
    """Measure what learning holds and needs in passing, from few and from many frames."""
    few, many = (100, 400) if effort.quick else (1000, 10_000)
    peaks = {n: resident_apart(n) for n in (few, many)}
    (held_few, passing_few), (held_many, passing_many) = traced(few), traced(many)
    each = (held_many - held_few) / (many - few)
    held = {few: held_few, many: held_many}
    case, from_few = f"{many} frames against {few}", f"from {few} frames"
    # A pose is 16 numbers and a time, a code 4 with its frame and target.
    observation = 8 * (16 + 1 + 4 + 2)
    rows = (
        growth(
            case,
            ("peak of the process, model and observations aside", peaks[many] - held[many]),
            (from_few, peaks[few] - held[few]),
            "bytes",
        ),
        growth(case, ("peak of the process", peaks[many]), (from_few, peaks[few]), "bytes"),
        growth(
            case,
            ("what a frame needs in passing", passing_many),
            (from_few, passing_few),
            "bytes",
            "medians over the frames",
        ),
        growth(
            f"from {few} to {many} frames",
            ("held for an observation more", each),
            ("its pose and code", observation),
            "bytes",
            "the rest is the index of codes, and room to grow",
        ),
    )
    return Figure("memory", "peak memory of the compressed engine against the number of frames", rows)


if __name__ == "__main__":
    print(resident(int(sys.argv[1])))
