"""Open files that have an end: a pipe without a writer is waited for, and a device read, for ever."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file to be read.

    Raises
    ------
    OSError : it cannot be opened, or is a pipe, a socket or a device (`strerror` says which).
    IsADirectoryError : it is a directory.
    """
    # Whether it is one is asked of what was opened, and a pipe is opened without waiting for its writer.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        check_regular(path, os.fstat(handle).st_mode)
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def check_regular(path: Path, mode: int) -> None:
    """Check that a mode, as `os.stat` returns it, is that of a regular file.

    Raises
    ------
    OSError : it is that of something else.
    IsADirectoryError : it is that of a directory.
    """
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, a regular file is accepted", str(path))
