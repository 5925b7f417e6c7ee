"""TUM's trajectories and image lists, for two cameras: times in seconds, names beside them.

TUM's RGB-D sequences have one camera, in `rgb.txt`. Of a stereo pair there are `left.txt` and `right.txt`, or
folders whose files are named by their time.
"""

from __future__ import annotations

from pathlib import Path

from vmf.data.importers.base import Streams
from vmf.data.importers.image_files import ImageList, check_apart, image_names, inside
from vmf.data.importers.pose_rows import PoseRows
from vmf.data.importers.tables import rows, time_ns, times
from vmf.errors import InputError
from vmf.spec.base import Model

_PAIRS = (("left.txt", "right.txt"), ("image_left", "image_right"), ("left", "right"))


class TumOptions(Model):
    """A list (`time name` in each line) or a folder (of files `time.png`) for each camera, and the poses.

    Cameras left out are found where they have one of the usual names. Poses are lines of
    `time tx ty tz qx qy qz qw` (s, m).
    """

    left: str | None = None
    """List or folder of the left camera."""
    right: str | None = None
    """List or folder of the right camera."""
    pose: str = "groundtruth.txt"
    """File of the poses."""


def look(source: Path, options: TumOptions) -> Streams:
    """Look at a sequence's folder.

    Raises
    ------
    InputError : a file is missing or wrong.
    """
    poses = PoseRows(source / options.pose)
    for row in rows(poses.place, None):
        poses.add_row(row, row.time_ns(0))
    left, right = _cameras(source, options)
    check_apart(source, source / left, source / right)
    return Streams.of(poses, images=(_images(source, left), _images(source, right)))


def _cameras(source: Path, options: TumOptions) -> tuple[str, str]:
    for left, right in _PAIRS:
        pair = options.left or left, options.right or right
        if all((source / name).exists() for name in pair):
            return pair
    found = ", ".join(sorted(path.name for path in source.iterdir())[:20])
    listed = " or ".join(f"{left} and {right}" for left, right in _PAIRS)
    raise InputError(f"{source}: found no {listed}; left=NAME and right=NAME name others; found: {found}")


def _images(source: Path, name: str) -> ImageList:
    place = source / name
    stamps: list[int] = []
    files: list[Path] = []
    if place.is_dir():
        for path in image_names(place):
            stamps.append(time_ns(path.name[: -len(path.suffix)], 10**9, f"{path}: name"))
            files.append(path)
    else:
        for row in rows(place, None):
            row.need(2)
            stamps.append(row.time_ns(0))
            files.append(inside(source, row.cells[1], row.where))
    return ImageList(place, files, times(stamps))
