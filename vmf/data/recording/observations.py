"""Track messages: pixels of every tracked point, frame by frame."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.data.recording.container import RawMessage
from vmf.data.recording.damage import DamagedError, LibraryCalls, fields, reason
from vmf.data.recording.messages import MAX_NUMBER, MAX_SIDE_PX, decoder, listed, number, stamp_ns, text
from vmf.errors import Loss

# Key of the channel's metadata under which our own writer keeps the order of the targets: order of first
# appearance alone would renumber targets that come into view in another order.
TARGETS_KEY = "vmf.targets"

NOT_SEEN = (np.nan, np.nan)

_MESSAGE, _TRACK = fields("timestamp", "tracks"), fields("id", "left", "right")


@dataclass(frozen=True)
class Observations:
    """F frames with M observations in file order.

    Attributes
    ----------
    times_ns : (F,) int64, the stamps of the messages.
    frame : (M,) int, frame of each observation.
    target : (M,) int, index into `ids`.
    pixels : (M, 4) `x_L, y_L, x_R, y_R` (px), NaN in a camera that did not see the target.
    ids : names of the targets: as the writer listed them, else by first appearance in the file.
    """

    times_ns: NDArray[np.int64]
    frame: NDArray[np.int64]
    target: NDArray[np.int64]
    pixels: NDArray[np.float64]
    ids: tuple[str, ...]
    image_size: tuple[int, int] | None


@dataclass(frozen=True)
class _Frame:
    time_ns: int
    size: tuple[int, int] | None
    ids: list[str]
    pixels: list[tuple[float, ...]]
    invalid: int
    repeated: int


def read_observations(messages: Sequence[RawMessage], place: str) -> tuple[Observations, tuple[Loss, ...]]:
    """Return the observations in all readable messages, and what was dropped.

    A camera's pixel that is NaN or infinite is dropped alone; a message that breaks the schema entirely.
    """
    frames: list[_Frame] = []
    malformed, why, resized = 0, "", 0
    size: tuple[int, int] | None = None
    decode = decoder(messages[0].topic) if messages else None
    for message in messages:
        assert decode is not None
        try:
            frame = _frame(decode(message.data), message.log_time_ns)
        except DamagedError as error:
            malformed, why = malformed + 1, why or reason(error)
            continue
        if size is not None and frame.size not in (None, size):
            resized += 1
            continue
        size = size or frame.size
        frames.append(frame)
    counts = {
        f"malformed track messages dropped; first: {why}": malformed,
        f"frames of another image size than {size} dropped": resized,
        "pixels with NaN, infinite or absurd values dropped": sum(f.invalid for f in frames),
        "second observations of an id within one frame dropped": sum(f.repeated for f in frames),
    }
    losses = tuple(Loss(place, what, n) for what, n in counts.items() if n)
    return _flat(frames, _listed_targets(messages), size), losses


def from_frames(
    frames: Iterable[tuple[int, Sequence[str], NDArray[np.float64]]], size: tuple[int, int] | None
) -> Observations:
    """Return the observations in frames: for each its time, the ids seen, and their pixels (n, 4)."""
    all_frames = [
        _Frame(time, size, list(ids), [tuple(four) for four in pixels.tolist()], 0, 0)
        for time, ids, pixels in frames
    ]
    return _flat(all_frames, [], size)


def _frame(m: object, log_time_ns: int) -> _Frame:
    """Check one message against the schema.

    Raises
    ------
    DamagedError : it does not follow the schema.
    """
    stamp, tracks = _MESSAGE(m)
    time = stamp_ns(stamp, log_time_ns)
    size = _size(m.left_size) if hasattr(m, "left_size") else None
    pixels: dict[str, tuple[float, ...]] = {}
    invalid = repeated = 0
    for track in listed(tracks):
        name, *both = _TRACK(track)
        (left, left_invalid), (right, right_invalid) = map(_pixel, both)
        invalid += left_invalid + right_invalid
        if text(name) in pixels:
            repeated += 1
        else:
            pixels[name] = left + right
    seen = {name: four for name, four in pixels.items() if not (math.isnan(four[0]) and math.isnan(four[2]))}
    return _Frame(time, size, list(seen), list(seen.values()), invalid, repeated)


def _pixel(value: object) -> tuple[tuple[float, float], bool]:
    if value is None:
        return NOT_SEEN, False
    if not isinstance(value, list) or len(value) != 2:
        raise DamagedError(f"pixel {value!r} is neither null nor [x, y]")
    x, y = number(value[0]), number(value[1])
    return ((x, y), False) if abs(x) <= MAX_NUMBER and abs(y) <= MAX_NUMBER else (NOT_SEEN, True)


def _size(value: object) -> tuple[int, int]:
    if not isinstance(value, list) or len(value) != 2 or not all(map(_is_side, value)):
        raise DamagedError(f"image size {value!r} is not [width, height], from 1 to {MAX_SIDE_PX} each")
    return value[0], value[1]


def _is_side(value: object) -> bool:
    return type(value) is int and 0 < value <= MAX_SIDE_PX


def _listed_targets(messages: Sequence[RawMessage]) -> list[str]:
    written = dict(messages[0].topic.metadata).get(TARGETS_KEY, "[]") if messages else "[]"
    try:
        with LibraryCalls():
            ids = json.loads(written)
    except DamagedError:
        return []
    return ids if isinstance(ids, list) and all(isinstance(name, str) for name in ids) else []


def _flat(frames: list[_Frame], listed: list[str], size: tuple[int, int] | None) -> Observations:
    names = [name for frame in frames for name in frame.ids]
    ids = tuple(dict.fromkeys([*listed, *names]))
    number_of = {name: i for i, name in enumerate(ids)}
    return Observations(
        np.array([f.time_ns for f in frames], np.int64),
        np.repeat(np.arange(len(frames)), [len(f.ids) for f in frames]),
        np.array([number_of[name] for name in names], np.int64),
        np.array([four for frame in frames for four in frame.pixels], float).reshape(-1, 4),
        ids,
        size,
    )
