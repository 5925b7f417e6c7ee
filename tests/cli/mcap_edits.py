"""Recordings copied message by message, some of them changed on the way."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer

# Edits one message (number on its topic, data); gives the messages written in its place.
Edit = Callable[[int, bytes], Iterable[bytes]]
SECOND_NS = 10**9
_STAMP = struct.Struct("<iI")
_QUATERNION = struct.Struct("<4d")
_CDR_HEADER = 4


def copy(
    source: Path,
    target: Path,
    *,
    edits: dict[str, Edit] | None = None,
    schemas: dict[str, str] | None = None,
    last_s: float | None = None,
) -> Path:
    """Copy a recording: with messages of some topics edited, schemas renamed, and at most so many seconds."""
    edits, schemas = edits or {}, schemas or {}
    with source.open("rb") as old, target.open("wb") as new:
        writer = Writer(new, chunk_size=4096)
        writer.start()
        channels: dict[str, int] = {}
        numbers: dict[str, int] = {}
        begin = None
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            topic = channel.topic
            begin = message.log_time if begin is None else begin
            if last_s is not None and message.log_time > begin + last_s * SECOND_NS:
                break
            if topic not in channels:
                name = schemas.get(topic, schema.name)
                number = writer.register_schema(name, schema.encoding, schema.data)
                channels[topic] = writer.register_channel(topic, channel.message_encoding, number)
            i = numbers[topic] = numbers.get(topic, -1) + 1
            written = edits[topic](i, message.data) if topic in edits else [message.data]
            for data in written:
                writer.add_message(channels[topic], message.log_time, data, message.log_time)
        writer.finish()
    return target


def at(number: int, change: Callable[[bytes], bytes]) -> Edit:
    """Change one message of a topic and leave the others."""
    return lambda i, data: [change(data) if i == number else data]


def in_json(change: Callable[[dict[str, Any]], None]) -> Callable[[bytes], bytes]:
    """Change a JSON message in place."""

    def changed(data: bytes) -> bytes:
        message = json.loads(data)
        change(message)
        return json.dumps(message).encode()

    return changed


def stretched_quaternion(factor: float) -> Callable[[bytes], bytes]:
    """Multiply the quaternion at the end of a PoseStamped."""

    def changed(data: bytes) -> bytes:
        q = _QUATERNION.unpack(data[-_QUATERNION.size :])
        return data[: -_QUATERNION.size] + _QUATERNION.pack(*(factor * v for v in q))

    return changed


def stamp_of(data: bytes) -> tuple[int, int]:
    """Seconds and nanoseconds at the beginning of a stamped ROS 2 message."""
    sec, nanosec = _STAMP.unpack_from(data, _CDR_HEADER)
    return int(sec), int(nanosec)


def with_stamp(data: bytes, stamp: tuple[int, int]) -> bytes:
    """Give a stamped ROS 2 message another time."""
    return data[:_CDR_HEADER] + _STAMP.pack(*stamp) + data[_CDR_HEADER + _STAMP.size :]


def flipped(data: bytes, where: int, bit: int = 0) -> bytes:
    """One bit of a file changed."""
    return data[:where] + bytes([data[where] ^ (1 << bit)]) + data[where + 1 :]
