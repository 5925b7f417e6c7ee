"""Small files, or files of holes, that declare or unpack to more than fits in memory."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import IO

import zstandard
from mcap.opcode import Opcode
from mutations import records

from vmf.data.recording.chunks import MAX_RECORD_BYTES, MAX_RECORDS

# More than is accepted of anything.
HUGE = MAX_RECORD_BYTES + 2**24
# Records that would fit by their bytes.
_MANY = 2 * MAX_RECORDS

Bomb = Callable[[IO[bytes], bytes], None]


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def _with(file: IO[bytes], sound: bytes, opcode: int, head: bytes, holes: int = 0) -> None:
    """Write a recording with one more record at the front: its head, then zeros that take no disk."""
    (_, _, front), *_ = records(sound)
    file.write(sound[:front] + struct.pack("<BQ", opcode, len(head) + holes) + head)
    file.seek(holes, 1)
    file.write(sound[front:])


def attachment(file: IO[bytes], sound: bytes) -> None:
    head = struct.pack("<QQ", 0, 0) + text("a") + text("b") + struct.pack("<Q", HUGE)
    _with(file, sound, Opcode.ATTACHMENT, head, HUGE + 4)  # a checksum follows


def message(file: IO[bytes], sound: bytes) -> None:
    _with(file, sound, Opcode.MESSAGE, struct.pack("<HIQQ", 1, 0, 1, 1), HUGE)


def chunk(file: IO[bytes], sound: bytes) -> None:
    head = struct.pack("<QQQI", 1, 1, HUGE, 0) + text("") + struct.pack("<Q", HUGE)
    _with(file, sound, Opcode.CHUNK, head, HUGE)


def _packed(file: IO[bytes], sound: bytes, parts: tuple[tuple[bytes, int], ...], write_size: bool) -> None:
    size = sum(len(part) * n for part, n in parts)
    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size if write_size else -1)
    packed = b""
    for part, n in parts:
        step = max(1, 2**20 // len(part))
        for start in range(0, n, step):
            packed += packer.compress(part * min(step, n - start))
    packed += packer.flush()
    head = struct.pack("<QQQI", 1, 1, size, 0) + text("zstd") + struct.pack("<Q", len(packed))
    _with(file, sound, Opcode.CHUNK, head + packed)


def zeros(file: IO[bytes], sound: bytes) -> None:
    head = struct.pack("<BQ", Opcode.MESSAGE, 22 + HUGE) + struct.pack("<HIQQ", 1, 0, 1, 1)
    _packed(file, sound, ((head, 1), (bytes(1), HUGE)), True)


def flood(file: IO[bytes], sound: bytes) -> None:
    one = struct.pack("<BQ", Opcode.MESSAGE, 22) + struct.pack("<HIQQ", 1, 0, 1, 1)
    _packed(file, sound, ((one, _MANY),), True)


def unsized(file: IO[bytes], sound: bytes) -> None:
    _packed(file, sound, ((bytes(1), HUGE),), False)


BOMBS: tuple[Bomb, ...] = (attachment, message, chunk, zeros, flood, unsized)
