"""Waiting for what other processes do, by looking again and again until a deadline."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import psutil

# Far more than anything here takes, on a busy machine too: only a failure ever waits so long.
DEADLINE_S = 120.0
_LOOK_EVERY_S = 0.01


def until(condition: Callable[[], object]) -> None:
    """Return when the condition holds; fail at the deadline."""
    end = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end, "nothing happened for too long"
        threading.Event().wait(_LOOK_EVERY_S)


def alive(pid: int) -> bool:
    """Whether there is such a process, apart from one that is dead and not yet waited for."""
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
