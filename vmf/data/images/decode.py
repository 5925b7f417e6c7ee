"""Image messages of four kinds, all brought to one: when it was taken, and its pixels."""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any

from vmf.data.images.compressed import from_compressed
from vmf.data.images.raw import Image, from_raw
from vmf.data.recording import schemas
from vmf.data.recording.container import RawMessage, Topic
from vmf.data.recording.damage import DamagedError, LibraryCalls, fields
from vmf.data.recording.messages import decoder, stamp_ns, text

_ROS_STAMP, _FOXGLOVE_STAMP = fields("header.stamp"), fields("timestamp")
_DATA, _RAW = fields("data"), fields("width", "height", "step", "encoding")


class ImageReader:
    """Reads the messages of image topics."""

    def __init__(self) -> None:
        self._decoders: dict[Topic, Callable[[bytes], Any]] = {}

    def stamp(self, message: RawMessage) -> int:
        """Return when an image was taken (ns).

        Raises
        ------
        InputError : the topic's schema cannot be parsed.
        DamagedError : the message is damaged.
        """
        ros = message.topic.schema in (schemas.IMAGE, schemas.COMPRESSED_IMAGE)
        stamp = _ROS_STAMP if ros else _FOXGLOVE_STAMP
        return stamp_ns(stamp(self._decode(message)), message.log_time_ns)

    def image(self, message: RawMessage, grey: bool) -> Image:
        """Return the pixels: (height, width) in grey or (height, width, 3) in RGB.

        Raises
        ------
        DamagedError : the message or its pixels are damaged, or of a kind that is not read.
        """
        m = self._decode(message)
        data = _content(_DATA(m))
        if message.topic.schema in (schemas.COMPRESSED_IMAGE, schemas.FOXGLOVE_COMPRESSED_IMAGE):
            return from_compressed(data, grey)
        width, height, step, encoding = _RAW(m)
        size, big_endian = (_whole(width), _whole(height)), bool(getattr(m, "is_bigendian", False))
        return from_raw(data, text(encoding), size, _whole(step), big_endian, grey)

    def _decode(self, message: RawMessage) -> Any:
        decode = self._decoders.get(message.topic)
        if decode is None:
            decode = self._decoders[message.topic] = decoder(message.topic)
        return decode(message.data)


def _content(value: object) -> bytes:
    """Return bytes, which JSON has as text in base 64, or as a list of numbers."""
    if isinstance(value, bytes):
        return value
    if not isinstance(value, str | list):
        raise DamagedError(f"data of {type(value).__name__} is no image")
    with LibraryCalls():
        return base64.b64decode(value, validate=True) if isinstance(value, str) else bytes(value)


def _whole(value: object) -> int:
    if type(value) is not int or value < 0:
        raise DamagedError(f"{value!r} is no size")
    return value
