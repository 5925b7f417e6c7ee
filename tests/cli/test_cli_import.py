"""`vmf import`: what others recorded is trained on and tracked like a recording of our own."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from vmf_command import same_results, summary, train, vmf

from vmf.data.recording import IMAGE_TOPICS, describe, read
from vmf.data.recording.container import scan
from vmf.data.recording.shown import ANNOTATION_TOPICS, BODY_TRANSFORM_TOPIC
from vmf.data.recording.transforms import read_transforms, select
from vmf.data.tracks import Tracks
from vmf.spec import PoseSource, Recording, TrackSource

EVALUATE = {"protocol": ["held_out"], "gaps": [2], "bootstrap": 20}
WHERE = {"pose": {"topic": "/robot/pose"}, "tracks": {"topic": "/stereo/tracks"}}


def spec_file(folder: Path, name: str, data: dict[str, object]) -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({"task": "six_dof", "data": data, "evaluate": EVALUATE, "name": "same"}))
    return path


def simulated(folder: Path, film: bool = False, /, **settings: object) -> Path:
    spec = spec_file(folder, "simulated", {"simulate": {"seed": 4, **settings}})
    flags = ["--images"] if film else []
    said = vmf("simulate", spec, "-o", folder / "simulated.mcap", "--quiet", *flags)
    assert (said.code, said.err) == (0, "")
    return folder / "simulated.mcap"


def tracks_of(path: Path) -> Tracks:
    source = Recording(
        path=str(path), pose=PoseSource(topic="/robot/pose"), tracks=TrackSource(topic="/stereo/tracks")
    )
    return read(source, "eye_in_hand", path.parent).tracks


def as_npz(recording: Path, path: Path, **more: object) -> Path:
    tracks = tracks_of(recording)
    contents = scan(recording, lambda topic: topic.name == "/robot/pose")
    streams, _ = read_transforms(contents.on("/robot/pose"), "/robot/pose")
    values = select(streams, None, None, "/robot/pose").values
    pixels = np.full((tracks.n_frames, tracks.n_targets, 4), np.nan)
    pixels[tracks.frame, tracks.target] = tracks.pixels
    arrays = {
        "times_ns": tracks.times_ns,
        "position_m": values[:, :3],
        "quaternion_xyzw": values[:, 3:],
        "pixels": pixels,
        "ids": np.array(tracks.ids),
        "image_size": np.array(tracks.image_size),
        **more,
    }
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path


def test_training_on_what_was_imported_gives_the_same_numbers(tmp_path: Path) -> None:
    recording = simulated(tmp_path, frames=60)
    source = as_npz(recording, tmp_path / "mine.npz")
    said = vmf("import", "npz", source, "-o", tmp_path / "mine.mcap")
    assert said.code == 0, said
    first, *topics = said.out.splitlines()
    # A pose, its transform, the tracks, and what is drawn of them over either image.
    assert first == f"{tmp_path / 'mine.mcap'}: 300 messages from npz"
    assert {line.split(":")[0].strip(): line.split(", ")[1] for line in topics} == dict.fromkeys(
        ("/robot/pose", BODY_TRANSFORM_TOPIC, "/stereo/tracks", *ANNOTATION_TOPICS), "60"
    )
    assert said.err.startswith("messages: 120 of 120 after ")
    runs = []
    for name in ("simulated", "mine"):
        data = {"recording": {"path": str(tmp_path / f"{name}.mcap"), **WHERE}}
        runs.append(train(spec_file(tmp_path, name, data), tmp_path / name))
    assert same_results(*runs)
    mine = summary(runs[1]).set_index(["method", "component"])["median"]
    assert mine["vmf", "distance"] < 0.5 * mine["no_motion", "distance"]
    info = describe(tmp_path / "mine.mcap")
    assert (info.attachments, info.losses) == (("import.yaml",), ())


def test_tracking_in_imported_images_gives_the_same_tracks(tmp_path: Path) -> None:
    film = simulated(tmp_path, True, frames=5, targets=3, motion="hand_guided", images={"targets": "tag"})
    as_euroc(film, tmp_path / "euroc")
    said = vmf("import", "euroc", tmp_path / "euroc", "-o", tmp_path / "imported.mcap", "--json", "--quiet")
    assert (said.code, said.err) == (0, "")
    told = json.loads(said.out)
    assert {t["name"]: t["count"] for t in told["topics"]} == dict.fromkeys(
        ("/robot/pose", BODY_TRANSFORM_TOPIC, *IMAGE_TOPICS), 5
    )
    for path in (film, tmp_path / "imported.mcap"):
        said = vmf(
            "track", path, "-o", tmp_path / f"{path.stem}_tracks.mcap", "--tracker", "aruco", "--quiet"
        )
        assert said.code == 0, said
    a, b = (tracks_of(tmp_path / f"{name}_tracks.mcap") for name in (film.stem, "imported"))
    assert a.ids == b.ids
    for name in ("times_ns", "E_S_from_W", "frame", "target", "pixels"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def as_euroc(film: Path, folder: Path) -> None:
    cameras = dict(zip(IMAGE_TOPICS, ("cam0", "cam1"), strict=True))
    tables: dict[str, list[str]] = {"cam0": [], "cam1": [], "state_groundtruth_estimate0": []}
    with film.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, m in reader.iter_decoded_messages([*cameras, "/robot/pose"]):
            time = m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
            if channel.topic in cameras:
                camera = cameras[channel.topic]
                image = folder / "mav0" / camera / "data" / f"{time}.jpg"
                image.parent.mkdir(parents=True, exist_ok=True)
                image.write_bytes(m.data)
                tables[camera].append(f"{time},{image.name}")
            else:
                p, q = m.pose.position, m.pose.orientation
                cells = (time, p.x, p.y, p.z, q.w, q.x, q.y, q.z)
                tables["state_groundtruth_estimate0"].append(",".join(map(repr, cells)))
    for name, rows in tables.items():
        table = folder / "mav0" / name / "data.csv"
        table.parent.mkdir(exist_ok=True)
        table.write_text("\n".join(["#timestamp [ns]", *rows]) + "\n")


def test_what_is_lost_is_said_and_counted(tmp_path: Path) -> None:
    recording = simulated(tmp_path, frames=10)
    pixels = np.full((10, tracks_of(recording).n_targets, 4), 5.0)
    pixels[2, 0, 1] = np.inf
    source = as_npz(recording, tmp_path / "mine.npz", pixels=pixels)
    said = vmf("import", "npz", source, "-o", tmp_path / "mine.mcap", "--quiet")
    assert said.code == 3
    assert said.err.splitlines() == [
        f"lost: {source}: pixels with NaN in one coordinate, infinite or absurd values dropped (1)"
    ]
    assert (tmp_path / "mine.mcap").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["eurok", "x"], ["found the format 'eurok', accepted: euroc, tum, kitti, npz, csv, rosbag2"]),
        (["euroc", "."], ["found no state_groundtruth_estimate0/data.csv or vicon0/data.csv"]),
        (["tum", "nowhere"], ["nowhere: no such file or directory"]),
        (["tum", "."], ["groundtruth.txt: no such file"]),
        (["kitti", ".", "axis=body"], ["axis", "did you mean axes?"]),
        (["kitti", ".", "axes=wheel"], ["axes", "found 'wheel'", "camera"]),
        (["csv", ".", "image_size=[0,3]"], ["image_size.0", "found 0"]),
        (["npz", "."], ["cannot be read"]),
    ],
)
def test_wrong_input_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    vmf("import", *arguments, "-o", "a.mcap").refused(*words)
    assert list(tmp_path.iterdir()) == []


def test_the_output_is_a_recording_by_its_name(tmp_path: Path) -> None:
    source = as_npz(simulated(tmp_path, frames=3), tmp_path / "mine.npz")
    vmf("import", "npz", source, "-o", tmp_path / "mine.bag").refused("found a name without .mcap")
    vmf("import", "npz", source, "-o", tmp_path / "no" / "a.mcap", "--quiet").refused("cannot be written")
