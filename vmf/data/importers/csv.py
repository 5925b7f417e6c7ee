"""CSV with named columns: `pose.csv` and `tracks.csv`, or both in one file.

| columns | what |
|---|---|
| `time_s`, or `time_ns` as integers | in each file |
| `x_m, y_m, z_m, qx, qy, qz, qw` | pose of S in the fixed frame |
| `id, x_L_px, y_L_px, x_R_px, y_R_px` | a target and its pixels; empty in a camera that does not see it |

A row without an id says that the frame of its time shows no target. Where both are in one file, rows of the
same time have the same pose. Other columns are left alone.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from vmf.data.importers.base import Streams
from vmf.data.importers.pose_rows import PoseRows
from vmf.data.importers.sightings import Usable, sightings
from vmf.data.importers.tables import Row, columns, rows, times
from vmf.data.recording.messages import MAX_SIDE_PX
from vmf.data.recording.observations import Observations
from vmf.errors import InputError
from vmf.spec.base import Model

_MOST_SHARED = 1_000_000
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_PIXELS = ("x_L_px", "y_L_px", "x_R_px", "y_R_px")

Pixel = Annotated[int, Field(ge=1, le=MAX_SIDE_PX)]


class CsvOptions(Model):
    """Names of the two files where SOURCE is a folder, and what no column says: the size of the images."""

    pose: str = "pose.csv"
    """File of the poses."""
    tracks: str = "tracks.csv"
    """File of the tracks."""
    image_size: tuple[Pixel, Pixel] | None = None
    """Width and height (px)."""


def look(source: Path, options: CsvOptions) -> Streams:
    """Look at a folder with two files, or at one file with both.

    Raises
    ------
    InputError : a file or a column is missing or wrong.
    """
    folder = source.is_dir()
    pose, tracks = (source / options.pose, source / options.tracks) if folder else (source, source)
    return Streams.of(_poses(pose, shared=not folder), tracks=_tracks(tracks, options.image_size))


def _poses(path: Path, *, shared: bool) -> PoseRows:
    poses = PoseRows(path)
    known: dict[int, tuple[str, str]] = {}
    order: tuple[int, ...] = ()
    for row, time, header in _timed(path):
        order = order or columns(header, _POSE)
        if shared:
            cells = ",".join(row.cells[i] for i in order)
            if time in known:
                first, pose = known[time]
                if pose != cells:
                    raise InputError(f"{row.where}: found another pose than {first} has at the same time")
                continue
            if len(known) == _MOST_SHARED:
                raise InputError(
                    f"{row.where}: more than {_MOST_SHARED} poses, as many are accepted with tracks"
                )
            known[time] = row.where, cells
        poses.add_row(row, time, order)
    return poses


def _tracks(path: Path, image_size: tuple[int, int] | None) -> Usable:
    frames: dict[int, int] = {}
    targets: dict[str, int] = {}
    # Arrays take a tenth of the memory of lists.
    seen, pixels = array("q"), array("d")
    at: tuple[int, ...] = ()
    for row, time, header in _timed(path):
        at = at or columns(header, ("id", *_PIXELS))
        frame = frames.setdefault(time, len(frames))
        name = row.cells[at[0]]
        code = [row.number(i) if row.cells[i] else np.nan for i in at[1:]]
        if name:
            seen.extend((frame, targets.setdefault(name, len(targets))))
            pixels.extend(code)
        elif not np.isnan(code).all():
            raise InputError(f"{row.where}: found pixels without an id, an id is accepted")
    found = np.array(seen, np.int64).reshape(-1, 2)
    codes = np.array(pixels, float).reshape(-1, 4)
    raw = Observations(times(frames), found[:, 0], found[:, 1], codes, tuple(targets), image_size)
    return sightings(path, raw)


def _timed(path: Path) -> Iterator[tuple[Row, int, Row]]:
    """Yield the rows with their times, and the header with each."""
    table = rows(path, ",")
    header = next(table, None)
    if header is None:
        raise InputError(f"{path}: is empty, a line with names of columns is accepted")
    if {"time_s", "time_ns"} <= set(header.cells):
        raise InputError(f"{header.where}: found both time_s and time_ns, one of them is accepted")
    unit_ns = 1 if "time_ns" in header.cells else 10**9
    (at,) = columns(header, ("time_ns" if unit_ns == 1 else "time_s",))
    for row in table:
        row.need(len(header.cells))
        yield row, row.time_ns(at, unit_ns), header
