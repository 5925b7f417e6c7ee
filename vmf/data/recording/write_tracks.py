"""Write tracks as they are made, beside what is copied from the recording they come from."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from numpy.typing import NDArray

from vmf.data.recording import schemas
from vmf.data.recording.container import RawMessage, Topic, scan
from vmf.data.recording.observations import read_observations
from vmf.data.recording.write import CHUNK_BYTES, TRACKS_TOPIC, pixel_or_null, replacing

SETTINGS_NAME = "track.yaml"
_QUALITY_DIGITS = 4


class TracksWriter:
    """Writes frames of tracks, and messages of other topics as they are."""

    def __init__(self, writer: Writer) -> None:
        """Write with an MCAP writer that has been started."""
        self._writer = writer
        schema = writer.register_schema(
            schemas.STEREO_TRACKS, SchemaEncoding.JSONSchema, schemas.STEREO_TRACKS_TEXT.encode()
        )
        self._tracks = writer.register_channel(TRACKS_TOPIC, MessageEncoding.JSON, schema)
        self._channels: dict[Topic, int] = {}
        self.copied = self.frames = self.observations = 0

    def copy(self, message: RawMessage) -> None:
        """Write a message of another recording."""
        topic = message.topic
        if topic not in self._channels:
            schema = self._writer.register_schema(topic.schema, topic.schema_encoding, topic.schema_data)
            self._channels[topic] = self._writer.register_channel(
                topic.name, topic.encoding, schema, dict(topic.metadata)
            )
        time = message.log_time_ns
        self._writer.add_message(self._channels[topic], time, message.data, time)
        self.copied += 1

    def frame(
        self,
        time_ns: int,
        log_time_ns: int,
        sizes: tuple[tuple[int, int], tuple[int, int]],
        ids: Sequence[str],
        pixels: NDArray[np.float64],
        quality: NDArray[np.float64],
    ) -> None:
        """Write a frame: names, pixels (n, 4) with NaN where not seen, and quality (n,)."""
        rows = zip(ids, pixels.tolist(), np.round(quality, _QUALITY_DIGITS).tolist(), strict=True)
        message = {
            "timestamp": {"sec": time_ns // 10**9, "nsec": time_ns % 10**9},
            "left_size": list(sizes[0]),
            "right_size": list(sizes[1]),
            "tracks": [
                {"id": name, "left": pixel_or_null(xy[:2]), "right": pixel_or_null(xy[2:]), "quality": q}
                for name, xy, q in rows
            ],
        }
        data = json.dumps(message, allow_nan=False).encode()
        self._writer.add_message(self._tracks, log_time_ns, data, log_time_ns, self.frames)
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
    with replacing(path) as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES)
        writer.start(library="vmf")
        tracks = TracksWriter(writer)
        yield tracks
        writer.add_attachment(0, 0, SETTINGS_NAME, "application/yaml", settings.encode())
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
        _check(Path(file.name), tracks)


def _check(path: Path, written: TracksWriter) -> None:
    contents = scan(path, lambda topic: topic.name == TRACKS_TOPIC)
    seen, losses = read_observations(contents.on(TRACKS_TOPIC), TRACKS_TOPIC)
    copied = sum(n for topic, n in contents.counts if topic.name != TRACKS_TOPIC)
    found = (copied, len(seen.times_ns), len(seen.frame))
    if contents.losses or losses or found != (written.copied, written.frames, written.observations):
        raise RuntimeError(f"{path}: read back otherwise than written: {found}, {contents.losses + losses}")
