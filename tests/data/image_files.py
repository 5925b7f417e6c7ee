"""Recordings of stereo images, written message by message."""

from __future__ import annotations

import base64
from io import BytesIO
from pathlib import Path

import numpy as np
import recording_files as files
from PIL import Image as Pictures

from vmf.data.images import Image, StereoImages
from vmf.data.recording import schemas
from vmf.errors import Loss
from vmf.spec import ImageSource

LEFT, RIGHT = "/left/image", "/right/image"
HEADER = files.ROS_TEXT[schemas.JOINT_STATE].split("effort\n")[1]
files.ROS_TEXT[schemas.COMPRESSED_IMAGE] = schemas.COMPRESSED_IMAGE_TEXT
files.ROS_TEXT[schemas.IMAGE] = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    f"uint8[] data\n{HEADER}"
)


def picture(seed: int = 0, size: tuple[int, int] = (40, 30)) -> Image:
    """A smooth RGB picture of (width, height), so that JPEG keeps it within a few grey levels."""
    v, u = np.mgrid[: size[1], : size[0]]
    waves = [127 + 100 * np.sin((u + seed) / 9 + k) * np.cos(v / 7 + seed) for k in range(3)]
    return np.stack(waves, axis=-1).astype(np.uint8)


def encoded(image: Image, form: str = "png", **options: object) -> bytes:
    buffer = BytesIO()
    Pictures.fromarray(image).save(buffer, form, **options)
    return buffer.getvalue()


def ros_raw(ns: int, image: Image, encoding: str, **fields: object) -> dict[str, object]:
    """A sensor_msgs/msg/Image of bytes as they are; `step`, sizes and endianness may be lied about."""
    height, width = image.shape[:2]
    return {
        "header": files.header(ns),
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": 0,
        "step": image.nbytes // height,
        "data": image.tobytes(),
        **fields,
    }


def ros_compressed(ns: int, data: bytes, form: str = "png") -> dict[str, object]:
    return {"header": files.header(ns), "format": form, "data": data}


def json_compressed(ns: int, data: bytes) -> dict[str, object]:
    text = base64.b64encode(data).decode()
    return {"timestamp": files.stamp(ns), "frame_id": "c", "format": "png", "data": text}


class ImageFile(files.File):
    """A recording with PNG images on two topics."""

    def compressed(self, topic: str, ns: int, data: bytes) -> None:
        self.ros(topic, schemas.COMPRESSED_IMAGE, ros_compressed(ns, data), ns)

    def pair(self, ns: int, seed: int = 0, right_ns: int | None = None) -> None:
        self.compressed(LEFT, ns, encoded(picture(seed)))
        self.compressed(RIGHT, ns if right_ns is None else right_ns, encoded(picture(seed + 1)))


def stereo(path: Path, **source: object) -> StereoImages:
    return StereoImages(path, ImageSource.model_validate(source))


def all_losses(images: StereoImages) -> dict[str, int]:
    """Losses by topic and first words, once all pairs have been read."""
    return {_short(loss): loss.count for loss in images.contents.losses + images.losses}


def _short(loss: Loss) -> str:
    return f"{loss.place}: {loss.what.split(';')[0]}"
