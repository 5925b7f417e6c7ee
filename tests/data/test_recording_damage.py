"""Damaged files: what is readable is recovered and the rest named, or the file is refused in one line."""

from __future__ import annotations

import re
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Chunk, ChunkIndex
from recording_files import LZ4, START_NS, UNCOMPRESSED, File, losses, read_at, track_message

from vmf.data.recording import container, describe, observations, read
from vmf.data.recording.chunks import MAX_RECORD_BYTES, MAX_RECORDS, checked
from vmf.data.recording.container import MAGIC, Contents, oversized, scan, visit
from vmf.data.recording.damage import DamagedError
from vmf.errors import InputError
from vmf.spec.model import Recording

N = 200


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("sound") / "a.mcap"
    with File(path, chunk_size=4096) as file:
        file.sound(N)
    return path.read_bytes()


def _chunks(data: bytes, path: Path) -> list[ChunkIndex]:
    path.write_bytes(data)
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) > 5
    return summary.chunk_indexes


def _flip(data: bytes, at: int, bit: int = 0) -> bytes:
    return data[:at] + bytes([data[at] ^ (1 << bit)]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty (0 bytes)"),
        (b"\x89MC", "only 3 bytes long"),
        (b"PK\x03\x04 a zip file", "is not an MCAP file: starts with b'PK"),
        (b"\x89MCAP0\r\n", "no topic /pose; topics present: none"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(said)) as error:
        read_at(path)
    assert error.value.lines[0].startswith(f"{path}: ")


def test_a_file_that_is_missing_or_a_directory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.mcap: no such file"):
        read_at(tmp_path / "a.mcap")
    with pytest.raises(InputError, match="is a directory"):
        read_at(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        describe(tmp_path / "a.mcap")


def test_paths_are_relative_to_the_base_directory_unless_absolute(tmp_path: Path, sound: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(sound)
    source = Recording(path=str(path), pose={"topic": "/pose"}, tracks={"topic": "/tracks"})  # type: ignore[arg-type]
    assert read(source, "eye_in_hand", tmp_path / "elsewhere").path == path


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
def test_a_truncated_file_gives_what_comes_before_the_end(tmp_path: Path, sound: bytes, share: float) -> None:
    path = tmp_path / "a.mcap"
    size = int(share * len(sound))
    chunks = [c for c in _chunks(sound, path) if c.chunk_start_offset + c.chunk_length <= size]
    path.write_bytes(sound[:size])
    data = read_at(path)
    assert 0 < data.tracks.n_frames < N
    assert data.tracks.times_ns[-1] >= chunks[-1].message_end_time - 10**9
    assert f"file ends at byte {size}" in losses(data)
    assert "lost: " in "\n".join(describe(path).lines())


def test_an_unfinished_file_cut_between_records_is_told(tmp_path: Path, sound: bytes) -> None:
    path = tmp_path / "a.mcap"
    third = _chunks(sound, path)[2]
    path.write_bytes(sound[: third.chunk_start_offset])
    data = read_at(path)
    assert "without an end record (unfinished or cut short)" in losses(data)
    assert data.tracks.n_frames > 10


def test_a_missing_index_costs_nothing(tmp_path: Path, sound: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(sound[:-30])
    data = read_at(path)
    assert data.tracks.n_frames == N
    assert data.losses == ()
    assert "index at the end missing" in str(data.repairs[0])


@pytest.mark.parametrize("index", [True, False])
def test_a_flipped_bit_costs_one_chunk_and_says_how_many_messages(
    tmp_path: Path, sound: bytes, index: bool
) -> None:
    path = tmp_path / "a.mcap"
    chunk = _chunks(sound, path)[2]
    data = _flip(sound, chunk.chunk_start_offset + chunk.chunk_length // 2)
    path.write_bytes(data if index else data[:-30])
    result = read_at(path)
    lost = N - result.tracks.n_frames
    assert 0 < lost < N / 5
    assert f"chunk at byte {chunk.chunk_start_offset} is damaged" in losses(result)
    (loss,) = (x for x in result.losses if "damaged" in x.what)
    counted = {topic: int(n) for n, topic in re.findall(r"(\d+) of (/\w+)", loss.what)}
    assert loss.count == counted["/pose"] + counted["/tracks"]
    unpaired = sum(x.count for x in result.losses if "frames without a pose" in x.what)
    assert lost == counted["/tracks"] + unpaired


def test_the_first_chunk_takes_the_channels_with_it_unless_the_index_tells(
    tmp_path: Path, sound: bytes
) -> None:
    path = tmp_path / "a.mcap"
    chunk = _chunks(sound, path)[0]
    data = _flip(sound, chunk.chunk_start_offset + chunk.chunk_length // 2)
    path.write_bytes(data)
    assert read_at(path).tracks.n_frames > N / 2
    path.write_bytes(data[:-30])
    with pytest.raises(InputError, match="topics present: none"):
        read_at(path)
    assert "channel is not described anywhere" in "\n".join(describe(path).lines())


@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("length", [2**60, 2**64 - 1, 5000, 0, 3])
def test_a_false_record_length_costs_one_chunk_and_no_memory(
    tmp_path: Path, sound: bytes, index: bool, length: int
) -> None:
    path = tmp_path / "a.mcap"
    at = _chunks(sound, path)[2].chunk_start_offset
    data = sound[: at + 1] + struct.pack("<Q", length) + sound[at + 9 :]
    path.write_bytes(data if index else data[:-30])
    result = read_at(path)
    assert N * 0.8 < result.tracks.n_frames < N
    assert result.losses


@pytest.mark.parametrize("compressed", [True, False])
def test_a_chunk_that_declares_absurd_sizes_is_skipped(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "a.mcap"
    with File(path, chunk_size=4096, **({} if compressed else {"compression": UNCOMPRESSED})) as file:
        file.sound(N)
    data = path.read_bytes()
    at = _chunks(data, path)[2].chunk_start_offset + 9 + 16
    for declared in (2**62, 2**29, 0, 1):
        path.write_bytes(data[:at] + struct.pack("<Q", declared) + data[at + 8 :])
        result = read_at(path)
        assert N * 0.8 < result.tracks.n_frames < N
        assert "declares" in losses(result) or "is damaged" in losses(result)


def test_a_checksum_of_the_data_section_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with File(path, use_chunking=False, enable_data_crcs=True) as file:
        file.sound(5)
    assert read_at(path).losses == ()
    data = path.read_bytes()
    at = data.index(b'"left": [1.5, 2.0]') + 9
    path.write_bytes(data[:at] + b"7" + data[at + 1 :])
    assert "checksum of the data section does not match" in losses(read_at(path))


@pytest.mark.parametrize(
    "options", [{}, {"compression": LZ4}, {"compression": UNCOMPRESSED}, {"use_chunking": False}]
)
@pytest.mark.parametrize("cut", [False, True])
def test_random_damage_gives_a_result_or_one_refusal(
    tmp_path: Path, options: dict[str, object], cut: bool
) -> None:
    path = tmp_path / "a.mcap"
    with File(path, chunk_size=700, **options) as file:
        file.sound(8)
        file.tracks(track_message(START_NS + 10**9, []))
    sound = path.read_bytes()
    random = np.random.default_rng(5)
    results = 0
    for _ in range(100):
        at = int(random.integers(0, len(sound)))
        data = sound[:at] if cut else sound
        for _ in range(0 if cut else int(random.integers(1, 4))):
            data = _flip(data, int(random.integers(0, len(data))), int(random.integers(0, 8)))
        path.write_bytes(data)
        try:
            assert read_at(path).tracks.n_frames > 0
            results += 1
            describe(path)
        except InputError as error:
            assert error.lines  # noqa: PT017
    assert results > 20


def _record(opcode: int, body: bytes, more: int = 0) -> bytes:
    return struct.pack("<BQ", opcode, len(body) + more) + body


def _text(words: bytes) -> bytes:
    return struct.pack("<I", len(words)) + words


_HEADER = _record(1, _text(b"") + _text(b""))
_END = _record(15, struct.pack("<I", 0)) + _record(2, struct.pack("<QQI", 0, 0, 0)) + MAGIC
_CHANNEL = _record(3, struct.pack("<H", 1) + _text(b"x/X") + _text(b"ros2msg") + _text(b"int8 a")) + _record(
    4, struct.pack("<HH", 1, 1) + _text(b"/x") + _text(b"cdr") + struct.pack("<I", 0)
)
_EMPTY_MESSAGE = _record(5, struct.pack("<HIQQ", 1, 0, 1, 1))


def _chunk(content: bytes) -> bytes:
    packed = zstandard.ZstdCompressor(level=1).compress(content)
    head = struct.pack("<QQQI", 1, 1, len(content), 0) + _text(b"zstd") + struct.pack("<Q", len(packed))
    return _record(6, head + packed)


def _peak_bytes(work: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("opcode", [3, 4, 5, 6, 9])
def test_what_is_too_large_is_not_copied_before_it_is_refused(tmp_path: Path, opcode: int) -> None:
    """A file mostly of holes: of its 300 MiB record, only the head is looked at."""
    n = 300 * 2**20
    heads = {
        3: struct.pack("<H", 1) + _text(b"x/X") + _text(b"ros2msg") + struct.pack("<I", n),
        4: struct.pack("<HH", 1, 1) + _text(b"/x") + struct.pack("<I", n),
        5: struct.pack("<HIQQ", 1, 0, 1, 1),
        6: struct.pack("<QQQI", 1, 1, n, 0) + _text(b"") + struct.pack("<Q", n),
        9: struct.pack("<QQ", 0, 0) + _text(b"a.txt") + _text(b"text/plain") + struct.pack("<Q", n),
    }
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        file.write(MAGIC + _HEADER + _record(opcode, heads[opcode], n + 4 * (opcode == 9)))
        file.seek(n + 4 * (opcode == 9), 1)
        file.write(_CHANNEL + _EMPTY_MESSAGE + _END)
    found: list[Contents] = []
    peak = _peak_bytes(lambda: found.append(scan(path, lambda topic: True)))
    assert peak < 2**20
    (contents,) = found
    assert [message.topic.name for message in contents.messages] == ["/x"]
    if opcode == 9:
        assert (contents.attachments, contents.losses) == (("a.txt",), ())
    else:
        assert f"more than the {MAX_RECORD_BYTES} accepted" in str(contents.losses[0])


def test_a_chunk_of_more_records_than_any_recorder_writes_is_not_taken_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    flood = _chunk(_CHANNEL + _EMPTY_MESSAGE * MAX_RECORDS)
    path.write_bytes(MAGIC + _HEADER + flood + _chunk(_CHANNEL + _EMPTY_MESSAGE * 7) + _END)
    assert path.stat().st_size < 10_000
    contents = scan(path, lambda topic: True)
    assert f"holds more than the {MAX_RECORDS} records accepted" in str(contents.losses[0])
    assert len(contents.messages) == 7


def test_records_of_a_chunk_are_read_one_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    n = 20_000
    path.write_bytes(MAGIC + _HEADER + _chunk(_CHANNEL + _EMPTY_MESSAGE * n) + _END)
    seen: list[int] = []
    peak = _peak_bytes(lambda: visit(path, lambda topic: True, lambda message: seen.append(message.index)))
    assert seen == list(range(n))
    # The chunk itself, and the numbers; a message takes several hundred bytes.
    assert peak < 100 * n + len(_EMPTY_MESSAGE) * n


def test_messages_that_no_memory_holds_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + _HEADER + _chunk(_CHANNEL + _EMPTY_MESSAGE * 100) + _END)
    monkeypatch.setattr(container, "_MAX_KEPT_BYTES", 5000)
    with pytest.raises(InputError, match="on /x fill more than the 5000 bytes of memory accepted"):
        scan(path, lambda topic: True)
    assert scan(path, lambda topic: False).counts[0][1] == 100


def test_a_chunk_in_the_place_of_the_index_is_not_opened(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    front = MAGIC + _HEADER + _CHANNEL + _EMPTY_MESSAGE + _record(15, struct.pack("<I", 0))
    bomb = _chunk(bytes(MAX_RECORD_BYTES + 1))
    path.write_bytes(front + bomb + _record(2, struct.pack("<QQI", len(front), 0, 0)) + MAGIC)
    assert _peak_bytes(lambda: visit(path, lambda topic: True, lambda message: None)) < 2**20


@pytest.mark.parametrize("compression", ["zstd", "lz4", "zstd without a size"])
def test_a_chunk_that_holds_more_than_it_declares_is_told_from_other_damage(
    tmp_path: Path, compression: str
) -> None:
    """Another reader may take memory for all of it, whatever the chunk declares."""
    content = _CHANNEL + _EMPTY_MESSAGE
    if compression == "lz4":
        packed = lz4.frame.compress(content + bytes(1000))
    elif compression == "zstd":
        packed = zstandard.compress(content) + zstandard.compress(bytes(1000))
    else:
        packed = zstandard.ZstdCompressor(write_content_size=False).compress(content + bytes(1000))
    head = struct.pack("<QQQI", 1, 1, len(content), 0) + _text(compression.split()[0].encode())
    path = tmp_path / "a.mcap"
    chunk = _record(6, head + struct.pack("<Q", len(packed)) + packed)
    path.write_bytes(MAGIC + _HEADER + chunk + _END)
    (found,) = oversized(path)
    assert "holds more" in found.what
    sound = _chunk(content)
    path.write_bytes(MAGIC + _HEADER + sound[:-5] + bytes(5) + _END)
    assert scan(path, lambda topic: True).losses
    assert oversized(path) == ()


def test_more_topics_than_any_robot_has_are_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    topics = (
        _record(4, struct.pack("<HH", i, 0) + _text(b"/%d" % i) + _text(b"cdr") + struct.pack("<I", 0))
        for i in range(10_001)
    )
    path.write_bytes(MAGIC + _HEADER + _chunk(b"".join(topics)) + _END)
    with pytest.raises(InputError, match="describes more than the 10000 topics accepted"):
        scan(path, lambda topic: True)


def test_mistakes_of_our_own_are_not_taken_for_damage(
    tmp_path: Path, sound: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(sound)

    def mistaken(*_: object) -> None:
        raise NameError("name 'pixle' is not defined")

    monkeypatch.setattr(observations, "_frame", mistaken)
    with pytest.raises(NameError, match="pixle"):
        read_at(path)


def test_a_record_that_reaches_into_the_next_is_damage() -> None:
    """The library takes what it gets of a text or of a definition that is cut short by the record's end."""
    definition = b"float64 x\n"
    body = struct.pack("<HI1sI7s", 1, 1, b"a", 7, b"ros2msg")
    for length in (len(definition), len(definition) + 5):
        schema = body + struct.pack("<I", length) + definition
        record = struct.pack("<BQ", 3, len(schema)) + schema
        chunk = Chunk(
            compression="",
            data=2 * record,
            message_end_time=0,
            message_start_time=0,
            uncompressed_crc=0,
            uncompressed_size=2 * len(record),
        )
        if length == len(definition):
            assert len(list(checked(chunk))) == 2
        else:
            with pytest.raises(DamagedError, match="data ends too early"):
                checked(chunk)
