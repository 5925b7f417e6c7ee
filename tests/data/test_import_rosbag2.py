"""Rosbag2 directories, stored in MCAP and in SQLite, compressed or not, of old versions and damaged."""

from __future__ import annotations

import errno
import os
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import import_folders as folders
import numpy as np
import pytest
import yaml
import zstandard
from image_files import LEFT, RIGHT
from import_folders import N, Scene, scene
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores.ros2_humble import (
    builtin_interfaces__msg__Time as Time,
)
from rosbags.typesys.stores.ros2_humble import (
    geometry_msgs__msg__Point as Point,
)
from rosbags.typesys.stores.ros2_humble import (
    geometry_msgs__msg__Pose as Pose,
)
from rosbags.typesys.stores.ros2_humble import (
    geometry_msgs__msg__PoseStamped as PoseStamped,
)
from rosbags.typesys.stores.ros2_humble import (
    geometry_msgs__msg__Quaternion as Quaternion,
)
from rosbags.typesys.stores.ros2_humble import (
    sensor_msgs__msg__CameraInfo as CameraInfo,
)
from rosbags.typesys.stores.ros2_humble import (
    sensor_msgs__msg__CompressedImage as CompressedImage,
)
from rosbags.typesys.stores.ros2_humble import (
    sensor_msgs__msg__RegionOfInterest as RegionOfInterest,
)
from rosbags.typesys.stores.ros2_humble import (
    std_msgs__msg__Header as Header,
)
from rosbags.typesys.stores.ros2_humble import (
    std_msgs__msg__String as String,
)

from vmf.data.importers import rosbag2
from vmf.data.recording import describe, read
from vmf.data.recording.chunks import MAX_RECORD_BYTES
from vmf.data.recording.container import MAGIC
from vmf.data.recording.output import Output
from vmf.errors import InputError
from vmf.experiment.importing import ImportResult, import_recording
from vmf.experiment.inspect import inspect
from vmf.spec import ImageSource, PoseSource, Recording

POSE = "/robot/pose"
SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
SECOND_NS = 10**9


def header(ns: int) -> Header:
    return Header(Time(ns // SECOND_NS, ns % SECOND_NS), "world")


def bag(path: Path, world: Scene, plugin: StoragePlugin, mode: CompressionMode | None = None) -> Path:
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        pose = writer.add_connection(POSE, PoseStamped.__msgtype__, typestore=store)
        left, right = (
            writer.add_connection(topic, CompressedImage.__msgtype__, typestore=store)
            for topic in (LEFT, RIGHT)
        )
        chatter = writer.add_connection("/chatter", String.__msgtype__, typestore=store)
        for i, time in enumerate(world.times_ns.tolist()):
            p, q = world.poses.position_m[i].tolist(), world.poses.quaternion_xyzw[i].tolist()
            message = PoseStamped(header(time), Pose(Point(*p), Quaternion(*q)))
            writer.write(pose, time, store.serialize_cdr(message, pose.msgtype))
            for topic, images in zip((left, right), world.images, strict=True):
                image = CompressedImage(header(time), "png", np.frombuffer(images[i], np.uint8))
                writer.write(topic, time, store.serialize_cdr(image, topic.msgtype))
            writer.write(chatter, time, store.serialize_cdr(String("hello"), chatter.msgtype))
    return path


def imported(source: Path, *options: str) -> tuple[Path, ImportResult]:
    output = source.parent / "imported.mcap"
    return output, import_recording("rosbag2", source, output, options)


def assert_holds(path: Path, world: Scene) -> None:
    for got, images in zip(folders.images_in(path, (LEFT, RIGHT)), world.images, strict=True):
        assert got == [(t, "png", data) for t, data in zip(world.times_ns.tolist(), images, strict=True)]
    stream = folders.poses_in(path, POSE)
    np.testing.assert_array_equal(stream.times_ns, world.times_ns)
    np.testing.assert_array_equal(stream.values, world.values)


@pytest.mark.parametrize("mode", [None, CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", [SQLITE, MCAP])
def test_a_bag_is_passed_on_as_it_is(
    tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode | None
) -> None:
    world = scene()
    path, result = imported(bag(tmp_path / "bag", world, plugin, mode))
    assert_holds(path, world)
    assert result.left_out == ("/chatter (std_msgs/msg/String)",)
    assert result.losses == ()
    source = Recording(path=str(path), pose=PoseSource(topic=POSE), images=ImageSource())
    assert read(source, "eye_in_hand", tmp_path).tracks.n_frames == N


@pytest.mark.parametrize("plugin", [SQLITE, MCAP])
def test_one_file_of_a_bag_will_do(tmp_path: Path, plugin: StoragePlugin) -> None:
    world = scene()
    folder = bag(tmp_path / "bag", world, plugin)
    (file,) = (path for path in folder.iterdir() if path.suffix != ".yaml")
    assert_holds(imported(file)[0], world)


def test_old_bags_in_sqlite_do_not_describe_their_messages(tmp_path: Path) -> None:
    world = scene()
    folder = bag(tmp_path / "bag", world, SQLITE)
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("DROP TABLE message_definitions")
        database.execute("UPDATE schema SET schema_version = 3")
    database.close()
    assert_holds(imported(folder)[0], world)


def test_calibrations_go_along_but_are_not_enough(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    roi = RegionOfInterest(0, 0, 0, 0, False)
    K, P = np.diag([400.0, 400.0, 1.0]), np.zeros(12)
    info = CameraInfo(
        header(5), 480, 640, "plumb_bob", np.zeros(5), K.ravel(), np.eye(3).ravel(), P, 0, 0, roi
    )
    for folder, with_pose in (("with", True), ("without", False)):
        with Writer(tmp_path / folder, version=9, storage_plugin=MCAP) as writer:
            camera = writer.add_connection("/left/camera_info", info.__msgtype__, typestore=store)
            writer.write(camera, 5, store.serialize_cdr(info, camera.msgtype))
            if with_pose:
                pose = writer.add_connection(POSE, PoseStamped.__msgtype__, typestore=store)
                message = PoseStamped(header(5), Pose(Point(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 0.0, 1.0)))
                writer.write(pose, 5, store.serialize_cdr(message, pose.msgtype))
    path, result = imported(tmp_path / "with")
    assert {t.name: (t.schema, t.count) for t in result.topics} == {
        "/left/camera_info": ("sensor_msgs/msg/CameraInfo", 1),
        POSE: ("geometry_msgs/msg/PoseStamped", 1),
    }
    assert (result.left_out, result.losses) == ((), ())
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        ((*_, found),) = reader.iter_decoded_messages(topics=["/left/camera_info"])
    assert (found.width, found.height, list(found.k)) == (640, 480, K.ravel().tolist())
    with pytest.raises(InputError, match=r"found: /left/camera_info \(sensor_msgs/msg/CameraInfo\)"):
        imported(tmp_path / "without")


def test_what_goes_wrong_with_the_output_is_not_blamed_on_the_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = bag(tmp_path / "bag", scene(), SQLITE)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(Output, "copy", full)
        with pytest.raises(InputError) as error:
            imported(folder)
    assert error.value.lines == (
        f"{tmp_path / 'imported.mcap'}: cannot be written: {os.strerror(errno.ENOSPC)}",
    )
    with monkeypatch.context() as patched:
        patched.setattr(Output, "copy", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            imported(folder)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


def test_topics_can_be_chosen(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", scene(), MCAP)
    path, result = imported(folder, f"topics=[{POSE}]")
    assert [topic.name for topic in result.topics] == [POSE]
    assert len(result.left_out) == 3
    path.unlink()
    for topic, words in (("/chatter", "of type std_msgs/msg/String"), ("/nowhere", "not there")):
        with pytest.raises(InputError, match=f"topic {topic} is {words}"):
            imported(folder, f"topics=[{topic}]")
    assert not path.exists()


def test_a_bag_is_not_a_recording_and_says_what_to_do(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", scene(), SQLITE)
    source = Recording(path=str(folder), pose=PoseSource(topic=POSE), images=ImageSource())
    for use in (lambda: inspect(folder), lambda: read(source, "eye_in_hand", tmp_path)):
        with pytest.raises(InputError) as error:
            use()
        (line,) = error.value.lines
        assert line.startswith(f"{folder}: is a directory")
        assert f"`vmf import rosbag2 {folder} -o FILE.mcap`" in line


def damage(folder: Path, name: str, share: float, count: int = 64) -> None:
    """Write nonsense over a part of a file."""
    data = bytearray((folder / name).read_bytes())
    at = int(share * len(data))
    data[at : at + count] = b"\xa5" * count
    (folder / name).write_bytes(data)


@pytest.mark.parametrize("plugin", [SQLITE, MCAP])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.5, 0.7, 0.9])
def test_damage_is_refused_or_counted(tmp_path: Path, plugin: StoragePlugin, share: float) -> None:
    """Damage inside of an image goes unseen here, where no checksum covers it: the tracker will see it."""
    folder = bag(tmp_path / "bag", scene(), plugin)
    (name,) = (path.name for path in folder.iterdir() if path.suffix != ".yaml")
    damage(folder, name, share)
    assert accounted_for(folder) in (0, 3 * N)


def accounted_for(folder: Path) -> int:
    """Return how many messages are there or counted as lost; 0 if the bag was refused in one line."""
    (folder.parent / "imported.mcap").unlink(missing_ok=True)
    try:
        path, result = imported(folder)
    except InputError as error:
        refusal = error
    else:
        assert sum(topic.count for topic in result.topics) == sum(t.count for t in describe(path).topics)
        return sum(topic.count for topic in result.topics) + sum(loss.count for loss in result.losses)
    assert len(refusal.lines) == 1
    assert str(folder) in refusal.lines[0]
    assert not (folder.parent / "imported.mcap").exists()
    return 0


@pytest.mark.parametrize("place", ["_check_files", "_limited", "_topic", "unpacked"])
def test_a_mistake_of_ours_is_not_blamed_on_the_bag(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = bag(tmp_path / "bag", scene(), SQLITE, CompressionMode.MESSAGE)

    def mistaken(*_: object) -> None:
        raise TypeError("a mistake in our own code")

    monkeypatch.setattr(rosbag2, place, mistaken)
    with pytest.raises(TypeError, match="a mistake in our own code"):
        imported(folder)


@pytest.mark.parametrize("plugin", [SQLITE, MCAP])
def test_a_bag_cut_short_is_refused_or_counted(tmp_path: Path, plugin: StoragePlugin) -> None:
    folder = bag(tmp_path / "bag", scene(), plugin)
    (file,) = (path for path in folder.iterdir() if path.suffix != ".yaml")
    data = file.read_bytes()
    for share in (0.0, 0.01, 0.4, 0.8, 0.99):
        file.write_bytes(data[: int(share * len(data))])
        assert accounted_for(folder) in (0, 3 * N)


def test_rows_without_data_are_counted(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", scene(), SQLITE)
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("UPDATE messages SET data = 'text' WHERE id = 2")
        database.execute("UPDATE messages SET timestamp = -5 WHERE id = 3")
    database.close()
    _, result = imported(folder)
    assert [(loss.what, loss.count) for loss in result.losses] == [
        ("messages without data or with an impossible time dropped", 2)
    ]


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", scene(), SQLITE)
    empty = tmp_path / "empty"
    empty.mkdir()
    (tmp_path / "notes.txt").write_text("hello")
    metadata = folder / "metadata.yaml"
    text = metadata.read_text()
    cases = [(empty, "holds no metadata.yaml"), (tmp_path / "notes.txt", "cannot be read as a rosbag2")]
    for source, words in cases:
        with pytest.raises(InputError, match=words):
            imported(source)
    for changed in (
        "a: [",
        text.replace("version: 9", "version: 99"),
        text.replace("bag.db3", "gone.db3"),
        "",
    ):
        metadata.write_text(changed)
        with pytest.raises(InputError, match="cannot be read as a rosbag2") as error:
            imported(folder)
        assert len(error.value.lines) == 1
    assert not (tmp_path / "imported.mcap").exists()


def test_a_bag_of_other_things_says_what_it_has(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "bag", version=9) as writer:
        chatter = writer.add_connection("/chatter", String.__msgtype__, typestore=store)
        writer.write(chatter, 1, store.serialize_cdr(String("hello"), chatter.msgtype))
    with pytest.raises(InputError, match=r"found: /chatter \(std_msgs/msg/String\)"):
        imported(tmp_path / "bag")


def test_an_interrupted_import_leaves_nothing(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", scene(), SQLITE)

    def stop(done: int, total: int, what: str) -> None:
        assert (total, what) == (3 * N, "messages")
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_recording("rosbag2", folder, tmp_path / "imported.mcap", (), stop)
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


@pytest.mark.parametrize(
    ("key", "written", "words"),
    [
        ("name", "[1, 2]", r"name of a topic: found \[1, 2\], text is accepted"),
        ("type", "7", "type of a topic: found 7, text is accepted"),
        ("message_count", "abc", "message_count of .*: found 'abc', a whole number of at least 0"),
        ("message_count", "-3", "message_count of .*: found -3"),
        ("message_count", "true", "message_count of .*: found True"),
    ],
)
def test_what_the_metadata_says_of_topics_is_checked(
    tmp_path: Path, key: str, written: str, words: str
) -> None:
    source = bag(tmp_path / "a", scene(), MCAP)
    path = source / "metadata.yaml"
    metadata = yaml.safe_load(path.read_text())
    for topic in metadata["rosbag2_bagfile_information"]["topics_with_message_count"]:
        (topic if key == "message_count" else topic["topic_metadata"])[key] = yaml.safe_load(written)
    path.write_text(yaml.safe_dump(metadata))
    with pytest.raises(InputError, match=f"metadata.yaml: {words}"):
        imported(source)


def _bomb(n_bytes: int) -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(bytes(n_bytes))


def test_a_chunk_that_is_blown_up_is_refused_before_the_library_sees_it(tmp_path: Path) -> None:
    source = bag(tmp_path / "a", scene(), MCAP)
    (path,) = source.glob("*.mcap")
    packed = _bomb(MAX_RECORD_BYTES + 1)
    data = path.read_bytes()
    body = struct.pack("<QQQI", 0, 0, MAX_RECORD_BYTES + 1, 0) + struct.pack("<I", 4) + b"zstd"
    body += struct.pack("<Q", len(packed)) + packed
    end = data.index(b"\x0f\x04" + bytes(7))  # the record at the end of the data
    path.write_bytes(data[:end] + struct.pack("<BQ", 6, len(body)) + body + data[end:])
    with pytest.raises(InputError, match=rf"{path.name}: chunk at byte {end} .*{MAX_RECORD_BYTES} accepted"):
        imported(source)


def test_a_file_that_is_blown_up_is_refused_before_the_library_sees_it(tmp_path: Path) -> None:
    source = bag(tmp_path / "a", scene(), SQLITE, CompressionMode.FILE)
    (path,) = source.glob("*.zstd")
    path.write_bytes(_bomb(2**26 + 1))
    with pytest.raises(InputError, match=f"{path.name}: holds more than {2**26} bytes"):
        imported(source)


def test_a_packed_file_without_an_index_is_refused_before_the_library_sees_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without an index the library goes through all chunks when it opens a file, and decompresses them."""
    source = bag(tmp_path / "a", scene(), MCAP, CompressionMode.FILE)
    (path,) = source.glob("*.zstd")
    packed = _bomb(MAX_RECORD_BYTES + 1)
    body = struct.pack("<QQQI", 0, 0, MAX_RECORD_BYTES + 1, 0) + struct.pack("<I", 4) + b"zstd"
    body += struct.pack("<Q", len(packed)) + packed
    chunk, end = struct.pack("<BQ", 6, len(body)) + body, struct.pack("<BQI", 15, 4, 0)
    footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    path.write_bytes(zstandard.compress(MAGIC + chunk + end + footer + MAGIC))

    def opened(self: object) -> None:
        raise AssertionError("the library has seen it")

    monkeypatch.setattr(McapReader, "_open", opened)
    with pytest.raises(
        InputError, match=rf"{path.stem}: chunk at byte 8 .*{MAX_RECORD_BYTES} accepted"
    ) as error:
        imported(source)
    assert error.value.lines[0].startswith(str(source))


@pytest.mark.parametrize("mode", [None, CompressionMode.FILE])
def test_rows_without_end_are_not_counted_to_the_end(
    tmp_path: Path, mode: CompressionMode | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An inner page of a tree may name one leaf as often as it likes, and so may those above it."""
    source = bag(tmp_path / "a", scene(), SQLITE)
    (path,) = source.glob("*.db3")
    with closing(sqlite3.connect(path)) as database, database:
        rows = ((i, 0, i, b"") for i in range(10**6, 10**6 + 50_000))
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    page_bytes, levels = 4096, 4
    data = bytearray(path.read_bytes())
    top = page_bytes * (root - 1)
    assert data[top] == 5  # an inner page
    # Its place is taken by pages on top of each other, each naming the next one five hundred times.
    page = bytearray(data[top : top + page_bytes])
    last = len(data) // page_bytes
    numbers = [root, *range(last + 1, last + levels)]
    (leaf,) = struct.unpack_from(">I", page, struct.unpack_from(">H", page, 12)[0])
    for number, below in zip(numbers, [*numbers[1:], leaf], strict=True):
        cells = 500
        made = bytearray(page_bytes)
        struct.pack_into(">BHHHBI", made, 0, 5, 0, cells, page_bytes - 5 * cells, 0, below)
        for i in range(cells):
            at = page_bytes - 5 * (i + 1)
            struct.pack_into(">H", made, 12 + 2 * i, at)
            struct.pack_into(">IB", made, at, below, 1)
        data[page_bytes * (number - 1) : page_bytes * number] = made
    struct.pack_into(">I", data, 28, len(data) // page_bytes)
    path.write_bytes(data)
    if mode is not None:
        packed = path.with_suffix(".db3.zstd")
        packed.write_bytes(zstandard.compress(bytes(data)))
        path.unlink()
        described = yaml.safe_load((source / "metadata.yaml").read_text())
        described["rosbag2_bagfile_information"] |= {
            "relative_file_paths": [packed.name],
            "compression_mode": "FILE",
            "compression_format": "zstd",
        }
        (source / "metadata.yaml").write_text(yaml.safe_dump(described))
    monkeypatch.setattr(rosbag2, "_MOST_STEPS", 10**7)
    with pytest.raises(
        InputError, match=rf"{path.name}: its messages are not counted within the 10000000 steps"
    ):
        imported(source)


@pytest.mark.parametrize("declared", [True, False])
def test_a_message_that_is_blown_up_is_lost_alone(tmp_path: Path, declared: bool) -> None:
    source = bag(tmp_path / "a", scene(), SQLITE, CompressionMode.MESSAGE)
    (path,) = source.glob("*.db3")
    packer = zstandard.ZstdCompressor(level=1, write_content_size=declared)
    with sqlite3.connect(path) as database:
        (first,) = database.execute("SELECT min(timestamp) FROM messages").fetchone()
        bomb = packer.compress(bytes(MAX_RECORD_BYTES + 1))
        database.execute("UPDATE messages SET data = ? WHERE timestamp = ?", (bomb, first))
    path, result = imported(source)
    (loss,) = result.losses
    assert loss.count == 3
    assert len(folders.poses_in(path, POSE).times_ns) == N - 1
    assert "messages lost in damage" in loss.what
    assert f"{MAX_RECORD_BYTES}" in loss.what


def test_a_row_larger_than_fits_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = bag(tmp_path / "a", scene(), SQLITE)
    (path,) = source.glob("*.db3")
    with sqlite3.connect(path) as database:
        (last,) = database.execute("SELECT max(timestamp) FROM messages").fetchone()
        database.execute("UPDATE messages SET data = ? WHERE timestamp = ?", (bytes(50_001), last))
    monkeypatch.setattr(rosbag2, "MAX_RECORD_BYTES", 50_000)
    _, result = imported(source)
    (loss,) = result.losses
    assert "messages lost in damage: " in loss.what
