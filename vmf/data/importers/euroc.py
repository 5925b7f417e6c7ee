"""EuRoC MAV: `mav0/cam0`, `mav0/cam1` and a folder with poses, each with its `data.csv` in nanoseconds.

The cameras' calibration is passed on where each folder has its `sensor.yaml`; nothing here needs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vmf.data.importers.base import Streams
from vmf.data.importers.calibration import euroc_body, euroc_camera
from vmf.data.importers.image_files import ImageList, check_apart, inside
from vmf.data.importers.pose_rows import PoseRows
from vmf.data.importers.tables import rows, times
from vmf.data.recording.foxglove import Camera
from vmf.errors import InputError, Loss
from vmf.spec.base import Model

_DESCRIPTION = "sensor.yaml"
_POSES = ("state_groundtruth_estimate0", "vicon0")
# Time, position, quaternion w x y z; further columns are velocities and biases.
_ORDER = (1, 2, 3, 5, 6, 7, 4)


class EurocOptions(Model):
    """Which folders of `mav0` are used; `pose` is found by itself where it has its usual name."""

    left: str = "cam0"
    """Folder of the left camera."""
    right: str = "cam1"
    """Folder of the right camera."""
    pose: str | None = None
    """Folder of the poses."""


def look(source: Path, options: EurocOptions) -> Streams:
    """Look at a sequence, given by its folder or by `mav0` in it.

    Raises
    ------
    InputError : a file is missing or wrong.
    """
    folder = source / "mav0" if (source / "mav0").is_dir() else source
    table = _pose_table(folder, options.pose)
    poses = PoseRows(table)
    for row in rows(table, ","):
        row.need(max(_ORDER) + 1)
        poses.add_row(row, row.time_ns(0, 1), _ORDER)
    check_apart(source, folder / options.left, folder / options.right)
    images = _images(folder / options.left), _images(folder / options.right)
    cameras, found = _calibrated(folder, table.parent, (options.left, options.right))
    return Streams.of(poses, images=images, cameras=cameras, found=found)


def _calibrated(
    folder: Path, poses: Path, names: tuple[str, str]
) -> tuple[tuple[Camera, Camera] | None, tuple[Loss, ...]]:
    """Return the cameras as their folders describe them, if they do, and what could not be used of that."""
    left, right = (folder / name / _DESCRIPTION for name in names)
    if not (left.exists() and right.exists()):
        return None, ()
    try:
        # The poses of the body itself need no description.
        described = (poses / _DESCRIPTION).exists()
        body = (
            euroc_body(poses / _DESCRIPTION) if described else np.eye(4) if poses.name == _POSES[0] else None
        )
        return (euroc_camera(left, body), euroc_camera(right, body)), ()
    except InputError as error:
        return None, (Loss(str(folder), f"calibration not used: {error.lines[0]}", 1),)


def _pose_table(folder: Path, name: str | None) -> Path:
    names = _POSES if name is None else (name,)
    for candidate in names:
        if (folder / candidate / "data.csv").is_file():
            return folder / candidate / "data.csv"
    listed = " or ".join(f"{candidate}/data.csv" for candidate in names)
    raise InputError(f"{folder}: found no {listed} with poses; another folder is named by pose=FOLDER")


def _images(folder: Path) -> ImageList:
    table = folder / "data.csv"
    stamps: list[int] = []
    files: list[Path] = []
    for row in rows(table, ","):
        row.need(2)
        stamps.append(row.time_ns(0, 1))
        files.append(inside(folder / "data", row.cells[1], row.where))
    return ImageList(table, files, times(stamps))
