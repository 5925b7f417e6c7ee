"""Which messages of a recording belong to which frames of the tracks that were read from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vmf.data.images.decode import ImageReader
from vmf.data.images.topics import stereo_topics
from vmf.data.recording import RecordingData, schemas
from vmf.data.recording.container import Contents, RawMessage
from vmf.data.recording.damage import DamagedError, fields
from vmf.data.recording.messages import decoder, stamp_ns
from vmf.errors import InputError
from vmf.spec import ImageSource
from vmf.spec.model import Recording

_STAMP = fields("timestamp")


@dataclass(frozen=True)
class Moment:
    """What a message stands for.

    Attributes
    ----------
    time_ns : when it was taken.
    frame : the frame of the tracks that it belongs to, None if none.
    cameras : whose image is drawn over now.
    ticks : whether a frame's motion and errors are written with it.
    """

    time_ns: int
    frame: int | None
    cameras: tuple[int, ...]
    ticks: bool


class Clock:
    """Tells which messages of a recording belong to which frames of its tracks.

    Attributes
    ----------
    note : why there is nothing to draw over, empty if there is.
    """

    def __init__(self, contents: Contents, source: Recording, data: RecordingData) -> None:
        """Find out which messages there are to tell the time by."""
        self._times = data.tracks.times_ns
        given = source.images or ImageSource()
        self._tolerance_ns = round(given.pair_tolerance_s * 1e9)
        self.note = ""
        self._images: tuple[str, ...] = ()
        try:
            self._images = stereo_topics(contents, given.left, given.right)
        except InputError:
            shown = [t.name for t, n in contents.counts if t.schema in schemas.IMAGE_SCHEMAS and n]
            self.note = (
                f"no two of the image topics {', '.join(shown)} are a stereo pair by their names; "
                "targets are drawn at the times of the tracks"
                if shown
                else "the recording has no images, its targets are drawn without"
            )
        self._tracks = None if source.tracks is None else source.tracks.topic
        self._reader = ImageReader()
        decoders = (decoder(t) for t, _ in contents.counts if t.name == self._tracks)
        self._decode = next(decoders, None)

    def moment(self, message: RawMessage) -> Moment | None:
        """Return what a message stands for, None for one that is of no interest or damaged."""
        name = message.topic.name
        try:
            if name in self._images:
                camera = self._images.index(name)
                time = self._reader.stamp(message)
                ticks = self._tracks is None and camera == 0
                return Moment(time, self._frame(time, self._tolerance_ns), (camera,), ticks)
            if name == self._tracks and self._decode is not None:
                time = stamp_ns(_STAMP(self._decode(message.data)), message.log_time_ns)
                return Moment(time, self._frame(time, 0), () if self._images else (0, 1), True)
        except (DamagedError, InputError):
            pass  # reading the recording has counted it
        return None

    def _frame(self, time_ns: int, tolerance_ns: int) -> int | None:
        after = int(np.searchsorted(self._times, time_ns))
        near = [i for i in (after - 1, after) if 0 <= i < len(self._times)]
        best = min(near, key=lambda i: abs(int(self._times[i]) - time_ns))
        return best if abs(int(self._times[best]) - time_ns) <= tolerance_ns else None
