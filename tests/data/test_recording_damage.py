"""Damaged files: what is readable is recovered and the rest named, or the file is refused in one line."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from recording_files import LZ4, START_NS, UNCOMPRESSED, File, losses, read_at, track_message

from vmf.data.recording import describe, read
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
