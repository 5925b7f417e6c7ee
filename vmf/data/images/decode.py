"""Image messages of four kinds, all brought to one: when it was taken, and its pixels."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable
from typing import Any

import cv2

from vmf.data.images.compressed import from_compressed
from vmf.data.images.raw import Image, from_raw
from vmf.data.recording import schemas
from vmf.data.recording.container import RawMessage, Topic
from vmf.data.recording.damage import DAMAGE
from vmf.data.recording.messages import decoder, stamp_ns

# What damaged pixels make the decoders raise beside what damaged messages do.
IMAGE_DAMAGE: tuple[type[Exception], ...] = (
    *DAMAGE,
    OSError,
    SyntaxError,
    AssertionError,
    cv2.error,
    zlib.error,
)


class ImageReader:
    """Reads the messages of image topics."""

    def __init__(self) -> None:
        self._decoders: dict[Topic, Callable[[bytes], Any]] = {}

    def stamp(self, message: RawMessage) -> int:
        """Return when an image was taken (ns).

        Raises
        ------
        InputError : the topic's schema cannot be parsed.
        IMAGE_DAMAGE : the message is damaged.
        """
        m = self._decode(message)
        ros = message.topic.schema in (schemas.IMAGE, schemas.COMPRESSED_IMAGE)
        return stamp_ns(m.header.stamp if ros else m.timestamp, message.log_time_ns)

    def image(self, message: RawMessage, grey: bool) -> Image:
        """Return the pixels: (height, width) in grey or (height, width, 3) in RGB.

        Raises
        ------
        IMAGE_DAMAGE : the message or its pixels are damaged, or of a kind that is not read.
        """
        m = self._decode(message)
        data = base64.b64decode(m.data, validate=True) if isinstance(m.data, str) else bytes(m.data)
        if message.topic.schema in (schemas.COMPRESSED_IMAGE, schemas.FOXGLOVE_COMPRESSED_IMAGE):
            return from_compressed(data, grey)
        size = (_whole(m.width), _whole(m.height))
        big_endian = bool(getattr(m, "is_bigendian", False))
        return from_raw(data, str(m.encoding), size, _whole(m.step), big_endian, grey)

    def _decode(self, message: RawMessage) -> Any:
        decode = self._decoders.get(message.topic)
        if decode is None:
            decode = self._decoders[message.topic] = decoder(message.topic)
        return decode(message.data)


def _whole(value: object) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"{value!r} is no size")
    return value
