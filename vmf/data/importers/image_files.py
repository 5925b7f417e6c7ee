"""Images in files, read one at a time and passed on as they are."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from vmf.data.images.compressed import stated
from vmf.data.images.raw import MAX_PIXELS
from vmf.data.recording.damage import DamagedError, reason
from vmf.data.recording.synchronise import in_order
from vmf.errors import InputError, Loss
from vmf.regular_file import open_regular

SUFFIXES = (".png", ".jpg", ".jpeg")
# As many as the largest image that is accepted takes uncompressed, at 16 bit and four channels.
_MAX_BYTES = 8 * MAX_PIXELS


@dataclass(frozen=True)
class Picture:
    """An image file's bytes, which are `jpeg` or `png`, and (width, height) as it declares them."""

    form: str
    size: tuple[int, int]
    data: bytes = field(repr=False)


class _TooLargeError(DamagedError):
    """A file that no image that is accepted would fill."""


def _content(path: Path) -> bytes:
    with open_regular(path) as file:
        if os.fstat(file.fileno()).st_size > _MAX_BYTES:
            raise _TooLargeError
        return file.read()


class ImageList:
    """The image files of one camera, in order of time.

    Attributes
    ----------
    place : the file or folder that lists them.
    times_ns : (n,) strictly increasing.
    """

    def __init__(self, place: Path, files: Sequence[Path], times_ns: NDArray[np.int64]) -> None:
        """Put files in the order of their times (n,), leaving out those with the time of an earlier one.

        Raises
        ------
        InputError : there is no file.
        """
        if not len(files):
            raise InputError(f"{place}: names no image, at least one is accepted ({', '.join(SUFFIXES)})")
        order = in_order(times_ns, str(place))
        self.place = place
        self.files = tuple(files[i] for i in order.keep)
        self.times_ns = times_ns[order.keep]
        self.repairs = order.repairs
        self._losses = order.losses
        self._damaged: Counter[str] = Counter()
        self._first: dict[str, str] = {}

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What could not be used so far."""
        damaged = (
            Loss(str(self.place), f"{what}; first: {self._first[what]}", n)
            for what, n in self._damaged.items()
        )
        return (*self._losses, *damaged)

    def pictures(self) -> Iterator[tuple[int, Picture | None]]:
        """Yield the images with their times (ns), None for a file that is missing or no image."""
        for time, path in zip(self.times_ns.tolist(), self.files, strict=True):
            yield time, self._read(path)

    def size(self) -> tuple[int, int] | None:
        """Return (width, height) of the first image that can be read, None without one."""
        for path in self.files:
            try:
                return stated(_content(path)).size
            except (DamagedError, OSError):
                continue
        return None

    def check(self) -> None:
        """Check that an image was good.

        Raises
        ------
        InputError : none was.
        """
        if sum(self._damaged.values()) == len(self.files):
            raise InputError(f"{self.place}: no image can be used", *map(str, self.losses))

    def _read(self, path: Path) -> Picture | None:
        try:
            data = _content(path)
        except FileNotFoundError:
            return self._lost("images listed but missing", path.name)
        except OSError as error:
            return self._lost("images that cannot be read dropped", f"{path.name}: {error.strerror or error}")
        except _TooLargeError:
            return self._lost(f"images of more than {_MAX_BYTES} bytes dropped", path.name)
        try:
            head = stated(data)
            return Picture(head.form, head.size, data)
        except DamagedError as error:
            return self._lost("files that are no image dropped", f"{path.name}: {reason(error)}")

    def _lost(self, what: str, which: str) -> Picture | None:
        self._damaged[what] += 1
        self._first.setdefault(what, which)
        return None


def check_apart(source: Path, left: Path, right: Path) -> None:
    """Check that two cameras are not one.

    Raises
    ------
    InputError : left and right are the same file or folder.
    """
    if left.resolve() == right.resolve():
        raise InputError(f"{source}: {left.name} is given for both cameras, left=… and right=… name two")


def image_names(folder: Path) -> list[Path]:
    """Return the image files of a folder, by name.

    Raises
    ------
    InputError : it cannot be read.
    """
    try:
        return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror or error}") from None


def inside(folder: Path, name: str, where: str) -> Path:
    """Return the file of this name in a folder, or below it.

    Raises
    ------
    InputError : the name leads out of the folder.
    """
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\0" in name:
        raise InputError(f"{where}: found {name!r}, the name of a file below {folder} is accepted")
    return folder / path
