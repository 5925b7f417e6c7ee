"""Commands in a process of their own, with bounded memory and time."""

from __future__ import annotations

import multiprocessing
import resource
import traceback
from collections.abc import Sequence
from multiprocessing.connection import Connection
from types import TracebackType

from vmf_command import Said, vmf

MEMORY_BYTES = 2 * 2**30
PATIENCE_S = 120.0


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
        self._start()

    def __enter__(self) -> Confined:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.join()

    def __call__(self, *arguments: object) -> Said:
        """Run `vmf`; code −1 is a hang or a death, 1 an exception that was let through."""
        self._pipe.send([str(a) for a in arguments])
        try:
            if self._pipe.poll(PATIENCE_S):
                return Said(*self._pipe.recv())
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
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    while True:
        try:
            arguments: Sequence[str] = pipe.recv()
        except EOFError:
            return
        try:
            said = vmf(*arguments)
        except Exception:
            pipe.send((1, "", traceback.format_exc()))
            continue
        pipe.send((said.code, said.out, said.err))
