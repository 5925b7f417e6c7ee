"""What is in one chunk, without trusting the sizes and counts it declares."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import get_chunk_data_stream

from vmf.data.recording.damage import DamagedError, LibraryCalls

# Of a chunk, and of any record that is not in one.
MAX_RECORD_BYTES = 2**28
MAX_RECORDS = 2**20

_TIMES_SIZE_CRC = struct.Struct("<QQQI")
_RECORD_HEAD = struct.Struct("<BQ")
_NAME_LENGTH, _DATA_LENGTH = struct.Struct("<I"), struct.Struct("<Q")
_LONGEST_NAME = 32
_MESSAGE_HEAD_BYTES = 22


class TooLargeError(DamagedError):
    """Something declares more than is accepted, or holds more than it declares."""


class _WholeReads(ReadDataStream):
    """A stream that ends where its data do: the library's is content with less than was asked for."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def stream(data: bytes) -> ReadDataStream:
    """Return bytes as the library's record readers take them; `EndOfFile` for more than there are."""
    return _WholeReads(BytesIO(data))


def bounded(size: int) -> int:
    """Return a size in bytes.

    Raises
    ------
    TooLargeError : it is more than `MAX_RECORD_BYTES`.
    """
    if size > MAX_RECORD_BYTES:
        raise TooLargeError(f"declares {size} bytes, more than the {MAX_RECORD_BYTES} accepted")
    return size


def decompressed(body: memoryview) -> Chunk:
    """Return a chunk record with its data decompressed, never taking more memory than it declares.

    Its sizes are checked before anything of it is copied.

    Raises
    ------
    DamagedError : sizes contradict each other or exceed `MAX_RECORD_BYTES`, or it cannot be decompressed.
    """
    if len(body) < _TIMES_SIZE_CRC.size + _NAME_LENGTH.size:
        raise DamagedError("too short for its content")
    first_ns, last_ns, size, crc = _TIMES_SIZE_CRC.unpack_from(body)
    at = _TIMES_SIZE_CRC.size
    (name_bytes,) = _NAME_LENGTH.unpack_from(body, at)
    at += _NAME_LENGTH.size
    if name_bytes > _LONGEST_NAME or at + name_bytes + _DATA_LENGTH.size > len(body):
        raise DamagedError("lengths inside the chunk do not fit")
    compression = str(body[at : at + name_bytes], "utf-8", "replace")
    at += name_bytes
    (data_bytes,) = _DATA_LENGTH.unpack_from(body, at)
    at += _DATA_LENGTH.size
    if at + data_bytes != len(body):
        raise DamagedError("lengths inside the chunk do not fit")
    bounded(max(size, data_bytes))
    with body[at:] as stored:
        data = _decompressed(stored, compression, size)
    return Chunk(
        compression="",
        data=data,
        message_end_time=last_ns,
        message_start_time=first_ns,
        uncompressed_crc=crc,
        uncompressed_size=size,
    )


def _decompressed(stored: memoryview, compression: str, size: int) -> bytes:
    if compression not in ("", "zstd", "lz4"):
        raise DamagedError(f"unsupported compression type {compression!r}")
    if compression == "zstd" and size:
        data = unpacked(stored, size)
    elif compression == "lz4" and size:
        # One byte more than declared, so that more than that shows.
        with LibraryCalls():
            data = lz4.frame.LZ4FrameDecompressor().decompress(stored, max_length=size + 1)
        if len(data) > size:
            raise TooLargeError(f"declares {size} bytes but holds more")
    else:
        if len(stored) != size:
            raise DamagedError(f"declares {size} bytes but holds {len(stored)}")
        data = bytes(stored)
    if len(data) != size:
        raise DamagedError(f"declares {size} bytes but holds {len(data)}")
    return data


def unpacked(stored: bytes | memoryview, size: int | None = None) -> bytes:
    """Return what is in one frame of zstd, which has to be of `size` bytes, if that is known.

    Raises
    ------
    TooLargeError : it holds more than `size` or `MAX_RECORD_BYTES`, or may do so.
    DamagedError : it is of another size, or damaged.
    """
    with LibraryCalls():
        stated = zstandard.get_frame_parameters(stored).content_size
    unknown = stated == zstandard.CONTENTSIZE_UNKNOWN
    if not unknown and bounded(stated) != (stated if size is None else size):
        raise DamagedError(f"declares {size} bytes but holds {stated}")
    most = MAX_RECORD_BYTES if size is None else size
    if unknown:
        with (
            LibraryCalls(),
            zstandard.ZstdDecompressor().stream_reader(stored, read_across_frames=True) as reader,
        ):
            data = reader.read(most + 1)
        if len(data) > most:
            raise TooLargeError(f"holds more than {most} bytes")
        return data
    with LibraryCalls():
        try:
            return zstandard.ZstdDecompressor().decompress(
                stored, max_output_size=most, allow_extra_data=False
            )
        except zstandard.ZstdError as error:
            if "unused data" in str(error):
                raise TooLargeError(f"holds more than the {stated} bytes that it declares") from None
            raise


def checked(chunk: Chunk) -> Iterator[McapRecord]:
    """Return the schemas, channels and messages of a chunk one by one, after a look at all of them.

    Raises
    ------
    DamagedError : the checksum does not match, a record does not fit, or there are more than `MAX_RECORDS`.
    """
    with LibraryCalls():
        get_chunk_data_stream(chunk, validate_crc=True)
    _check(chunk.data)
    return _records(chunk.data)


def _check(data: bytes) -> None:
    at = count = 0
    while at < len(data):
        if at + _RECORD_HEAD.size > len(data):
            raise DamagedError("too short for its content")
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        at += _RECORD_HEAD.size
        end = at + length
        if end > len(data) or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD_BYTES):
            raise DamagedError("a record inside the chunk does not fit")
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            reader = stream(data[at:end])
            with LibraryCalls():
                Schema.read(reader) if opcode == Opcode.SCHEMA else Channel.read(reader)
        at = end
        count += 1
        if count > MAX_RECORDS:
            raise TooLargeError(f"holds more than the {MAX_RECORDS} records accepted")


def _records(data: bytes) -> Iterator[McapRecord]:
    reader = stream(data)
    while reader.count < len(data):
        opcode, length = reader.read1(), reader.read8()
        end = reader.count + length
        if opcode == Opcode.MESSAGE:
            yield Message.read(reader, length)
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(reader)
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(reader)
        reader.read(end - reader.count)
