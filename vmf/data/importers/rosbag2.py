"""Rosbag2: a directory with `metadata.yaml`, or one file of it, stored as MCAP or in SQLite.

Its messages are passed on as they are, those of the topics that a recording is read from.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

from mcap.well_known import MessageEncoding, SchemaEncoding
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_typestore
from zstandard import ZstdDecompressor, ZstdError

from vmf.data.recording import schemas
from vmf.data.recording.chunks import MAX_RECORD_BYTES, unpacked
from vmf.data.recording.container import RawMessage, Topic, oversized
from vmf.data.recording.damage import DamagedError, LibraryCalls, each, reason
from vmf.data.recording.messages import MAX_TIME_NS
from vmf.data.recording.output import Output
from vmf.errors import InputError, Loss
from vmf.regular_file import check_regular
from vmf.spec.base import Model

_NEEDED = (*schemas.POSE_SCHEMAS, *schemas.IMAGE_SCHEMAS, schemas.JOINT_STATE)
# Of a compressed file. Recordings shrink to a tenth, or to a hundredth where next to nothing happens.
_MOST_TIMES, _MOST_OF_A_SMALL_FILE_BYTES = 1000, 2**26
_PART_BYTES = 2**20
# Of SQLite's machine, which takes some twenty for a row: what it runs through may lead it round in circles.
_MOST_STEPS, _STEPS_AT_ONCE = 10**9, 10**6
# What the library counts when it opens a file.
_COUNTS = (
    "SELECT count(messages.id) FROM topics LEFT JOIN messages ON topics.id == messages.topic_id "
    "GROUP BY topics.id",
    "SELECT MIN(timestamp), MAX(timestamp), COUNT(*) FROM messages",
)
_SQLITE_LIMIT_LENGTH = 0  # SQLite's number for the largest value in a row
_READ = (*_NEEDED, *schemas.CALIBRATION_SCHEMAS)


class Rosbag2Options(Model):
    """Which topics are passed on; without any, all that carry poses, joints, images or calibrations."""

    topics: tuple[str, ...] | None = None
    """Their names."""


class Rosbag2:
    """The messages of a bag; `losses` is complete once `write` has come to its end."""

    def __init__(self, source: Path, options: Rosbag2Options) -> None:
        """Look at a bag.

        Raises
        ------
        InputError : it cannot be read, or holds none of the topics asked for.
        """
        self._source = source
        self._lost: Counter[str] = Counter()
        if not source.exists():
            raise InputError(f"{source}: no such file or directory; a rosbag2 directory is accepted")
        if source.is_dir() and not (source / "metadata.yaml").is_file():
            raise InputError(f"{source}: holds no metadata.yaml, a rosbag2 directory is accepted")
        with _opened(source, look=True) as (reader, _):
            present = {c.topic: c.msgtype for c in reader.connections}
            self._counts = {c.topic: c.msgcount for c in reader.connections if self._wanted(c, options)}
        for topic in options.topics or ():
            if topic not in self._counts:
                what = f"of type {present[topic]}" if topic in present else "not there"
                raise InputError(
                    f"{source}: topic {topic} is {what}; accepted: one of {', '.join(present)} that carries "
                    f"one of {', '.join(_READ)}"
                )
        if not any(n and present[topic] in _NEEDED for topic, n in self._counts.items()):
            listed = ", ".join(f"{topic} ({kind})" for topic, kind in present.items()) or "none"
            raise InputError(
                f"{source}: no message of a type that is read ({', '.join(_NEEDED)}); found: {listed}"
            )
        self.left_out = tuple(f"{t} ({kind})" for t, kind in present.items() if t not in self._counts)
        self.total = sum(self._counts.values())
        self.repairs: tuple[Loss, ...] = ()
        self._options = options

    @property
    def losses(self) -> tuple[Loss, ...]:
        return tuple(Loss(str(self._source), what, n) for what, n in self._lost.items())

    def write(self, out: Output) -> Iterator[None]:
        got, why = 0, ""
        with _opened(self._source) as (reader, packed):
            wanted = [c for c in reader.connections if self._wanted(c, self._options)]
            try:
                topics = {c.topic: _topic(c) for c in wanted}
                with LibraryCalls(Exception):
                    stored = each(reader.messages(wanted), Exception)
            except DamagedError as error:
                raise _unreadable(self._source, error) from None
            numbers: Counter[str] = Counter()
            while True:
                try:
                    connection, time, data = next(stored)
                except StopIteration:
                    if got < self.total:
                        self._lost["messages that the bag declares but does not hold"] += self.total - got
                    return
                except DamagedError as error:
                    if not got:
                        raise _unreadable(self._source, error) from None
                    self._lost[f"messages lost in damage: {reason(error)}"] += max(self.total - got, 1)
                    return
                got += 1
                if packed:
                    try:
                        data = unpacked(data)
                    except DamagedError as error:
                        why = why or reason(error)
                        self._lost[f"messages lost in damage; first: {why}"] += 1
                        yield
                        continue
                number = numbers[connection.topic]
                numbers[connection.topic] += 1
                if isinstance(data, bytes) and 0 <= time <= MAX_TIME_NS:
                    out.copy(RawMessage(topics[connection.topic], number, time, data))
                else:
                    self._lost["messages without data or with an impossible time dropped"] += 1
                yield

    @staticmethod
    def _wanted(connection: Connection, options: Rosbag2Options) -> bool:
        named = options.topics is None or connection.topic in options.topics
        return named and connection.msgtype in _READ


def _topic(connection: Connection) -> Topic:
    """Return a topic with the text of its schema, which older bags leave to the reader to know."""
    definition = connection.msgdef
    text = definition.data if definition.format == MessageDefinitionFormat.MSG else ""
    if not isinstance(text, str):
        raise DamagedError(f"the schema of {connection.topic} is no text")
    if not text:
        store = get_typestore(Stores.ROS2_HUMBLE)
        with LibraryCalls(Exception):
            text, _ = store.generate_msgdef(connection.msgtype, ros_version=2)
    return Topic(
        connection.topic, MessageEncoding.CDR, connection.msgtype, SchemaEncoding.ROS2, text.encode()
    )


@contextmanager
def _opened(source: Path, look: bool = False) -> Iterator[tuple[Reader, bool]]:
    """Open a bag, and say in one line what is wrong with it; what is done with it is none of the bag's.

    With `look`, all of its files are read first, to see whether they are of a size that fits in memory. The
    bag comes with whether its messages are compressed.
    """
    reader = None
    try:
        _check_files(source)
        if look:
            for path in _files(source):
                if path.suffix == ".zstd":
                    _check_packed_file(path)
            _check_storages(source)
        # The library lets through what its storages raise: SQLite's, zstd's, YAML's errors.
        with LibraryCalls(Exception):
            reader = Reader(source)
            reader.open()
        packed = _limited(reader)
    except (DamagedError, OSError) as error:
        raise _unreadable(source, error) from None
    try:
        _check_topics(source, reader)
        yield reader, packed
    finally:
        reader.close()


def _unreadable(source: Path, error: Exception) -> InputError:
    return InputError(f"{source}: cannot be read as a rosbag2: {reason(error)}")


def _check_topics(source: Path, reader: Reader) -> None:
    """Check what metadata.yaml says of its topics, which the library passes on as it is written."""
    for connection in reader.connections:
        for key, name in (("name", connection.topic), ("type", connection.msgtype)):
            if not isinstance(name, str):
                raise InputError(
                    f"{source}: metadata.yaml: {key} of a topic: found {name!r}, text is accepted"
                )
        count = connection.msgcount
        if type(count) is not int or count < 0:
            raise InputError(
                f"{source}: metadata.yaml: message_count of {connection.topic}: found {count!r}, "
                "a whole number of at least 0 is accepted"
            )


def _files(source: Path) -> tuple[Path, ...]:
    return tuple(source.iterdir()) if source.is_dir() else (source,)


class _UnreadMcap(McapReader):
    """A file that stands ready, decompressed where it was not, and is not looked into."""

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass


class _UnreadSqlite3(Sqlite3Reader):
    """The same in SQLite."""

    def open(self) -> None:
        pass

    def close(self) -> None:
        pass


class _UnreadDirectory(DirectoryReader):
    STORAGE_PLUGINS = MappingProxyType({"mcap": _UnreadMcap, "sqlite3": _UnreadSqlite3})


class _UnreadBag(Reader):
    STORAGE_PLUGINS = MappingProxyType(
        {"dir": _UnreadDirectory, ".mcap": _UnreadMcap, ".db3": _UnreadSqlite3}
    )


def _check_storages(source: Path) -> None:
    """Check that no file holds more than is accepted, before the library, which takes all, looks into one."""
    with LibraryCalls(Exception):
        bag = _UnreadBag(source)
        bag.open()
    try:
        for part in _parts(bag):
            path = Path(str(part.path))
            named = str(source / path.name if source.is_dir() else source)
            if isinstance(part, McapReader):
                _check_sizes(path, named)
            elif isinstance(part, Sqlite3Reader):
                _check_rows(path, named)
    finally:
        bag.close()


def _parts(bag: Reader) -> Sequence[Any]:
    """Return the storages of a bag."""
    return bag.storage.storages if isinstance(bag.storage, DirectoryReader) else [bag.storage]


def _check_sizes(path: Path, named: str) -> None:
    """Check that a file declares or holds no more than fits in memory."""
    try:
        found = oversized(path)
    except InputError:  # what is no MCAP file is the library's to refuse
        return
    if found:
        raise InputError(str(replace(found[0], place=named)))


def _check_rows(path: Path, named: str) -> None:
    """Check that the rows of a file are counted in time."""
    steps = 0

    def stop() -> bool:
        nonlocal steps
        steps += _STEPS_AT_ONCE
        return steps > _MOST_STEPS

    with closing(sqlite3.connect(f"file:{quote(str(path))}?immutable=1", uri=True)) as database:
        database.setlimit(_SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES)
        database.set_progress_handler(stop, _STEPS_AT_ONCE)
        try:
            for query in _COUNTS:
                for _ in database.execute(query):
                    pass
        except (sqlite3.Error, ValueError):  # damage is the library's to refuse
            pass
    if steps > _MOST_STEPS:
        raise InputError(f"{named}: its messages are not counted within the {_MOST_STEPS} steps accepted")


def _check_packed_file(path: Path) -> None:
    """Check that a compressed file of a bag is none of those that are blown up to fill a disk."""
    try:
        most = max(_MOST_OF_A_SMALL_FILE_BYTES, _MOST_TIMES * path.stat().st_size)
        with (
            path.open("rb") as file,
            ZstdDecompressor().stream_reader(file, read_across_frames=True) as reader,
        ):
            n_bytes = 0
            while n_bytes <= most and (part := reader.read(_PART_BYTES)):
                n_bytes += len(part)
    except (OSError, ZstdError):  # is the library's to refuse
        return
    if n_bytes > most:
        raise InputError(f"{path}: holds more than {most} bytes, {_MOST_TIMES} times its size are accepted")


def _limited(reader: Reader) -> bool:
    """Keep the library from taking memory without bounds; tell whether messages are left compressed."""
    storage = reader.storage
    for part in _parts(reader):
        if isinstance(part, Sqlite3Reader) and part.dbconn is not None:
            part.dbconn.limit(_SQLITE_LIMIT_LENGTH, MAX_RECORD_BYTES)
    if isinstance(storage, DirectoryReader) and storage.metadata.compression_mode == "message":
        # It would decompress each message, however large.
        storage.metadata = storage.metadata._replace(compression_mode=None)
        return True
    return False


def _check_files(source: Path) -> None:
    """Check that nothing of a bag is a pipe or a device, on which the library would wait for ever."""
    for path in _files(source):
        if not path.is_dir():
            try:
                check_regular(path, path.stat().st_mode)
            except OSError as error:
                raise InputError(f"{path}: cannot be read: {error.strerror}") from None
