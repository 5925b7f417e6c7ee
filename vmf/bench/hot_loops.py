"""How much of what one core can do the hot loops reach: the roofline.

Operations and bytes are counted from the algorithms, not measured: a Householder factorisation of an m × n
array takes `Σ_j 4 (m − j)(n − j)` over its reflections j; a sum over gathered rows reads each of them once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf

from vmf.approximate import Cmac
from vmf.bench.clock import in_turns
from vmf.bench.codes import pairs
from vmf.bench.figure import Effort, Figure, share
from vmf.bench.machine import peaks
from vmf.bench.motions import Lean, draw
from vmf.estimate import StereoEquations

Floats = NDArray[np.float64]

_LIFT = 13


@dataclass(frozen=True)
class Loop:
    """A piece of work, with the operations or the bytes that it takes at least."""

    name: str
    work: Callable[[], Any]
    amount: float
    bound: str
    counted: str


def reflections(m: int, n: int) -> float:
    """Return the floating-point operations of a Householder QR of an m × n array."""
    return float(sum(4 * (m - j) * (n - j) for j in range(min(m, n))))


def loops(effort: Effort) -> list[Loop]:
    """Return the loops that the time of learning and solving goes to."""
    targets, centres, queries, codes = (4, 4, 20, 50) if effort.quick else (100, 100, 1000, 1000)
    rng = np.random.default_rng(1)
    n = _LIFT
    x_bar = rng.standard_normal((targets, 60, n))
    u = 100.0 * rng.standard_normal((targets, 60, 2, 2))
    kept = StereoEquations.of(x_bar, u).triangular()
    new = StereoEquations.of(x_bar[:, :1], u[:, :1])
    update = targets * (reflections(n + 1, 5 * n) + 2 * reflections(n + 2, n))
    members, weight = np.zeros((centres, 4), np.int64), np.ones((centres, 4))
    pooling = centres * (reflections(4 * n, 5 * n) + 2 * reflections(4 * n + 2 * 3 * n, n))
    folded = np.asfortranarray(rng.standard_normal((3 * n + 256, 3 * n)))
    single = np.asfortranarray(rng.standard_normal((3 * n + 2, 3 * n)))
    lean, everyone = Lean(draw(queries)), np.arange(queries)
    x = np.zeros((queries, 6))
    # Rows times lift and its six derivatives, the quotient rule, and the motion itself.
    residuals = queries * (2.0 * 36 * 13 * 7 + 3.0 * 24 * 6)
    visited, theta = pairs(20 * codes, rng)
    asked, _ = pairs(codes, rng)
    cmac = Cmac(min_support=0.0)
    cmac.partial_fit(visited, theta)
    gathered = codes * 8.0 * theta.shape[1] * (cmac.tiling.overlays + 1)
    return [
        Loop(
            "an observation more of each target (QR, batched)",
            lambda: kept.with_others(new),
            update,
            "dgemm",
            f"{targets} factors of 14 × 65 and 2 of 15 × 13",
        ),
        Loop(
            "tiles of four centres (QR, batched)",
            lambda: kept.pooled(members, weight),
            pooling,
            "dgemm",
            f"{centres} factors of 52 × 65 and 2 of 130 × 13",
        ),
        Loop(
            "256 rows more of one tile (LAPACK)",
            lambda: dgeqrf(folded),
            reflections(*folded.shape),
            "dgemm",
            "a factor of 295 × 39",
        ),
        Loop(
            "two rows more of one tile, the thesis's update (LAPACK)",
            lambda: dgeqrf(single),
            reflections(*single.shape),
            "dgemm",
            "a factor of 41 × 39",
        ),
        Loop(
            "residuals and Jacobians of all motions",
            lambda: lean.residuals(x, everyone),
            residuals,
            "dgemm",
            f"{queries} times 36 × 13 by 13 × 7, and quotients",
        ),
        Loop(
            "CMAC predictions",
            lambda: cmac.predict(asked),
            gathered,
            "memory",
            f"{codes} codes, {cmac.tiling.overlays} rows of {theta.shape[1]} read and one written",
        ),
    ]


def figure(effort: Effort) -> Figure:
    """Measure what share of one core's dgemm rate and memory bandwidth the hot loops reach."""
    peak = peaks(effort.quick)
    of = {"dgemm": ("dgemm rate", peak.dgemm_gflops, "GFlop/s"), "memory": ("triad", peak.triad_gbs, "GB/s")}
    rows = []
    for loop in loops(effort):
        times = in_turns({loop.name: loop.work}, effort.repeats)[loop.name]
        name, best, unit = of[loop.bound]
        rates = loop.amount / times.seconds / 1e9
        rows.append(share("one core", (loop.name, rates), (name, best), unit, f"counted: {loop.counted}"))
    return Figure("hot_loops", "rates reached by the hot loops, as a share of the machine's own", tuple(rows))
