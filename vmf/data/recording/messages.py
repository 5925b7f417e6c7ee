"""From the bytes of a message to an object with the fields of its schema, whatever the encoding."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory

from vmf.data.recording.container import Topic
from vmf.data.recording.damage import DamagedError, LibraryCalls, fields, reason
from vmf.errors import InputError

MAX_TIME_NS = 2**63 - 1
# Beyond this no metre, pixel or radian means anything, and squares overflow.
MAX_NUMBER = 1e9
# No image is wider or higher: JPEG counts no further.
MAX_SIDE_PX = 65_535
_PROTOBUF_STAMP, _ROS_STAMP, _JSON_STAMP = (
    fields("seconds", "nanos"),
    fields("sec", "nanosec"),
    fields("sec", "nsec"),
)


def decoder(topic: Topic) -> Callable[[bytes], Any]:
    """Return the function that decodes the messages of a topic; `fields` read what it returns.

    It raises `DamagedError` for bytes that are no such message.

    Raises
    ------
    InputError : the encoding is not one that is read, or the schema in the file cannot be parsed.
    """
    if topic.encoding == "json":
        return _from_json
    schema = Schema(id=1, data=topic.schema_data, encoding=topic.schema_encoding, name=topic.schema)
    try:
        # The schema parser prints what it also raises.
        with LibraryCalls(), contextlib.redirect_stderr(io.StringIO()):
            decode = Ros2Factory().decoder_for(topic.encoding, schema)
            decode = decode or ProtobufFactory().decoder_for(topic.encoding, schema)
    except DamagedError as error:
        raise InputError(
            f"{topic.name}: schema {topic.schema} in the file cannot be parsed: {reason(error)}"
        ) from None
    if decode is None:
        raise InputError(
            f"{topic.name}: {topic.schema} is encoded as {topic.encoding or 'nothing'} with a "
            f"{topic.schema_encoding or 'missing'} schema; accepted: cdr with ros2msg, protobuf, json"
        )

    def decoded(data: bytes) -> Any:
        with LibraryCalls():
            return decode(data)

    return decoded


def stamp_ns(stamp: object, log_time_ns: int) -> int:
    """Return a ROS, protobuf or JSON stamp in ns, or the log time where the stamp was never set.

    Raises
    ------
    DamagedError : not a time from 1970 on that fits 64 bits.
    """
    if hasattr(stamp, "nanos"):
        seconds, rest = _PROTOBUF_STAMP(stamp)
    else:
        seconds, rest = _ROS_STAMP(stamp) if hasattr(stamp, "nanosec") else _JSON_STAMP(stamp)
    if type(seconds) is not int or type(rest) is not int:
        raise DamagedError("stamp is not made of integers")
    time = (seconds * 10**9 + rest) or log_time_ns
    if not 0 <= time <= MAX_TIME_NS:
        raise DamagedError(f"stamp {seconds} s {rest} ns is no valid time")
    return time


def number(value: object) -> float:
    """Return a number as float.

    Raises
    ------
    DamagedError : anything else, such as a string or a truth value from JSON, or an integer beyond doubles.
    """
    if type(value) is float:
        return value
    if type(value) is int and abs(value) <= sys.float_info.max:
        return float(value)
    raise DamagedError(f"{value!r} is not a number")


def text(value: object) -> str:
    """Return a text.

    Raises
    ------
    DamagedError : anything else, halves of characters included: JSON may have them, and no other format.
    """
    if not isinstance(value, str) or not is_unicode(value):
        raise DamagedError(f"{value!r} is not a text")
    return value


def is_unicode(text: str) -> bool:
    """Tell whether a text is made of whole characters, so that it can be written."""
    return not any("\ud800" <= character <= "\udfff" for character in text)


def listed(value: object) -> list[Any]:
    """Return a list, as ROS and JSON have them.

    Raises
    ------
    DamagedError : anything else.
    """
    if not isinstance(value, list):
        raise DamagedError(f"{value!r} is not a list")
    return value


def usable(*values: float) -> bool:
    """Tell whether no value is NaN, infinite or beyond `MAX_NUMBER`."""
    return all(abs(value) <= MAX_NUMBER for value in values)


def _from_json(data: bytes) -> Any:
    with LibraryCalls():
        return json.loads(data, object_hook=_namespace)


def _namespace(fields: dict[str, Any]) -> SimpleNamespace:
    return SimpleNamespace(**fields)
