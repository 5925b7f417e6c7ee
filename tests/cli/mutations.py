"""Recordings damaged in every way that a disk, a cable or an enemy may think of."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

MAGIC = 8
HEAD = 9
# What a length or a count is most likely not prepared for.
_NUMBERS = (0, 1, 2**16, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)

# Types and names of fields in schemas of ROS, names and values in messages of JSON, and others instead.
_TYPE = re.compile(rb"(?<=\n)(float64|float32|string|uint32|uint8|int32)(\[\])?(?= )")
_FIELD = re.compile(rb"(?<= )[a-z_]+(?=\n)")
_KEY = re.compile(rb'(?<=")[a-z_]+(?=":)')
_VALUE = re.compile(rb'(?<=": )(null|\[[^]]*\]|"[^"]*"|-?[0-9.]+)')
_OTHERS = {
    _TYPE: (b"bool", b"int8", b"uint8", b"int64", b"string", b"uint8[]", b"float32", b"bool[]", b"string[]"),
    _FIELD: (b"x", b"a_b", b"data", b"__class__", b"_type"),
    _KEY: (b"x", b"id", b"__dict__", b"left"),
    _VALUE: (
        b"0",
        b"-1",
        b"null",
        b"true",
        b"[]",
        b"{}",
        b'""',
        b"[null]",
        b"[{}]",
        b"1e999",
        b"NaN",
        b'{"x": 1}',
    ),
}

Mutation = Callable[[bytearray, np.random.Generator], bytearray]


def rewritten(source: Path, target: Path, **options: Any) -> Path:
    """Copy a recording with another writer: uncompressed or without checksums, where damage goes deeper."""
    with source.open("rb") as old, target.open("wb") as new:
        writer = Writer(new, **options)
        writer.start()
        channels: dict[str, int] = {}
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, number
                )
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    return target


def forms(source: Path, folder: Path) -> dict[str, bytes]:
    """Return the recording as it is, without compression and checksums, and without chunks."""
    bare = {"enable_crcs": False, "enable_data_crcs": False, "compression": CompressionType.NONE}
    plain = rewritten(source, folder / f"{source.stem}-plain.mcap", chunk_size=2048, **bare)
    loose = rewritten(source, folder / f"{source.stem}-loose.mcap", use_chunking=False, **bare)
    return {path.stem: path.read_bytes() for path in (source, plain, loose)}


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, first byte and end of every record outside of chunks."""
    found = []
    at = MAGIC
    while at + HEAD <= len(data) - MAGIC:
        opcode, length = struct.unpack_from("<BQ", data, at)
        end = at + HEAD + length
        if end > len(data):
            break
        found.append((opcode, at, end))
        at = end
    return found


def flip_bits(data: bytearray, rng: np.random.Generator) -> bytearray:
    for where in rng.integers(0, len(data), rng.integers(1, 20)):
        data[where] ^= 1 << int(rng.integers(8))
    return data


def overwrite(data: bytearray, rng: np.random.Generator) -> bytearray:
    at = int(rng.integers(len(data)))
    n = int(rng.integers(1, 200))
    data[at : at + n] = rng.integers(0, 256, len(data[at : at + n]), dtype=np.uint8).tobytes()
    return data


def cut_off(data: bytearray, rng: np.random.Generator) -> bytearray:
    return data[: int(rng.integers(len(data)))]


def cut_out(data: bytearray, rng: np.random.Generator) -> bytearray:
    first, last = sorted(rng.integers(0, len(data), 2).tolist())
    return data[:first] + data[last:]


def repeat(data: bytearray, rng: np.random.Generator) -> bytearray:
    first, last = sorted(rng.integers(0, len(data), 2).tolist())
    return data[:last] + data[first:last] + data[last:]


def swap_records(data: bytearray, rng: np.random.Generator) -> bytearray:
    found = records(bytes(data))
    if len(found) < 2:
        return cut_out(data, rng)
    i, j = sorted(rng.choice(len(found), 2, replace=False).tolist())
    (_, a, b), (_, c, d) = found[i], found[j]
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


def drop_record(data: bytearray, rng: np.random.Generator) -> bytearray:
    found = records(bytes(data))
    if not found:  # another mutation has left none
        return cut_out(data, rng)
    _, first, last = rng.choice(found)
    return data[:first] + data[last:]


def wrong_length(data: bytearray, rng: np.random.Generator) -> bytearray:
    found = records(bytes(data))
    if not found:
        return wrong_number(data, rng)
    _, at, _ = rng.choice(found)
    struct.pack_into("<Q", data, int(at) + 1, int(rng.choice(np.array(_NUMBERS, np.uint64))))
    return data


def wrong_number(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Put a huge, zero or negative number over four or eight bytes: sizes, counts, offsets, times."""
    form, n = ("<Q", 8) if rng.random() < 0.5 else ("<I", 4)
    at = int(rng.integers(0, len(data) - n))
    value = int(rng.choice(np.array(_NUMBERS, np.uint64))) % 2 ** (8 * n)
    struct.pack_into(form, data, at, value)
    return data


def wrong_chunk_size(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Let a chunk declare another size than it has: the first thing memory is taken for."""
    chunks = [at for opcode, at, _ in records(bytes(data)) if opcode == Opcode.CHUNK]
    if not chunks:
        return wrong_number(data, rng)
    at = int(rng.choice(chunks)) + HEAD
    field = at + int(rng.choice([0, 8, 16]))  # start time, end time, uncompressed size
    struct.pack_into("<Q", data, field, int(rng.choice(np.array(_NUMBERS, np.uint64))))
    return data


def other_kind(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Give a field another type, name or value, of as many bytes: schemas and messages contradict us then."""
    pattern = list(_OTHERS)[rng.integers(len(_OTHERS))]
    found = [match.span() for match in pattern.finditer(data)]
    if not found:
        return wrong_number(data, rng)
    first, last = found[rng.integers(len(found))]
    others = [other for other in _OTHERS[pattern] if len(other) <= last - first]
    if others:
        data[first:last] = others[rng.integers(len(others))].ljust(last - first)
    return data


MUTATIONS: tuple[Mutation, ...] = (
    flip_bits,
    overwrite,
    cut_off,
    cut_out,
    repeat,
    swap_records,
    drop_record,
    wrong_length,
    wrong_number,
    wrong_chunk_size,
    other_kind,
)


@dataclass(frozen=True)
class Case:
    """A damaged recording, and how it came to be."""

    base: str
    how: str
    data: bytes


def case(bases: dict[str, bytes], number: int) -> Case:
    """Return the case of a number; the same on every machine."""
    rng = np.random.default_rng([20_241, number])
    base = list(bases)[number % len(bases)]
    data = bytearray(bases[base])
    chosen = rng.choice(len(MUTATIONS), int(rng.integers(1, 3)))
    for m in chosen:
        data = MUTATIONS[m](data, rng) if len(data) > 100 else data
    return Case(base, " + ".join(MUTATIONS[m].__name__ for m in chosen), bytes(data))
