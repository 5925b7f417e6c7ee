"""Files that are either complete or not there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from vmf.errors import InputError


def write_bytes(path: Path, data: bytes, durable: bool = True) -> None:
    """Write a file by way of a temporary one beside it, so that a reader never meets half of it.

    `durable` waits for the disk, milliseconds a file, so that the file also outlives a loss of power.
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            if durable:
                stream.flush()
                os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str, durable: bool = True) -> None:
    """Write a text file in the same way, as UTF-8."""
    write_bytes(path, text.encode(), durable)


def point_to(link: Path, target: Path) -> None:
    """Make `link` a relative symbolic link to a sibling directory, replacing an older link."""
    temporary = link.with_name(f".{link.name}.{os.getpid()}")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(target.name, target_is_directory=True)
    try:
        os.replace(temporary, link)
    except IsADirectoryError as error:
        temporary.unlink()
        raise InputError(f"{link}: a directory, a link to the newest run is expected here") from error
