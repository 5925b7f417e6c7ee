"""Decompress one chunk, without trusting the sizes it declares."""

from __future__ import annotations

from io import BytesIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import UnsupportedCompressionError
from mcap.records import Chunk

MAX_CHUNK_BYTES = 2**30

_FIXED_BYTES = 40  # a chunk record without its compression's name and its data


def stream(data: bytes) -> ReadDataStream:
    """Return bytes as the library's record readers take them."""
    return ReadDataStream(BytesIO(data))


def decompressed(body: bytes) -> Chunk:
    """Return a chunk record with its data decompressed, never taking more memory than it declares.

    Raises
    ------
    ValueError : sizes contradict each other or exceed `MAX_CHUNK_BYTES`.
    """
    chunk = Chunk.read(stream(body))
    size = chunk.uncompressed_size
    if _FIXED_BYTES + len(chunk.compression.encode()) + len(chunk.data) != len(body):
        raise ValueError("lengths inside the chunk do not fit")
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"declares {size} bytes, more than the {MAX_CHUNK_BYTES} accepted")
    raw = chunk.data
    if chunk.compression == "zstd" and size:
        stated = zstandard.get_frame_parameters(raw).content_size
        if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError(f"declares {size} bytes but holds {stated}")
        raw = zstandard.ZstdDecompressor().decompress(raw, max_output_size=size)
    elif chunk.compression == "lz4" and size:
        raw = lz4.frame.LZ4FrameDecompressor().decompress(raw, max_length=size)
    elif chunk.compression not in ("", "zstd", "lz4"):
        raise UnsupportedCompressionError(chunk.compression)
    if len(raw) != size:
        raise ValueError(f"declares {size} bytes but holds {len(raw)}")
    return Chunk(
        compression="",
        data=raw,
        message_end_time=chunk.message_end_time,
        message_start_time=chunk.message_start_time,
        uncompressed_crc=chunk.uncompressed_crc,
        uncompressed_size=size,
    )
