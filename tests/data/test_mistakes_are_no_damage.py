"""A mistake in our own decoders is a traceback; only what is wrong with a file is counted as its damage."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import recording_files as files
from image_files import LEFT, RIGHT, ImageFile, encoded, json_compressed, picture, stereo
from recording_files import START_NS, File, header, read_at, track_message

from vmf.data.images import StereoImages
from vmf.data.importers import npz
from vmf.data.importers.image_files import ImageList
from vmf.data.recording import describe, schemas
from vmf.data.recording.damage import DamagedError, LibraryCalls, each, fields

# What a mistake in a program raises, as damage does in the libraries.
MISTAKES = (TypeError, KeyError, AttributeError, IndexError, ValueError, RuntimeError, AssertionError)
PERIOD_NS = 100_000_000


def recording(folder: Path) -> Path:
    with File(folder / "a.mcap") as file:
        file.sound(3)
    return folder / "a.mcap"


def turning(folder: Path) -> Path:
    with File(folder / "a.mcap") as file:
        for ns in (START_NS, START_NS + PERIOD_NS):
            state = {"name": ["pan", "tilt"], "position": [0.1, 0.2], "velocity": [], "effort": []}
            file.ros("/joints", schemas.JOINT_STATE, {"header": header(ns), **state}, ns)
            file.tracks(track_message(ns, [("a", [1, 2], [3, 4])]), ns)
    return folder / "a.mcap"


def filmed(folder: Path) -> StereoImages:
    with ImageFile(folder / "a.mcap") as file:
        for i in range(3):
            file.pair(START_NS + i * PERIOD_NS, i)
    return stereo(folder / "a.mcap")


def listed_images(folder: Path) -> ImageList:
    (folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    return ImageList(folder, [folder / "a.png"], np.array([START_NS]))


def archive(folder: Path) -> Path:
    np.savez(folder / "a.npz", times_ns=np.arange(3))
    return folder / "a.npz"


JOINTS = {"pose": None, "joints": {"topic": "/joints", "pan": "pan", "tilt": "tilt"}}


@dataclass(frozen=True)
class Planted:
    """A function of ours in which a mistake is made, and what uses it."""

    place: str
    use: Callable[[Path], object]


PLANTED = (
    Planted("recording.container.decompressed", lambda f: describe(recording(f))),
    Planted("recording.container.checked", lambda f: describe(recording(f))),
    Planted("recording.container.stream", lambda f: describe(loose(f))),
    Planted("recording.observations.stamp_ns", lambda f: read_at(recording(f))),
    Planted("recording.observations._pixel", lambda f: describe(recording(f))),
    Planted("recording.observations._listed_targets", lambda f: describe(recording(f))),
    Planted("recording.transforms._transform", lambda f: read_at(recording(f))),
    Planted("recording.transforms.number", lambda f: describe(recording(f))),
    Planted("recording.joints.number", lambda f: read_at(turning(f), **JOINTS)),
    Planted("images.decode.stamp_ns", filmed),
    Planted("images.decode._content", lambda f: list(filmed(f).pairs(grey=True))),
    Planted("images.decode.from_compressed", lambda f: list(filmed(f).pairs(grey=True))),
    Planted("images.compressed.check_size", lambda f: list(filmed(f).pairs(grey=True))),
    Planted("importers.image_files.stated", lambda f: list(listed_images(f).pictures())),
    Planted("importers.image_files.stated", lambda f: listed_images(f).size()),
    Planted("importers.npz._declared", lambda f: npz.look(archive(f), npz.NpzOptions())),
)


def loose(folder: Path) -> Path:
    with File(folder / "a.mcap", use_chunking=False) as file:
        file.sound(3)
    return folder / "a.mcap"


@pytest.mark.parametrize("planted", PLANTED, ids=lambda planted: planted.place)
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_of_ours_is_let_through(
    planted: Planted, mistake: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mistaken(*_: object, **__: object) -> None:
        raise mistake("a mistake in our own code")

    monkeypatch.setattr(f"vmf.data.{planted.place}", mistaken)
    with pytest.raises(mistake, match="a mistake in our own code") as caught:
        planted.use(tmp_path)
    assert not isinstance(caught.value, DamagedError)


@pytest.mark.parametrize("raised", MISTAKES)
def test_what_a_library_raises_is_damage(raised: type[Exception]) -> None:
    with pytest.raises(DamagedError, match="bits are wrong") as caught, LibraryCalls():
        raise raised("bits are wrong")
    assert type(caught.value.__cause__) is raised


def failing() -> Iterator[int]:
    yield from (1, 2)
    raise KeyError("record 3")


def test_a_library_s_iterator_meets_damage_while_it_is_iterated() -> None:
    items = each(failing())
    assert [next(items), next(items)] == [1, 2]
    with pytest.raises(DamagedError, match="record 3"):
        next(items)


def test_what_is_done_with_its_items_is_none_of_the_library_s() -> None:
    def use() -> None:
        for item in each(failing()):
            raise KeyError(f"mine, with {item}")

    with pytest.raises(KeyError, match="mine, with 1"):
        use()


@pytest.mark.parametrize("message", [None, 5, "text", [], {}], ids=repr)
def test_a_field_that_is_not_there_is_damage(message: object) -> None:
    for path in ("pose", "pose.position.x"):
        with pytest.raises(DamagedError, match="no field pose"):
            fields(path)(message)
    with pytest.raises(DamagedError, match="no field pose"):
        fields("pose", "__class__")(message)


def pose_of(**wrong: object) -> dict[str, object]:
    position, orientation = {"x": 0.0, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    pose = {"position": position, "orientation": orientation}
    stamp = {"sec": START_NS // 10**9, "nanosec": 0}
    return {"header": {"stamp": stamp, "frame_id": "world"}, "pose": pose, **wrong}


@pytest.mark.parametrize(
    "wrong",
    [
        {"header": None},
        {"header": {"frame_id": "world"}},
        {"header": {"stamp": "today", "frame_id": "world"}},
        {"header": {"stamp": {"sec": 1.5, "nanosec": 0}, "frame_id": "world"}},
        {"header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": ["world"]}},
        {"pose": None},
        {"pose": "here"},
        {"pose": {"position": 3.0, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}},
        {"pose": {"position": {"x": "0", "y": 0.0, "z": 0.0}, "orientation": {}}},
        {"pose": {"position": {"x": 10**400, "y": 0.0, "z": 0.0}, "orientation": {}}},
    ],
    ids=str,
)
def test_a_field_of_another_kind_is_damage(wrong: dict[str, object], tmp_path: Path) -> None:
    with File(tmp_path / "a.mcap") as file:
        file.sound(3)
        file.json("/json", schemas.POSE_STAMPED, pose_of(**wrong))
        file.json("/json", schemas.POSE_STAMPED, pose_of())
    found = describe(tmp_path / "a.mcap")
    (json_poses,) = (poses for poses in found.poses if poses.topic == "/json")
    assert json_poses.count == 1
    assert [(loss.place, loss.count) for loss in found.losses] == [("/json", 1)]


@pytest.mark.parametrize("joint", [["pan"], {"pan": 1}, 7, None], ids=repr)
def test_names_of_joints_that_are_no_text_are_damage(joint: object, tmp_path: Path) -> None:
    with File(tmp_path / "a.mcap") as file:
        for i, names in enumerate(([joint, "tilt"], ["pan", "tilt"])):
            ns = START_NS + i * PERIOD_NS
            stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
            state = {"header": {"stamp": stamp}, "name": names, "position": [0.1, 0.2]}
            file.json("/joints", schemas.JOINT_STATE, state, ns)
            file.tracks(track_message(ns, [("a", [1, 2], [3, 4])]), ns)
    data = read_at(tmp_path / "a.mcap", **JOINTS)
    assert data.tracks.n_frames == 1
    assert "/joints: malformed joint messages dropped" in files.losses(data)


def test_a_topic_of_two_schemas_is_read_by_each_alone(tmp_path: Path) -> None:
    """Messages were read by another schema's rules, which counted them as damaged."""
    with File(tmp_path / "a.mcap") as file:
        sound = file.sound(3)
        as_tracks = file.writer.register_schema(schemas.STEREO_TRACKS, "jsonschema", b"{}")
        channel = file.writer.register_channel("/pose", "json", as_tracks)
        seen = json.dumps(track_message(START_NS, [("a", [1, 2], [3, 4])])).encode()
        file.writer.add_message(channel, START_NS, seen, START_NS)
    found = describe(tmp_path / "a.mcap")
    assert [poses.count for poses in found.poses] == [len(sound.times)]
    assert {tracks.topic: tracks.frames for tracks in found.tracks} == {"/pose": 1, "/tracks": 3}
    assert found.losses == ()


def test_an_image_whose_data_is_a_number_takes_no_memory(tmp_path: Path) -> None:
    """As many zeros were made of it, and memory was taken for all of them."""
    path = tmp_path / "a.mcap"
    with File(path) as file:
        for i in range(2):
            ns = START_NS + i * PERIOD_NS
            sound = json_compressed(ns, encoded(picture()))
            for topic in (LEFT, RIGHT):
                file.json(
                    topic, schemas.FOXGLOVE_COMPRESSED_IMAGE, sound | ({"data": 10**9} if i else {}), ns
                )
    images = stereo(path)
    tracemalloc.start()
    first, second = images.pairs(grey=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert first is not None
    assert second is None
    assert peak < 10**8
    assert {loss.what for loss in images.losses} == {"damaged images dropped; first: data of int is no image"}
