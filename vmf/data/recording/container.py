"""Walk an MCAP file record by record, in file order, and get out of it whatever is readable.

The library's own readers stop at the first damaged byte. Here each chunk stands for itself: one that fails
its checksum is named and skipped, and after a broken record the walk goes on at the next chunk that can be
found, through the index at the end of the file or by its signature.
"""

from __future__ import annotations

import bisect
import hashlib
import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    McapRecord,
    Message,
    Schema,
)
from mcap.stream_reader import StreamReader

from vmf.data.recording.chunks import TooLargeError, bounded, checked, decompressed, stream
from vmf.data.recording.damage import DamagedError, LibraryCalls, each, reason
from vmf.errors import InputError, Loss
from vmf.regular_file import open_regular

MAGIC = bytes((137, 77, 67, 65, 80, 48, 13, 10))

_HEAD_BYTES = 9  # opcode and length in front of every record
# Of a message index: its channel and the bytes of its entries in front, then the entries.
_INDEX_HEAD, _INDEX_ENTRY_BYTES = struct.Struct("<HI"), 16
_FOOTER_BYTES = _HEAD_BYTES + 20 + len(MAGIC)
_SIGNATURE_AT = _HEAD_BYTES + 28
_SIGNATURES = (b"\x04\x00\x00\x00zstd", b"\x03\x00\x00\x00lz4")
_APPLICATION_OPCODES = 0x80
_MAX_SUMMARY_BYTES = 2**27
# Of the messages that `scan` keeps; each takes some memory besides its bytes.
_MAX_KEPT_BYTES, _OVERHEAD_BYTES = 2**30, 256
_LONGEST_NAME_BYTES = 2**16
_MAX_TOPICS = 10_000
_OPCODES = {int(code) for code in Opcode}


@dataclass(frozen=True)
class Topic:
    """One channel of a file, and the schema that says how its messages are written."""

    name: str
    encoding: str
    schema: str
    schema_encoding: str
    schema_data: bytes = field(repr=False)
    metadata: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class RawMessage:
    """A message as stored: its place among the messages of its topic, the recorder's time, and bytes."""

    topic: Topic
    index: int
    log_time_ns: int
    data: bytes = field(repr=False)


@dataclass(frozen=True)
class Contents:
    """What was readable of a file.

    Attributes
    ----------
    counts : readable messages of each topic, in order of appearance.
    messages : the messages of the topics asked for, in file order.
    span_ns : first and last log time of any message, None without messages.
    attachments : names of the attachments.
    """

    path: Path
    sha256: str
    counts: tuple[tuple[Topic, int], ...]
    messages: tuple[RawMessage, ...]
    span_ns: tuple[int, int] | None
    attachments: tuple[str, ...]
    losses: tuple[Loss, ...]
    repairs: tuple[Loss, ...]

    def on(self, topic: str, schema: str | None = None) -> tuple[RawMessage, ...]:
        """Return the messages on one topic, or those of one schema on it, in file order."""
        return tuple(m for m in self.messages if m.topic.name == topic and schema in (None, m.topic.schema))


def is_rosbag2(path: Path) -> bool:
    """Tell whether a path is a directory that ROS 2 has recorded into."""
    return (path / "metadata.yaml").is_file()


def scan(path: Path, wanted: Callable[[Topic], bool]) -> Contents:
    """Read the file at `path`, keeping the messages of the topics `wanted`.

    Raises
    ------
    InputError : the file is missing, unreadable, empty or not MCAP, or the messages fill more than 1 GiB.
    """
    messages: list[RawMessage] = []
    kept_bytes = 0

    def keep(message: RawMessage) -> None:
        nonlocal kept_bytes
        kept_bytes += len(message.data) + _OVERHEAD_BYTES
        if kept_bytes > _MAX_KEPT_BYTES:
            what = f"the messages up to number {message.index} on {message.topic.name}"
            raise InputError(f"{path}: {what} fill more than the {_MAX_KEPT_BYTES} bytes of memory accepted")
        messages.append(message)

    contents = visit(path, wanted, keep)
    return replace(contents, messages=tuple(messages))


def visit(path: Path, wanted: Callable[[Topic], bool], see: Callable[[RawMessage], None]) -> Contents:
    """Read the file at `path` like `scan`, but show each message to `see` and keep none.

    Raises
    ------
    InputError : the file is missing, unreadable, empty or not MCAP.
    """
    with _mapped(path) as data:
        walk = _Walk(path, data, wanted)
        for message in walk.run():
            see(message)
        return Contents(
            path,
            hashlib.sha256(data).hexdigest(),
            tuple((t, walk.counts[t.name, t.schema, t.encoding]) for t in walk.topics),
            (),
            walk.span_ns,
            tuple(walk.attachments),
            tuple(walk.losses),
            tuple(walk.repairs),
        )


def messages(path: Path, wanted: Callable[[Topic], bool]) -> Iterator[RawMessage]:
    """Yield the readable messages of the topics `wanted` in file order, holding one chunk at a time.

    What is damaged is passed over here: `scan` and `visit` count it.

    Raises
    ------
    InputError : the file is missing, unreadable, empty or not MCAP.
    """
    with _mapped(path) as data:
        yield from _Walk(path, data, wanted).run()


def oversized(path: Path) -> tuple[Loss, ...]:
    """Return what is in the file at `path` that other readers may take too much memory for.

    Raises
    ------
    InputError : the file is missing, unreadable, empty or not MCAP.
    """
    with _mapped(path) as data:
        walk = _Walk(path, data, lambda topic: False)
        for _ in walk.run():
            pass
        return tuple(walk.oversized)


@contextmanager
def _mapped(path: Path) -> Iterator[mmap.mmap]:
    """Map the file into memory: only what is looked at is loaded, whatever sizes the file declares."""
    if path.is_dir():
        hint = f"; `vmf import rosbag2 {path} -o FILE.mcap` makes one of it" if is_rosbag2(path) else ""
        raise InputError(f"{path}: is a directory; expected an MCAP file{hint}")
    try:
        with open_regular(path) as file:
            head = file.read(len(MAGIC))
            if not head:
                raise InputError(f"{path}: is empty (0 bytes); expected an MCAP file")
            if head != MAGIC:
                short = f", only {len(head)} bytes long" if len(head) < len(MAGIC) else ""
                raise InputError(
                    f"{path}: is not an MCAP file: starts with {head!r}{short}; expected {MAGIC!r}"
                )
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield data
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected an MCAP recording") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


class _Walk:
    """The state of one pass over a file."""

    def __init__(self, path: Path, data: mmap.mmap, wanted: Callable[[Topic], bool]) -> None:
        self.path, self.data, self.wanted = path, data, wanted
        self.oversized: list[Loss] = []
        self.counts: Counter[tuple[str, str, str]] = Counter()
        self.span_ns: tuple[int, int] | None = None
        self.attachments: list[str] = []
        self.losses: list[Loss] = []
        self.repairs: list[Loss] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._topic_of: dict[int, Topic] = {}
        self._topics: dict[tuple[str, str, str], Topic] = {}
        self._orphans = 0
        self._chunk_starts: list[int] = []
        self._has_footer = self._read_summary()

    def run(self) -> Iterator[RawMessage]:
        """Yield the messages wanted; what was lost and counted stands in the attributes afterwards."""
        at, size = len(MAGIC), len(self.data)
        resume = at  # where a search for the next chunk may begin: behind the last one dealt with
        ended = False
        while at < size:
            opcode, end = self._head(at)
            if not self._plausible(at, opcode, end):
                following = self._next_chunk(resume)
                if following is None:
                    self._lose_tail(at, opcode, end)
                    break
                self._lose(
                    f"broken record at byte {at}; reading goes on with the chunk at byte {following}", 1
                )
                at = following
                resume = at + 1
                continue
            if opcode == Opcode.DATA_END:
                following = self._next_chunk(max(resume, end))
                if following is None:
                    ended = True
                    self._check_data_section(at)
                    break
                what = f"end record at byte {at} in front of the chunk at byte {following} passed over"
                self.repairs.append(Loss(str(self.path), what, 1))
                at = following
                resume = at + 1
                continue
            records: Iterable[McapRecord] | None
            if opcode == Opcode.CHUNK:
                records = self._chunk(at, end)
                resume = at + 1 if records is None else end
            else:
                records = self._record(at, opcode, end)
            for record in records or ():
                message = self._keep(record)
                if message is not None:
                    yield message
            at = end
        else:
            self._lose(f"file ends at byte {size} without an end record (unfinished or cut short)", 1)
        if ended and not self._has_footer:
            self.repairs.append(Loss(str(self.path), "index at the end missing or damaged, not needed", 1))
        if self._orphans:
            self._lose("messages whose channel is not described anywhere", self._orphans)

    @property
    def topics(self) -> tuple[Topic, ...]:
        """All topics so far; a channel may be met before its schema where records are out of order."""
        described = {topic.name for topic in self._topics.values() if topic.schema}
        return tuple(t for t in self._topics.values() if t.schema or t.name not in described)

    def _lose(self, what: str, count: int) -> None:
        self.losses.append(Loss(str(self.path), what, count))

    def _lose_tail(self, at: int, opcode: int, end: int) -> None:
        size = len(self.data)
        recovered = f"{sum(self.counts.values())} messages recovered before it"
        if end > size and opcode in _OPCODES:
            kind = Opcode(opcode).name.lower().replace("_", " ")
            self._lose(f"file ends at byte {size} inside a {kind} record; {recovered}", 1)
        else:
            self._lose(f"nothing readable from byte {at} to the end at {size}; {recovered}", 1)

    def _head(self, at: int) -> tuple[int, int]:
        """Return a record's opcode and where it ends; beyond the file if the head itself is cut."""
        head = self.data[at : at + _HEAD_BYTES]
        if len(head) < _HEAD_BYTES:
            return head[0], len(self.data) + 1
        opcode, length = struct.unpack("<BQ", head)
        return opcode, at + _HEAD_BYTES + length

    def _plausible(self, at: int, opcode: int, end: int) -> bool:
        """Tell whether a known record fits in the file without swallowing a chunk the index knows."""
        known = opcode in _OPCODES or opcode >= _APPLICATION_OPCODES
        if not known or end > len(self.data):
            return False
        if opcode == Opcode.DATA_END and end != at + _HEAD_BYTES + 4:
            return False
        until = len(self.data) if opcode == Opcode.DATA_END else end
        following = bisect.bisect_right(self._chunk_starts, at)
        return following == len(self._chunk_starts) or self._chunk_starts[following] >= until

    def _next_chunk(self, after: int) -> int | None:
        """Return the first byte of the next chunk: from the index, or where one's signature fits."""
        first = bisect.bisect_left(self._chunk_starts, after)
        found = self._chunk_starts[first : first + 1]
        for signature in _SIGNATURES:
            hit = self.data.find(signature, after + _SIGNATURE_AT)
            while hit >= 0 and not self._is_chunk(hit - _SIGNATURE_AT, len(signature) - 4):
                hit = self.data.find(signature, hit + 1)
            if hit >= 0:
                found.append(hit - _SIGNATURE_AT)
        return min(found, default=None)

    def _is_chunk(self, at: int, name_bytes: int) -> bool:
        opcode, end = self._head(at)
        size_at = at + _SIGNATURE_AT + 4 + name_bytes
        if opcode != Opcode.CHUNK or end > len(self.data) or size_at + 8 > len(self.data):
            return False
        (data_bytes,) = struct.unpack("<Q", self.data[size_at : size_at + 8])
        return bool(end == size_at + 8 + data_bytes)

    def _chunk(self, at: int, end: int) -> Iterator[McapRecord] | None:
        """Return what is in the chunk at `at`; on damage name it, count its messages from the index."""
        try:
            with memoryview(self.data) as view, view[at + _HEAD_BYTES : end] as body:
                return checked(decompressed(body))
        except DamagedError as error:
            lost = self._indexed_messages(end)
            which = ", ".join(f"{n} of {topic}" for topic, n in lost.items()) or "an unknown number"
            self._lose(
                f"chunk at byte {at} is damaged ({reason(error)}): messages lost: {which}",
                sum(lost.values()) or 1,
            )
            if isinstance(error, TooLargeError):
                self.oversized.append(self.losses[-1])
            return None

    def _indexed_messages(self, at: int) -> dict[str, int]:
        """Return how many messages of each topic the indices that follow a chunk count."""
        lost: Counter[str] = Counter()
        while at < len(self.data):
            opcode, end = self._head(at)
            if opcode != Opcode.MESSAGE_INDEX or end > len(self.data):
                break
            if end - at < _HEAD_BYTES + _INDEX_HEAD.size:
                break
            number, n_bytes = _INDEX_HEAD.unpack_from(self.data, at + _HEAD_BYTES)
            if end - at != _HEAD_BYTES + _INDEX_HEAD.size + n_bytes:
                break
            channel = self._channels.get(number)
            lost[channel.topic if channel else f"channel {number}"] += n_bytes // _INDEX_ENTRY_BYTES
            at = end
        return dict(lost)

    def _record(self, at: int, opcode: int, end: int) -> list[McapRecord]:
        """Read a record outside of chunks; what is of no use here is passed over unread."""
        body = at + _HEAD_BYTES
        try:
            if opcode == Opcode.ATTACHMENT:
                self.attachments.append(self._attachment_name(body, end))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                reader = stream(self.data[body : body + bounded(end - body)])
                with LibraryCalls():
                    if opcode == Opcode.SCHEMA:
                        return [Schema.read(reader)]
                    if opcode == Opcode.CHANNEL:
                        return [Channel.read(reader)]
                    return [Message.read(reader, end - body)]
        except DamagedError as error:
            kind = Opcode(opcode).name.lower()
            self._lose(f"{kind} record at byte {at} is damaged ({reason(error)})", 1)
            if isinstance(error, TooLargeError):
                self.oversized.append(self.losses[-1])
        return []

    def _attachment_name(self, at: int, end: int) -> str:
        """Return the name of the attachment in [at, end), of which only the head is read."""
        head = stream(self.data[at : min(at + 2 * _LONGEST_NAME_BYTES, end)])
        with LibraryCalls():
            head.read(16)  # two times
            name = head.read_prefixed_string()
            head.read_prefixed_string()
            n_bytes = head.read8()
        if at + head.count + n_bytes + 4 != end:  # a checksum follows
            raise DamagedError("lengths inside do not fit")
        return name

    def _keep(self, record: McapRecord) -> RawMessage | None:
        """Take note of a record; return it if it is a message wanted."""
        if isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            self._channels[record.id] = record
            self._describe(record)
        elif isinstance(record, Message):
            topic = self._topic_of.get(record.channel_id)
            if topic is None:
                self._orphans += 1
                return None
            first, last = self.span_ns or (record.log_time, record.log_time)
            self.span_ns = min(first, record.log_time), max(last, record.log_time)
            key = topic.name, topic.schema, topic.encoding
            self.counts[key] += 1
            if self.wanted(topic):
                return RawMessage(topic, self.counts[key] - 1, record.log_time, record.data)
        return None

    def _describe(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id) or Schema(0, b"", "", "")
        topic = Topic(
            channel.topic,
            channel.message_encoding,
            schema.name,
            schema.encoding,
            schema.data,
            tuple(channel.metadata.items()),
        )
        self._topic_of[channel.id] = topic
        self._topics.setdefault((topic.name, topic.schema, topic.encoding), topic)
        if len(self._topics) > _MAX_TOPICS:
            raise InputError(f"{self.path}: describes more than the {_MAX_TOPICS} topics accepted")

    def _read_summary(self) -> bool:
        """Take channels and chunk positions from the index at the end, if it is there and intact.

        It is a help, not a need: it tells of channels whose first chunk is lost, and where chunks start.
        """
        size = len(self.data)
        if size < _FOOTER_BYTES or self.data[size - len(MAGIC) :] != MAGIC:
            return False
        opcode, length, start, _, crc = struct.unpack("<BQQQI", self.data[size - _FOOTER_BYTES : size - 8])
        if opcode != Opcode.FOOTER or length != 20:
            return False
        if start == 0:
            return True
        if not len(MAGIC) <= start < size or size - start > _MAX_SUMMARY_BYTES:
            return False
        summary = self.data[start:size]
        if crc not in (0, zlib.crc32(summary[: -len(MAGIC) - 4])):
            return False
        # A chunk has no place here: it is handed out as it is, not opened.
        reader = StreamReader(BytesIO(summary), skip_magic=True, emit_chunks=True, record_size_limit=size)
        starts: list[int] = []
        described: list[Schema | Channel] = []
        try:
            for record in each(reader.records):
                if isinstance(record, ChunkIndex):
                    starts.append(record.chunk_start_offset)
                elif isinstance(record, Schema | Channel):
                    described.append(record)
        except DamagedError:
            return False
        for description in described:
            self._keep(description)
        self._chunk_starts = sorted(starts)
        return True

    def _check_data_section(self, at: int) -> None:
        end = DataEnd.read(stream(self.data[at + _HEAD_BYTES : at + _HEAD_BYTES + 4]))
        if end.data_section_crc == 0 or self.losses:
            return
        with memoryview(self.data) as view, view[:at] as section:
            if zlib.crc32(section) != end.data_section_crc:
                self._lose("checksum of the data section does not match: bytes outside of chunks changed", 1)
