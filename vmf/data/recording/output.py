"""Write an MCAP recording message by message: small chunks, checksums, an index, and how it was made."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from google.protobuf.message import Message
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set
from mcap_ros2._dynamic import serialize_dynamic

from vmf.data.recording.container import RawMessage, Topic
from vmf.errors import InputError

CHUNK_BYTES = 64 * 1024
# Name of the metadata record that says what an attachment holds.
METADATA_NAME = "vmf"


class Output:
    """An MCAP file being written; no more than one chunk is held in memory.

    Attributes
    ----------
    counts : messages written so far, by topic.
    """

    def __init__(self, writer: Writer) -> None:
        """Write with an MCAP writer that has been started."""
        self._writer = writer
        self._channels: dict[Topic | tuple[str, str], int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._encoders: dict[str, Callable[[Any], bytes]] = {}
        self.counts: Counter[str] = Counter()

    def copy(self, message: RawMessage) -> None:
        """Write a message of another recording as it is."""
        topic = message.topic
        if topic not in self._channels:
            schema = self._schema(topic.schema, topic.schema_encoding, topic.schema_data)
            self._channels[topic] = self._writer.register_channel(
                topic.name, topic.encoding, schema, dict(topic.metadata)
            )
        self._add(self._channels[topic], topic.name, message.log_time_ns, message.data)

    def ros(self, topic: str, schema: str, text: str, content: Mapping[str, object], time_ns: int) -> None:
        """Write a ROS 2 message; `text` is the definition of its `schema`."""
        channel = self._channel(
            topic, schema, (MessageEncoding.CDR, SchemaEncoding.ROS2), lambda: text.encode()
        )
        if schema not in self._encoders:
            self._encoders[schema] = serialize_dynamic(schema, text)[schema]
        self._add(channel, topic, time_ns, self._encoders[schema](content))

    def protobuf(self, topic: str, message: Message, time_ns: int) -> None:
        """Write a protobuf message."""
        name = message.DESCRIPTOR.full_name

        def text() -> bytes:
            return bytes(build_file_descriptor_set(type(message)).SerializeToString())

        channel = self._channel(topic, name, (MessageEncoding.Protobuf, SchemaEncoding.Protobuf), text)
        self._add(channel, topic, time_ns, message.SerializeToString())

    def json(
        self,
        topic: str,
        schema: str,
        text: str,
        content: object,
        time_ns: int,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """Write a JSON message; `text` is the JSON schema named `schema`.

        Raises
        ------
        ValueError : the content holds a number that is not finite.
        """
        encodings = (MessageEncoding.JSON, SchemaEncoding.JSONSchema)
        channel = self._channel(topic, schema, encodings, lambda: text.encode(), metadata)
        self._add(channel, topic, time_ns, json.dumps(content, allow_nan=False).encode())

    def attach(self, name: str, text: str, time_ns: int, **more: str) -> None:
        """Attach a YAML text; a metadata record names it, its SHA-256 and whatever `more` there is to say."""
        data = text.encode()
        self._writer.add_attachment(0, time_ns, name, "application/yaml", data)
        said = {"attachment": name, "sha256": hashlib.sha256(data).hexdigest(), **more}
        self._writer.add_metadata(METADATA_NAME, said)

    def _channel(
        self,
        topic: str,
        schema: str,
        encodings: tuple[str, str],
        text: Callable[[], bytes],
        metadata: Mapping[str, str] | None = None,
    ) -> int:
        key = topic, schema
        if key not in self._channels:
            number = self._schema(schema, encodings[1], text())
            self._channels[key] = self._writer.register_channel(
                topic, encodings[0], number, dict(metadata or {})
            )
        return self._channels[key]

    def _schema(self, name: str, encoding: str, text: bytes) -> int:
        if not (name or encoding or text):
            return 0  # a channel without a schema
        key = name, encoding, text
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(name, encoding, text)
        return self._schemas[key]

    def _add(self, channel: int, topic: str, time_ns: int, data: bytes) -> None:
        self._writer.add_message(channel, time_ns, data, time_ns, self.counts[topic])
        self.counts[topic] += 1


@contextmanager
def output(path: Path, check: Callable[[Path, Output], None] | None = None) -> Iterator[Output]:
    """Open a recording to be written; it appears under its name when it is complete.

    `check` is shown the finished file under its temporary name.

    Raises
    ------
    InputError : the file cannot be written.
    """
    with replacing(path) as file:
        writer = Writer(file, chunk_size=CHUNK_BYTES, enable_crcs=True, enable_data_crcs=True)
        writer.start(library="vmf")
        out = Output(writer)
        yield out
        writer.finish()  # type: ignore[no-untyped-call]
        if check is not None:
            file.flush()
            check(Path(file.name), out)


def check_target(path: Path, option: str, inputs: tuple[Path, ...] = ()) -> None:
    """Check that a recording may be written to `path`, before any work is done.

    Raises
    ------
    InputError : its name does not end in `.mcap`, it is a directory or one of the `inputs`, or the directory
        that it is to be in is missing.
    """
    if path.suffix != ".mcap":
        raise InputError(f"{option} {path}: found a name without .mcap, FILE.mcap is accepted")
    if path.is_dir():
        raise InputError(f"{option} {path}: is a directory, FILE.mcap is accepted")
    if path.exists() and not path.is_file():
        raise InputError(f"{option} {path}: is no regular file, FILE.mcap is accepted")
    if any(path.exists() and given.exists() and path.samefile(given) for given in inputs):
        raise InputError(f"{option} {path}: is the recording itself, another file is accepted")
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: cannot be written: there is no directory {path.parent}")


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Open a temporary file beside `path` that takes its place if all goes well, and vanishes if not."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)
