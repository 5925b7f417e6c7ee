"""What a damaged file makes the libraries raise, in one place, and how to say it in words."""

from __future__ import annotations

import re
import struct

from google.protobuf.message import DecodeError
from mcap.exceptions import EndOfFile, McapError
from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification, InvalidValue
from zstandard import ZstdError

# Nothing less than this list will do: the readers check little themselves, so flipped bits surface as
# whatever Python raises first. RuntimeError is lz4's; KeyError to AttributeError come from messages whose
# schema does not describe them; ValueError covers CRC, Unicode and JSON errors.
DAMAGE: tuple[type[Exception], ...] = (
    McapError,
    DecodeError,
    InvalidSpecification,
    InvalidValue,
    ZstdError,
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
)
# Of schemas: the parser of ROS definitions raises these two for what is wrong in one. Everywhere else they
# are mistakes in a program, and none of a file's.
SCHEMA_DAMAGE: tuple[type[Exception], ...] = (*DAMAGE, NameError, AssertionError)


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
