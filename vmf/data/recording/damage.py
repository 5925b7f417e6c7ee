"""What damage of a file makes libraries raise, turned in one place into the one exception that we catch."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from operator import attrgetter
from types import TracebackType
from typing import Any, TypeVar

from google.protobuf.message import DecodeError
from mcap.exceptions import EndOfFile, McapError
from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification, InvalidValue
from zstandard import ZstdError

T = TypeVar("T")

# Nothing less than this list will do: the readers check little themselves, so flipped bits surface as
# whatever Python raises first. RuntimeError is lz4's; ValueError covers CRC, Unicode and JSON errors; OSError
# to AssertionError are what Pillow raises; the parser of ROS definitions raises NameError.
_RAISED: tuple[type[Exception], ...] = (
    McapError,
    DecodeError,
    InvalidSpecification,
    InvalidValue,
    ZstdError,
    zlib.error,
    struct.error,
    re.error,
    ValueError,
    OverflowError,
    MemoryError,
    RuntimeError,
    EOFError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    OSError,
    SyntaxError,
    AssertionError,
    NameError,
)


class DamagedError(ValueError):
    """Something in a file is damaged, or is not what its schema or its format says it is.

    The only exception that reading counts as a loss. Whatever else our own code raises is a mistake in it.
    """


class LibraryCalls:
    """A context for calls of libraries alone: what they raise because of damage becomes `DamagedError`.

    None of our own code belongs in it, whose mistakes would be taken for damage of the file.

    Raises
    ------
    DamagedError : a library has met damage.
    """

    def __init__(self, *more: type[Exception]) -> None:
        """Take what a library raises that is not loaded everywhere, beside what the others raise."""
        self._raised = (*_RAISED, *more)

    def __enter__(self) -> None:
        """Begin the calls."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Turn what was raised, if it is damage."""
        if isinstance(error, self._raised) and not isinstance(error, DamagedError | StopIteration):
            raise DamagedError(reason(error)) from error


def each(items: Iterator[T], *more: type[Exception]) -> Iterator[T]:
    """Yield what a library's iterator yields, which raises while it is iterated and not when it is made.

    Raises
    ------
    DamagedError : it has met damage.
    """
    while True:
        try:
            with LibraryCalls(*more):
                item = next(items)
        except StopIteration:
            return
        yield item


def fields(*paths: str) -> Callable[[object], Any]:
    """Return what reads fields of messages: one its value, several a tuple; `a.b` is the field b of a.

    Which fields a message has is said by the schema in its file, if by anything. The reader raises
    `DamagedError` where one is missing; of what kind their values are, it leaves to the caller to check.
    """
    get = attrgetter(*paths)

    def read(message: object) -> Any:
        try:
            return get(message)
        except AttributeError as error:
            raise DamagedError(f"no field {error.name}") from None

    return read


def reason(error: Exception) -> str:
    """Return one line on why something could not be read."""
    if isinstance(error, EndOfFile | EOFError):
        return "data ends too early"
    if isinstance(error, MemoryError):
        return "declares more than fits in memory"
    if isinstance(error, struct.error):
        return "too short for its content"
    text = " ".join(str(error).split())
    return (text if len(text) <= 120 else text[:117] + "...") or type(error).__name__
