"""Uncompressed images: from the bytes and the encoding a message names to grey or RGB pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vmf.data.recording.damage import DamagedError, LibraryCalls

Image = NDArray[np.uint8]

# 8192 × 4096; two cameras, the pair at work and the next one stay below 1 GiB even in colour.
MAX_PIXELS = 2**25


@dataclass(frozen=True)
class _Layout:
    """How pixels lie in memory: `channels` numbers of `item_bytes` each, and how OpenCV converts them."""

    channels: int
    to_rgb: int | None
    to_grey: int | None
    item_bytes: int = 1
    even_width: bool = False


_GREY = _Layout(1, cv2.COLOR_GRAY2RGB, None)
_RGB = _Layout(3, None, cv2.COLOR_RGB2GRAY)
_BGR = _Layout(3, cv2.COLOR_BGR2RGB, cv2.COLOR_BGR2GRAY)
_RGBA = _Layout(4, cv2.COLOR_RGBA2RGB, cv2.COLOR_RGBA2GRAY)
_BGRA = _Layout(4, cv2.COLOR_BGRA2RGB, cv2.COLOR_BGRA2GRAY)
_UYVY = _Layout(2, cv2.COLOR_YUV2RGB_UYVY, cv2.COLOR_YUV2GRAY_UYVY, even_width=True)
_YUYV = _Layout(2, cv2.COLOR_YUV2RGB_YUY2, cv2.COLOR_YUV2GRAY_YUY2, even_width=True)
_BAYER = {
    "rggb": _Layout(1, cv2.COLOR_BayerRGGB2RGB, cv2.COLOR_BayerRGGB2GRAY),
    "bggr": _Layout(1, cv2.COLOR_BayerBGGR2RGB, cv2.COLOR_BayerBGGR2GRAY),
    "gbrg": _Layout(1, cv2.COLOR_BayerGBRG2RGB, cv2.COLOR_BayerGBRG2GRAY),
    "grbg": _Layout(1, cv2.COLOR_BayerGRBG2RGB, cv2.COLOR_BayerGRBG2GRAY),
}
_LAYOUTS: dict[str, _Layout] = {
    "mono8": _GREY,
    "8UC1": _GREY,
    "mono16": replace(_GREY, item_bytes=2),
    "16UC1": replace(_GREY, item_bytes=2),
    "rgb8": _RGB,
    "rgb16": replace(_RGB, item_bytes=2),
    "bgr8": _BGR,
    "8UC3": _BGR,
    "bgr16": replace(_BGR, item_bytes=2),
    "rgba8": _RGBA,
    "bgra8": _BGRA,
    "8UC4": _BGRA,
    "yuv422": _UYVY,
    "uyvy": _UYVY,
    "yuv422_yuy2": _YUYV,
    "yuyv": _YUYV,
    **{f"bayer_{pattern}8": layout for pattern, layout in _BAYER.items()},
    **{f"bayer_{pattern}16": replace(layout, item_bytes=2) for pattern, layout in _BAYER.items()},
}


def check_size(width: int, height: int) -> None:
    """Refuse a declared image size before any memory is taken for it.

    Raises
    ------
    DamagedError : no pixels, or more than `MAX_PIXELS`.
    """
    if width < 1 or height < 1:
        raise DamagedError(f"declares {width}x{height} pixels")
    if width * height > MAX_PIXELS:
        raise DamagedError(f"declares {width}x{height} pixels, more than the {MAX_PIXELS} accepted")


def from_raw(
    data: bytes, encoding: str, size: tuple[int, int], step: int, big_endian: bool, grey: bool
) -> Image:
    """Return an image (height, width) in grey or (height, width, 3) in RGB.

    Parameters
    ----------
    data : rows of `step` bytes each.
    encoding : its name in ROS or Foxglove.
    size : (width, height) px.
    big_endian : order of bytes in numbers of 16 bit; of these the upper 8 bit are kept.

    Raises
    ------
    DamagedError : an unknown encoding, or sizes that contradict each other.
    """
    layout = _LAYOUTS.get(encoding)
    if layout is None:
        raise DamagedError(f"encoding {encoding!r}; accepted: {', '.join(_LAYOUTS)}")
    width, height = size
    check_size(width, height)
    row_bytes = width * layout.channels * layout.item_bytes
    if step < row_bytes:
        raise DamagedError(f"declares rows of {step} bytes, {width} pixels of {encoding} need {row_bytes}")
    if len(data) < step * height:
        raise DamagedError(f"declares {height} rows of {step} bytes but holds {len(data)} bytes")
    if layout.even_width and width % 2:
        raise DamagedError(f"declares {width} columns, {encoding} needs an even number")
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, :row_bytes]
    if layout.item_bytes == 2:
        upper = 0 if big_endian else 1
        rows = rows[:, upper::2]
    pixels = rows.reshape(height, width, layout.channels) if layout.channels > 1 else rows
    code = layout.to_grey if grey else layout.to_rgb
    whole = np.ascontiguousarray(pixels)
    if code is None:
        return whole.copy() if whole.base is not None else whole
    with LibraryCalls(cv2.error):
        return np.asarray(cv2.cvtColor(whole, code), np.uint8)
