"""Pixels of targets out of a table or arrays, checked as those of a recording are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vmf.data.recording.messages import MAX_NUMBER
from vmf.data.recording.observations import Observations
from vmf.data.recording.synchronise import in_order
from vmf.errors import InputError, Loss


@dataclass(frozen=True)
class Usable:
    """Observations in order of time, what was lost, and what was repaired."""

    seen: Observations
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]


def sightings(place: Path, raw: Observations) -> Usable:
    """Return observations (frames in any order) in order of time, without what cannot be used.

    A camera's pixel that is half there, infinite or absurd is dropped alone.

    Raises
    ------
    InputError : nothing was seen.
    """
    pairs = raw.pixels.reshape(-1, 2, 2)
    usable: NDArray[np.bool_] = np.all(np.abs(pairs) <= MAX_NUMBER, axis=2)
    invalid = int((~usable & ~np.isnan(pairs).all(axis=2)).sum())
    pixels = np.where(usable[..., None], pairs, np.nan).reshape(-1, 4)
    first = np.zeros(len(pixels), bool)
    first[np.unique(np.stack([raw.frame, raw.target]), axis=1, return_index=True)[1]] = True
    order = in_order(raw.times_ns, str(place))
    new_frame = np.full(len(raw.times_ns), -1)
    new_frame[order.keep] = np.arange(len(order.keep))
    keep = usable.any(axis=1) & first & (new_frame[raw.frame] >= 0)
    if not keep.any():
        raise InputError(f"{place}: found no pixel of any target, at least one is accepted")
    counts = {
        "pixels with NaN in one coordinate, infinite or absurd values dropped": invalid,
        "second observations of an id within one frame dropped": int((~first).sum()),
    }
    losses = (Loss(str(place), what, n) for what, n in counts.items() if n)
    return Usable(
        Observations(
            raw.times_ns[order.keep],
            new_frame[raw.frame[keep]],
            raw.target[keep],
            pixels[keep],
            raw.ids,
            raw.image_size,
        ),
        (*order.losses, *losses),
        order.repairs,
    )


def from_dense(
    times_ns: NDArray[np.int64],
    pixels: NDArray[np.float64],
    ids: tuple[str, ...],
    image_size: tuple[int, int] | None,
) -> Observations:
    """Return the observations in pixels (N, K, 4), NaN where a camera does not see the target."""
    frame, target = np.nonzero(~np.isnan(pixels).all(axis=2))
    return Observations(times_ns, frame, target, pixels[frame, target], ids, image_size)
