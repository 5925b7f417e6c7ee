"""JPEG and PNG images, whose declared size is checked before anything is decoded."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import cv2
import numpy as np
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from vmf.data.images.raw import Image, check_size
from vmf.data.recording.damage import DamagedError, LibraryCalls

# By signature: the `format` field of a message is free text.
_FORMATS: dict[bytes, type[ImageFile]] = {b"\xff\xd8\xff": JpegImageFile, b"\x89PNG\r\n\x1a\n": PngImageFile}


@dataclass(frozen=True)
class Stated:
    """What the head of an image says: `jpeg` or `png`, and (width, height)."""

    form: str
    size: tuple[int, int]


def stated(data: bytes) -> Stated:
    """Return what the head of an image says, which declares a size that is accepted.

    Raises
    ------
    DamagedError : neither JPEG nor PNG, declared larger than accepted, or cut short or damaged already there.
    """
    with _opened(data) as picture:
        width, height = picture.size
        return Stated(str(picture.format).lower(), (width, height))


def from_compressed(data: bytes, grey: bool) -> Image:
    """Return an image (height, width) in grey or (height, width, 3) in RGB.

    Raises
    ------
    DamagedError : neither JPEG nor PNG, declared larger than accepted, or cut short or damaged.
    """
    with _opened(data) as picture:
        with LibraryCalls():
            if grey:
                picture.draft("L", picture.size)
            picture.load()
        if picture.mode.startswith("I"):
            deep = np.asarray(picture).astype(np.uint16)
            shallow = np.ascontiguousarray(deep >> 8, np.uint8)
            return shallow if grey else np.asarray(cv2.cvtColor(shallow, cv2.COLOR_GRAY2RGB), np.uint8)
        if picture.mode == "L" and grey:
            return np.array(picture)
        with LibraryCalls():
            rgb = np.array(picture.convert("RGB"))
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8) if grey else rgb


def _opened(data: bytes) -> ImageFile:
    for signature, kind in _FORMATS.items():
        if data.startswith(signature):
            with LibraryCalls():
                picture = kind(BytesIO(data))
            check_size(*picture.size)
            return picture
    raise DamagedError(f"starts with {data[:4]!r}; accepted: JPEG, PNG")


def encoded(image: Image, form: str, jpeg_quality: int) -> bytes:
    """Return a grey or RGB image as `jpeg` or `png`.

    Raises
    ------
    ValueError : the format has no room for an image of this size.
    """
    pixels = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if form == "jpeg" else [cv2.IMWRITE_PNG_COMPRESSION, 1]
    done, data = cv2.imencode(f".{form}", pixels, options)
    if not done:
        raise ValueError(f"an image of {image.shape[1]}x{image.shape[0]} pixels cannot be written as {form}")
    return data.tobytes()
