"""How far long work is: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

Report = Callable[[int, int, str], None]

# Seconds between two lines in a log.
_LINE_EVERY_S = 5.0


@dataclass(frozen=True)
class Reporter:
    """How to say how far work is.

    Attributes
    ----------
    report : moves the bar: how many are done, of how many, of what.
    say : says a line without spoiling the bar.
    stop : ends the bar.
    """

    report: Report
    say: Callable[[str], None]
    stop: Callable[[], None]


def reporter(quiet: bool) -> Reporter:
    """Return a bar on a terminal, lines in a log, or nothing but what has to be said."""
    if not quiet and sys.stderr.isatty():
        return _bar()
    report = (lambda done, total, what: None) if quiet else _lines()
    return Reporter(report, lambda line: print(line, file=sys.stderr, flush=True), lambda: None)


def _bar() -> Reporter:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    task = bar.add_task("", total=None, rate="")
    bar.start()
    began = time.perf_counter()
    first: list[int] = []

    def report(done: int, total: int, what: str) -> None:
        first.append(done)
        elapsed = time.perf_counter() - began
        rate = f"{(done - first[0]) / elapsed:.2g}/s" if done > first[0] else ""
        bar.update(task, description=what, completed=done, total=total, rate=rate)

    def say(line: str) -> None:
        bar.console.print(line, markup=False, highlight=False, soft_wrap=True)

    return Reporter(report, say, bar.stop)


def _lines() -> Report:
    began = last = time.perf_counter()

    def report(done: int, total: int, what: str) -> None:
        nonlocal last
        now = time.perf_counter()
        if done == total or now - last >= _LINE_EVERY_S:
            last = now
            print(f"{what}: {done} of {total} after {now - began:.1f} s", file=sys.stderr, flush=True)

    return report
