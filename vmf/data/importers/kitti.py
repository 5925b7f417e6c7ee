"""KITTI odometry: `image_0`, `image_1` (grey) or `image_2`, `image_3` (colour), `times.txt`, `poses.txt`.

The cameras' calibration is passed on where there is a `calib.txt`; nothing here needs it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vmf.data.importers.base import Streams
from vmf.data.importers.calibration import kitti_cameras
from vmf.data.importers.image_files import ImageList, image_names
from vmf.data.importers.pose_rows import PoseRows
from vmf.data.importers.tables import rows, times
from vmf.data.recording.foxglove import Camera
from vmf.errors import InputError, Loss
from vmf.geometry.camera import R_CAMERA_FROM_BODY
from vmf.spec.base import Model

Floats = NDArray[np.float64]

_CAMERAS = {"grey": ("image_0", "image_1"), "colour": ("image_2", "image_3")}


class KittiOptions(Model):
    """Which cameras, which file of poses, and the axes of S and of the fixed frame.

    `poses` left out is `poses.txt`, or `poses/NN.txt` where the dataset has it. KITTI's poses are those of
    the left grey camera: x right, y down, z forward. `axes: body` turns both frames to x forward, y left,
    z up, which the planar task needs.
    """

    cameras: Literal["grey", "colour"] | None = None
    """`grey` is image_0 and image_1, `colour` image_2 and image_3."""
    poses: str | None = None
    """File of the poses."""
    axes: Literal["camera", "body"] = "camera"
    """Of S and of the fixed frame."""


def look(source: Path, options: KittiOptions) -> Streams:
    """Look at a sequence's folder.

    Raises
    ------
    InputError : a file is missing or wrong, or times and poses differ in number.
    """
    table = source / "times.txt"
    stamps = []
    for row in rows(table, None):
        row.need(1)
        stamps.append(row.time_ns(0))
    poses = PoseRows(_pose_file(source, options.poses))
    turn = np.eye(3) if options.axes == "camera" else R_CAMERA_FROM_BODY
    lines = list(rows(poses.place, None))
    if len(lines) != len(stamps):
        raise InputError(
            f"{poses.place}: found {len(lines)} poses for the {len(stamps)} times of {table}, "
            "as many are accepted"
        )
    for row, time in zip(lines, stamps, strict=True):
        row.need(12)
        T = np.array([row.number(i) for i in range(12)]).reshape(3, 4)
        poses.add_matrix(row.where, time, np.column_stack([turn.T @ T[:, :3] @ turn, turn.T @ T[:, 3]]))
    names = _cameras(source, options.cameras)
    left, right = (_images(source / name, stamps) for name in names)
    images = left[0], right[0]
    cameras, lost = _calibrated(source / "calib.txt", names, images, turn.T)
    return Streams.of(poses, images=images, cameras=cameras, found=left[1] + right[1] + lost)


def _pose_file(source: Path, name: str | None) -> Path:
    if name is not None:
        return source / name
    dataset = source.resolve()
    candidates = (source / "poses.txt", dataset.parent.parent / "poses" / f"{dataset.name}.txt")
    for path in candidates:
        if path.is_file():
            return path
    raise InputError(f"{source}: found neither poses.txt nor {candidates[1]}; poses=FILE names another")


def _cameras(source: Path, chosen: str | None) -> tuple[str, str]:
    for names in _CAMERAS.values() if chosen is None else (_CAMERAS[chosen],):
        if all((source / name).is_dir() for name in names):
            return names
    listed = " or ".join(" and ".join(names) for names in _CAMERAS.values())
    raise InputError(f"{source}: found no folders {listed} ({chosen or 'grey or colour'} cameras)")


def _calibrated(
    path: Path, names: tuple[str, str], images: tuple[ImageList, ImageList], R_S_from_camera: Floats
) -> tuple[tuple[Camera, Camera] | None, tuple[Loss, ...]]:
    """Return the cameras as `calib.txt` has them, if it is there, and what could not be used of it."""
    left, right = images[0].size(), images[1].size()
    if not path.exists() or left is None or right is None:
        return None, ()
    numbers = int(names[0].removeprefix("image_")), int(names[1].removeprefix("image_"))
    try:
        return kitti_cameras(path, numbers, (left, right), R_S_from_camera), ()
    except InputError as error:
        return None, (Loss(str(path.parent), f"calibration not used: {error.lines[0]}", 1),)


def _images(folder: Path, stamps: list[int]) -> tuple[ImageList, tuple[Loss, ...]]:
    """Return the images of a camera, one for each time, and those that have no time."""
    numbered = [path for path in image_names(folder) if path.stem.isdecimal()]
    # Where a number is written in several ways, six digits are KITTI's.
    number_of = {int(path.stem): path for path in sorted(numbered, key=lambda path: len(path.stem) == 6)}
    again = len(numbered) - len(number_of)
    files = [number_of.pop(i, folder / f"{i:06d}.png") for i in range(len(stamps))]
    counts = {
        "images beyond the last time left out": len(number_of),
        "images with the number of another one left out": again,
    }
    return ImageList(folder, files, times(stamps)), tuple(
        Loss(str(folder), what, n) for what, n in counts.items() if n
    )
