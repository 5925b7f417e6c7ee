"""Commands in a process of their own, whose memory is measured and whose time is bounded."""

from __future__ import annotations

import multiprocessing
import resource
import traceback
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType

from vmf_command import Said, vmf

# No command may take more than this. The process is let go on to much more, or else the command would be
# told that there is no memory, and might take that for damage and be praised for it.
MEMORY_BYTES, LIMIT_BYTES = 2 * 2**30, 6 * 2**30
PATIENCE_S = 120.0
# Linux: the peak is forgotten when a 5 is written, so that each command has its own.
_CLEAR_REFS, _RESET_PEAK, _STATUS = Path("/proc/self/clear_refs"), "5", Path("/proc/self/status")


def objection(said: Said) -> str | None:
    """Return what is wrong with how a command ended, None if nothing is."""
    if said.code not in (0, 2, 3):
        return f"exit code {said.code}"
    if "Traceback" in said.err:
        return "a traceback"
    if said.code == 2 and not said.err.strip():
        return "refused without a word"
    if said.code == 3 and "lost: " not in said.err and "lost" not in said.out:
        return "losses that are not named"
    return None


class Confined:
    """A process that runs one command after the other; it is begun anew if one of them brings it down."""

    def __init__(self) -> None:
        self.peak_bytes = 0
        self._start()

    def __enter__(self) -> Confined:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.join()

    def __call__(self, *arguments: object) -> Said:
        """Run `vmf`; code −1 is a hang, a death or too much memory, 1 an exception that was let through."""
        self._pipe.send([str(a) for a in arguments])
        try:
            if self._pipe.poll(PATIENCE_S):
                *said_so_far, self.peak_bytes = self._pipe.recv()
                if self.peak_bytes <= MEMORY_BYTES:
                    return Said(*said_so_far)
                return Said(-1, "", f"took {self.peak_bytes >> 20} MiB of memory")
            said = Said(-1, "", f"still running after {PATIENCE_S:g} s")
        except EOFError:
            said = Said(-1, "", "the process died")
        self._process.kill()
        self._process.join()
        self._start()
        return said

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other,), daemon=True)
        self._process.start()
        other.close()


def _serve(pipe: Connection) -> None:
    resource.setrlimit(resource.RLIMIT_DATA, (LIMIT_BYTES, LIMIT_BYTES))
    while True:
        try:
            arguments: Sequence[str] = pipe.recv()
        except EOFError:
            return
        _CLEAR_REFS.write_text(_RESET_PEAK)
        try:
            said = vmf(*arguments)
        except Exception:
            said = Said(1, "", traceback.format_exc())
        pipe.send((said.code, said.out, said.err, _peak_bytes()))


def _peak_bytes() -> int:
    """Return the most that this process has held in memory since its last reset."""
    (line,) = (line for line in _STATUS.read_text().splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024
