"""Measure figures, one after the other, with one BLAS thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter

from threadpoolctl import threadpool_limits

from vmf.bench.figure import Effort, Figure
from vmf.bench.machine import describe
from vmf.bench.registry import FIGURES
from vmf.bench.report import Report
from vmf.errors import InputError


def run(names: Sequence[str], effort: Effort, progress: Callable[[int, int, str], None]) -> Report:
    """Measure the figures of these names, all of them if none is given.

    Raises
    ------
    InputError : a name is not one of `FIGURES`.
    """
    for name in names:
        if name not in FIGURES:
            raise InputError(f"figure {name}: unknown, accepted: {', '.join(FIGURES)}")
    machine = describe()
    chosen = tuple(dict.fromkeys(names)) or tuple(FIGURES)
    figures: list[Figure] = []
    with threadpool_limits(1):
        for done, name in enumerate(chosen):
            progress(done, len(chosen), name)
            begin = perf_counter()
            figure = FIGURES[name](effort)
            figures.append(replace(figure, seconds=perf_counter() - begin))
    progress(len(chosen), len(chosen), "bench")
    return Report(machine, effort.quick, tuple(figures))
