"""Tiny folders in the formats of others, and what a recording made of one holds."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import recording_files as files
from image_files import encoded, picture
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from vmf.data.poses import BodyPoses
from vmf.data.recording import IMAGE_TOPICS, POSE_TOPIC
from vmf.data.recording.container import scan
from vmf.data.recording.transforms import Stream, read_transforms, select
from vmf.experiment.importing import ImportResult, import_recording

N = 6


@dataclass(frozen=True)
class Scene:
    """N frames: times (ns), poses, and a left and a right image for each."""

    times_ns: np.ndarray
    poses: BodyPoses
    images: tuple[list[bytes], list[bytes]]

    @property
    def values(self) -> np.ndarray:
        return np.hstack([self.poses.position_m, self.poses.quaternion_xyzw])


def scene(start_ns: int = files.START_NS, form: str = "png") -> Scene:
    times, poses = files.moving_robot(N, seed=3)
    left, right = ([encoded(picture(2 * i + side), form) for i in range(N)] for side in (0, 1))
    return Scene(times - files.START_NS + start_ns, poses, (left, right))


def lines(path: Path, *texts: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(texts) + "\n")
    return path


def image_folder(folder: Path, images: list[bytes], names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in zip(names, images, strict=True):
        (folder / name).write_bytes(data)


def seconds(ns: int) -> str:
    return f"{ns // 10**9}.{ns % 10**9:09d}"


def euroc(folder: Path, scene: Scene, pose: str = "state_groundtruth_estimate0") -> Path:
    names = [f"{t}.png" for t in scene.times_ns]
    for camera, images in zip(("cam0", "cam1"), scene.images, strict=True):
        image_folder(folder / "mav0" / camera / "data", images, names)
        listed = [f"{t},{name}" for t, name in zip(scene.times_ns, names, strict=True)]
        lines(folder / "mav0" / camera / "data.csv", "#timestamp [ns],filename", *listed)
    rows = [
        ",".join(map(repr, (t, *p, q[3], *q[:3], 0.1, 0.2, 0.3)))
        for t, p, q in zip(
            scene.times_ns.tolist(),
            scene.poses.position_m.tolist(),
            scene.poses.quaternion_xyzw.tolist(),
            strict=True,
        )
    ]
    head = "#timestamp, p_RS_R_x [m], p_y, p_z, q_RS_w [], q_x, q_y, q_z, v_x, v_y, v_z"
    lines(folder / "mav0" / pose / "data.csv", head, *rows)
    return folder


def tum(folder: Path, scene: Scene, listed: bool = True) -> Path:
    stamps = [seconds(t) for t in scene.times_ns.tolist()]
    names = [f"{t}.png" for t in stamps]
    for side, images in zip(("left", "right"), scene.images, strict=True):
        image_folder(folder / f"image_{side}", images, names)
        if listed:
            shutil.move(folder / f"image_{side}", folder / side)
            rows = [f"{t} {side}/{name}" for t, name in zip(stamps, names, strict=True)]
            lines(folder / f"{side}.txt", "# timestamp filename", *rows)
    rows = [f"{t} " + " ".join(map(repr, row)) for t, row in zip(stamps, scene.values.tolist(), strict=True)]
    lines(folder / "groundtruth.txt", "# timestamp tx ty tz qx qy qz qw", *rows)
    return folder


def kitti(folder: Path, scene: Scene, cameras: tuple[str, str] = ("image_0", "image_1")) -> Path:
    for camera, images in zip(cameras, scene.images, strict=True):
        image_folder(folder / camera, images, [f"{i:06d}.png" for i in range(N)])
    lines(folder / "times.txt", *(f"{t / 1e9:.9e}" for t in scene.times_ns.tolist()))
    T = scene.poses.motions("eye_to_hand")[:, :3].reshape(N, 12)
    lines(folder / "poses.txt", *(" ".join(map(repr, row)) for row in T.tolist()))
    return folder


def imported(kind: str, source: Path, *options: str) -> tuple[Path, ImportResult]:
    output = source.parent / "imported.mcap"
    return output, import_recording(kind, source, output, options)


def poses_in(path: Path, topic: str = POSE_TOPIC) -> Stream:
    contents = scan(path, lambda t: t.name == topic)
    assert contents.losses == ()
    streams, losses = read_transforms(contents.on(topic), topic)
    assert losses == ()
    return select(streams, None, None, topic)


def images_in(path: Path, topics: tuple[str, str] = IMAGE_TOPICS) -> list[list[tuple[int, str, bytes]]]:
    """Stamps, formats and bytes of the left and the right images, in file order."""
    found: dict[str, list[tuple[int, str, bytes]]] = {topic: [] for topic in topics}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, m in reader.iter_decoded_messages(topics, log_time_order=False):
            time = m.header.stamp.sec * 10**9 + m.header.stamp.nanosec
            found[channel.topic].append((time, m.format, bytes(m.data)))
    return [found[topic] for topic in topics]


def assert_holds(path: Path, scene: Scene, form: str = "png") -> None:
    """Images, times and poses are the scene's bit for bit."""
    for got, images in zip(images_in(path), scene.images, strict=True):
        assert got == [(t, form, data) for t, data in zip(scene.times_ns.tolist(), images, strict=True)]
    stream = poses_in(path)
    np.testing.assert_array_equal(stream.times_ns, scene.times_ns)
    np.testing.assert_array_equal(stream.values, scene.values)
