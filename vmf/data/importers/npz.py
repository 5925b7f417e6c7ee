"""NumPy's `.npz` with poses and tracks, one of each a frame.

| array | shape | what |
|---|---|---|
| `times_s`, or `times_ns` as integers | (N,) | time of each frame |
| `poses`, or `position_m` and `quaternion_xyzw` | (N, 4, 4), or (N, 3) and (N, 4) | of S in a fixed frame |
| `pixels` | (N, K, 4) | `x_L, y_L, x_R, y_R` (px), NaN in a camera that does not see the target |
| `ids`, may be left out | (K,) of text | names of the targets |
| `image_size`, may be left out | (2,) of integers | width, height (px) |
"""

from __future__ import annotations

import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vmf.data.importers.base import Streams
from vmf.data.importers.pose_rows import PoseRows
from vmf.data.importers.sightings import from_dense, sightings
from vmf.data.importers.tables import END_NS
from vmf.data.recording.damage import DamagedError, LibraryCalls, reason
from vmf.data.recording.messages import MAX_SIDE_PX, is_unicode
from vmf.errors import InputError
from vmf.regular_file import open_regular
from vmf.spec.base import Model

_ARRAYS = ("times_s", "times_ns", "poses", "position_m", "quaternion_xyzw", "pixels", "ids", "image_size")
# All numbers become doubles, and what is made of them on the way takes about eight times as much.
_MAX_BYTES = 192 * 2**20
_MAX_FRAMES = 2**20
# Pairs of which one is enough, and two may contradict each other.
_ONE_OF = (("times_s", "times_ns"), ("poses", "position_m"), ("poses", "quaternion_xyzw"))

Arrays = dict[str, NDArray[Any]]


class NpzOptions(Model):
    """There is nothing to set."""


def look(source: Path, options: NpzOptions) -> Streams:
    """Look at a file.

    Raises
    ------
    InputError : it is no such file, or an array is missing, unknown or of a wrong shape.
    """
    arrays = _load(source)
    times_ns = _times(source, arrays)
    n = len(times_ns)
    poses = PoseRows(source)
    if "poses" in arrays:
        for i, T in enumerate(_floats(source, arrays, "poses", (n, 4, 4))):
            poses.add_matrix(f"{source}: poses[{i}]", int(times_ns[i]), T)
    else:
        position = _floats(source, arrays, "position_m", (n, 3))
        quaternion = _floats(source, arrays, "quaternion_xyzw", (n, 4))
        for i, row in enumerate(np.hstack([position, quaternion]).tolist()):
            poses.add(f"{source}: quaternion_xyzw[{i}]", int(times_ns[i]), tuple(row))
    pixels = _floats(source, arrays, "pixels", (n, None, 4))
    ids = _ids(source, arrays, pixels.shape[1])
    raw = from_dense(times_ns, pixels, ids, _image_size(source, arrays))
    return Streams.of(poses, tracks=sightings(source, raw))


def _load(source: Path) -> Arrays:
    try:
        with open_regular(source) as file:
            with LibraryCalls():
                archive = zipfile.ZipFile(file)
            with archive:
                members = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
                _check_names(source, tuple(members))
                _check_sizes(source, {name: _declared(archive, entry) for name, entry in members.items()})
            file.seek(0)
            with LibraryCalls(), np.load(file, allow_pickle=False) as arrays:
                return {name: np.asarray(arrays[name]) for name in members}
    except FileNotFoundError:
        raise InputError(f"{source}: no such file; an .npz is accepted") from None
    except zipfile.BadZipFile as error:
        raise InputError(f"{source}: is no .npz, or damaged: {reason(error)}") from None
    except OSError as error:
        raise InputError(f"{source}: cannot be read: {error.strerror or error}") from None
    except DamagedError as error:
        raise InputError(f"{source}: cannot be read: {reason(error)}") from None


def _check_names(source: Path, names: tuple[str, ...]) -> None:
    for name in names:
        if name not in _ARRAYS:
            raise InputError(f"{source}: found an array {name!r}; accepted: {', '.join(_ARRAYS)}")
    for one, other in _ONE_OF:
        if one in names and other in names:
            raise InputError(f"{source}: found both {one} and {other}, one of them is accepted")


@dataclass(frozen=True)
class _Declared:
    """What the head of an array says about it."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def bytes_as_doubles(self) -> int:
        return math.prod(self.shape) * max(self.dtype.itemsize, np.dtype(np.float64).itemsize)


def _declared(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> _Declared:
    with LibraryCalls(), archive.open(entry) as head:
        read = _HEADS.get(np.lib.format.read_magic(head))
        if read is None:
            raise DamagedError(f"{entry.filename}: of a version that NumPy writes for records alone")
        shape, _, dtype = read(head)
    return _Declared(shape, dtype)


_HEADS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def _check_sizes(source: Path, declared: dict[str, _Declared]) -> None:
    """Refuse, before any memory is taken for it, what is too large."""
    total = sum(array.bytes_as_doubles for array in declared.values())
    if total > _MAX_BYTES:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in declared.items())
        raise InputError(f"{source}: found {shapes}, {total} bytes as doubles, {_MAX_BYTES} are accepted")
    for name in ("times_s", "times_ns"):
        if name in declared and math.prod(declared[name].shape) > _MAX_FRAMES:
            found = declared[name].shape
            raise InputError(f"{source}: {name}: found shape {found}, at most {_MAX_FRAMES} are accepted")


def _times(source: Path, arrays: Arrays) -> NDArray[np.int64]:
    if "times_ns" in arrays:
        times = _of(source, arrays, "times_ns", (None,), "iu").astype(np.int64)
    else:
        seconds = _floats(source, arrays, "times_s", (None,))
        usable = np.isfinite(seconds) & (np.abs(seconds) < END_NS / 1e9)
        times = np.where(usable, np.round(np.where(usable, seconds, 0.0) * 1e9), -1).astype(np.int64)
    wrong = np.flatnonzero((times < 0) | (times >= END_NS))
    if len(wrong):
        name = "times_ns" if "times_ns" in arrays else "times_s"
        found = arrays[name][wrong[0]]
        raise InputError(f"{source}: {name}[{wrong[0]}]: found {found}, a time from 0 to 2^32 s is accepted")
    return times


def _ids(source: Path, arrays: Arrays, count: int) -> tuple[str, ...]:
    if "ids" not in arrays:
        return tuple(str(i) for i in range(count))
    ids = tuple(map(str, _of(source, arrays, "ids", (count,), "U").tolist()))
    if strange := [name for name in ids if not is_unicode(name)]:
        raise InputError(f"{source}: ids: found {strange[0]!r}, a text in Unicode is accepted")
    if len(set(ids)) < count:
        raise InputError(f"{source}: ids: found a name twice, different names are accepted")
    return ids


def _image_size(source: Path, arrays: Arrays) -> tuple[int, int] | None:
    if "image_size" not in arrays:
        return None
    width, height = _of(source, arrays, "image_size", (2,), "iu").tolist()
    if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX):
        raise InputError(
            f"{source}: image_size: found {width}, {height}, numbers from 1 to {MAX_SIDE_PX} are accepted"
        )
    return width, height


def _floats(source: Path, arrays: Arrays, name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    return _of(source, arrays, name, shape, "fiu").astype(np.float64)


def _of(source: Path, arrays: Arrays, name: str, shape: tuple[int | None, ...], kinds: str) -> NDArray[Any]:
    """Return an array of this shape (None: any) and of one of NumPy's kinds of numbers or text."""
    if name not in arrays:
        raise InputError(f"{source}: no array {name}; found: {', '.join(arrays) or 'none'}")
    array = arrays[name]
    fits = len(array.shape) == len(shape) and all(
        n in (None, m) for n, m in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype.kind not in kinds:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        what = "text" if kinds == "U" else "integers" if kinds == "iu" else "numbers"
        raise InputError(
            f"{source}: {name}: found {array.dtype} of shape {array.shape}, "
            f"{what} of shape ({wanted}) are accepted"
        )
    return array
