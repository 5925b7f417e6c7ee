"""How far long work is: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

Report = Callable[[int, int, str], None]

# Seconds between two lines in a log.
_LINE_EVERY_S = 5.0


def reporter(quiet: bool) -> tuple[Any, Report]:
    """Return a bar to stop at the end (or None) and the function that moves it."""
    if quiet:
        return None, lambda done, total, what: None
    if sys.stderr.isatty():
        return _bar()
    return None, _lines()


def _bar() -> tuple[Any, Report]:
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

    return bar, report


def _lines() -> Report:
    began = last = time.perf_counter()

    def report(done: int, total: int, what: str) -> None:
        nonlocal last
        now = time.perf_counter()
        if done == total or now - last >= _LINE_EVERY_S:
            last = now
            print(f"{what}: {done} of {total} after {now - began:.1f} s", file=sys.stderr, flush=True)

    return report
