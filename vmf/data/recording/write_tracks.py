"""Write tracks as they are made, beside what is copied from the recording they come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vmf.data.recording import schemas
from vmf.data.recording.container import RawMessage, visit
from vmf.data.recording.encode import stereo_tracks
from vmf.data.recording.foxglove import OBSERVED, Drawn
from vmf.data.recording.observations import read_observations
from vmf.data.recording.output import Output, output
from vmf.data.recording.shown import show_targets
from vmf.data.recording.write import TRACKS_TOPIC
from vmf.errors import Loss

SETTINGS_NAME = "track.yaml"
_QUALITY_DIGITS = 4


def written_quality(quality: NDArray[np.float64]) -> list[float]:
    """Return qualities as they are written: with so few digits that there are only ten thousand."""
    rounded: list[float] = np.round(quality, _QUALITY_DIGITS).tolist()
    return rounded


class TracksWriter:
    """Writes frames of tracks, and whatever else is given to `out`."""

    def __init__(self, out: Output) -> None:
        """Write to an open recording."""
        self.out = out
        self.frames = self.observations = 0

    def frame(
        self,
        time_ns: int,
        stamps_ns: tuple[int, int],
        log_time_ns: int,
        sizes: tuple[tuple[int, int], tuple[int, int]],
        ids: Sequence[str],
        pixels: NDArray[np.float64],
        quality: NDArray[np.float64],
    ) -> None:
        """Write a frame: names, pixels (n, 4) with NaN where not seen, and quality (n,).

        `stamps_ns` are those of the left and the right image, over which the targets are drawn.
        """
        message = stereo_tracks(time_ns, sizes, ids, pixels.tolist(), written_quality(quality))
        self.out.json(TRACKS_TOPIC, schemas.STEREO_TRACKS, schemas.STEREO_TRACKS_TEXT, message, log_time_ns)
        drawn = [Drawn(OBSERVED, ids, pixels)]
        for camera, stamp_ns in enumerate(stamps_ns):
            show_targets(self.out, drawn, camera, stamp_ns, log_time_ns)
        self.frames += 1
        self.observations += len(ids)


@contextmanager
def tracks_writer(path: Path, settings: str) -> Iterator[TracksWriter]:
    """Open a writer; the file appears under its name when it is complete and has been read back.

    `settings`, in YAML, say how the tracks were made and go with them.

    Raises
    ------
    InputError : the file cannot be written.
    RuntimeError : what is read back is not what was written.
    """
    writers: list[TracksWriter] = []
    with output(path, lambda written, _: _check(written, writers[0])) as out:
        writers.append(TracksWriter(out))
        yield writers[0]
        out.attach(SETTINGS_NAME, settings, 0)


def _check(path: Path, written: TracksWriter) -> None:
    frames = observations = 0
    losses: list[Loss] = []

    def see(message: RawMessage) -> None:
        """Read one message at a time: a recording may be longer than fits in memory."""
        nonlocal frames, observations
        seen, lost = read_observations((message,), TRACKS_TOPIC)
        frames += len(seen.times_ns)
        observations += len(seen.frame)
        losses.extend(lost)

    contents = visit(path, lambda topic: topic.name == TRACKS_TOPIC, see)
    losses.extend(contents.losses)
    counts: Counter[str] = Counter()
    for topic, n in contents.counts:
        counts[topic.name] += n
    found = (counts, frames, observations)
    expected = (written.out.counts, written.frames, written.observations)
    if losses or found != expected:
        raise RuntimeError(f"{path}: read back otherwise than written: {found}, {losses}")
