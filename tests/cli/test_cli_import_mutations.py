"""Damaged folders, arrays, tables and bags through `vmf import`: it ends in one of the documented ways.

`make fuzz` does the same with ten times as many.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from confined import Confined, objection
from mutations import cut_off, cut_out, flip_bits, overwrite, repeat, wrong_number
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from vmf_command import vmf

# Importing is quick and its formats are plain: a quarter of the cases that recordings get.
CASES = int(os.environ.get("VMF_FUZZ_CASES", "1000")) // 4
BATCHES = max(4, CASES // 60)
N, K = 5, 3
START_NS = 10**18
WORDS = (b"nan", b"-1", b"1e999", b"", b"9" * 20, b"inf", b"0", b"# ", b'"', b"../x", b"[", b"\0")


def text(path: Path, *lines: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def poses() -> np.ndarray:
    """Position x y z and quaternion x y z w (N, 7)."""
    return np.column_stack([0.1 * np.arange(3 * N).reshape(N, 3), np.zeros((N, 3)), np.ones(N)])


def pictures(folder: Path, names: list[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    for name in names:
        image = rng.integers(0, 255, (6, 8)).astype(np.uint8)
        (folder / name).write_bytes(cv2.imencode(".png", image)[1].tobytes())


def words(values: np.ndarray) -> str:
    return " ".join(map(repr, values.tolist()))


def npz(path: Path) -> None:
    path.mkdir()
    P = poses()
    pixels = np.arange(N * K * 4, dtype=float).reshape(N, K, 4)
    times = START_NS + 10**8 * np.arange(N)
    np.savez(
        path / "a.npz",
        times_ns=times,
        position_m=P[:, :3],
        quaternion_xyzw=P[:, 3:],
        pixels=pixels,
        ids=np.array(["a", "b", "c"]),
        image_size=np.array([640, 480]),
    )


def csv(path: Path) -> None:
    rows = [",".join(map(repr, [float(i), *row])) for i, row in enumerate(poses().tolist())]
    text(path / "pose.csv", "time_s,x_m,y_m,z_m,qx,qy,qz,qw", *rows)
    rows = [f"{i},{k},{i + k},2.5,{i},3.5" for i in range(N) for k in range(K)]
    text(path / "tracks.csv", "time_s,id,x_L_px,y_L_px,x_R_px,y_R_px", *rows)


def kitti(path: Path) -> None:
    for camera in ("image_0", "image_1"):
        pictures(path / camera, [f"{i:06d}.png" for i in range(N)])
    text(path / "times.txt", *(f"{i / 10:e}" for i in range(N)))
    T = np.tile(np.eye(4)[:3], (N, 1, 1))
    T[:, :, 3] = poses()[:, :3]
    text(path / "poses.txt", *map(words, T.reshape(N, 12)))
    P = np.array([700.0, 0, 4, 0, 0, 700, 3, 0, 0, 0, 1, 0])
    text(path / "calib.txt", f"P0: {words(P)}", f"P1: {words(P)}")


def tum(path: Path) -> None:
    for camera in ("image_left", "image_right"):
        pictures(path / camera, [f"{i}.5.png" for i in range(N)])
    text(path / "groundtruth.txt", "# time", *(f"{i}.5 {words(row)}" for i, row in enumerate(poses())))


def euroc(path: Path) -> None:
    T = words(np.eye(4).ravel()).replace(" ", ", ")
    for camera in ("cam0", "cam1"):
        pictures(path / camera / "data", [f"{i}.png" for i in range(N)])
        text(path / camera / "data.csv", "#time,name", *(f"{i},{i}.png" for i in range(N)))
        text(
            path / camera / "sensor.yaml",
            f"T_BS: {{cols: 4, rows: 4, data: [{T}]}}",
            "resolution: [8, 6]\nintrinsics: [5.0, 5.0, 4.0, 3.0]",
        )
    order = [0, 1, 2, 6, 3, 4, 5]
    rows = [",".join(map(repr, [i, *row])) for i, row in enumerate(poses()[:, order].tolist())]
    text(path / "state_groundtruth_estimate0" / "data.csv", "#time", *rows)


def bag(path: Path, plugin: StoragePlugin) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    of = store.types
    name = "geometry_msgs/msg/PoseStamped"
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/pose", name, typestore=store)
        for i, (x, y, z, *q) in enumerate(poses().tolist()):
            head = of["std_msgs/msg/Header"](of["builtin_interfaces/msg/Time"](i, 0), "world")
            pose = of["geometry_msgs/msg/Pose"](
                of["geometry_msgs/msg/Point"](x, y, z), of["geometry_msgs/msg/Quaternion"](*q)
            )
            writer.write(connection, i * 10**9, store.serialize_cdr(of[name](head, pose), name))


SOURCES = {
    "npz": npz,
    "csv": csv,
    "kitti": kitti,
    "tum": tum,
    "euroc": euroc,
    "rosbag2": lambda path: bag(path, StoragePlugin.MCAP),
    "rosbag2 in SQLite": lambda path: bag(path, StoragePlugin.SQLITE3),
}


def command(name: str, source: Path, output: Path) -> tuple[object, ...]:
    kind = name.split()[0]
    return "import", kind, source / "a.npz" if kind == "npz" else source, "-o", output, "--quiet"


def wrong_word(data: bytearray, rng: np.random.Generator) -> bytearray:
    """Put another word in the place of a number, a name or a part of one."""
    at = int(rng.integers(len(data)))
    n = int(rng.integers(0, 12))
    return data[:at] + bytearray(WORDS[rng.integers(len(WORDS))]) + data[at + n :]


MUTATIONS = (flip_bits, overwrite, cut_off, cut_out, repeat, wrong_number, wrong_word, wrong_word)


def damage(folder: Path, rng: np.random.Generator) -> str:
    """Damage one file of a folder, or take it away, and say how."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = files[rng.integers(len(files))]
    if rng.random() < 0.05:
        path.unlink()
        return f"{path.name} is gone"
    mutation = MUTATIONS[rng.integers(len(MUTATIONS))]
    path.write_bytes(mutation(bytearray(path.read_bytes()), rng))
    return f"{mutation.__name__} in {path.name}"


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("sources")
    for name, make in SOURCES.items():
        make(folder / name)
    return {name: folder / name for name in SOURCES}


def test_whole_sources_are_imported_whole(sources: dict[str, Path], tmp_path: Path) -> None:
    for name, source in sources.items():
        said = vmf(*command(name, source, tmp_path / f"{name}.mcap"))
        assert (said.code, said.err) == (0, ""), (name, said)


@pytest.mark.parametrize("batch", range(BATCHES))
def test_damaged_sources_end_in_one_of_the_documented_ways(
    batch: int, sources: dict[str, Path], tmp_path: Path
) -> None:
    wrong = []
    names = list(sources)
    source, output = tmp_path / "source", tmp_path / "imported.mcap"
    with Confined() as run:
        for number in range(batch, CASES, BATCHES):
            name = names[number % len(names)]
            shutil.rmtree(source, ignore_errors=True)
            output.unlink(missing_ok=True)
            shutil.copytree(sources[name], source)
            how = damage(source, np.random.default_rng([20_242, number]))
            said = run(*command(name, source, output))
            objected = objection(said)
            if objected is None and output.exists() != (said.code in (0, 3)):
                objected = f"exit code {said.code}, but the output is there: {output.exists()}"
            if objected is None and output.exists():
                read = run("info", output)
                # What a bag holds is passed on as it is, with the damage in it.
                whole = read.code == 0 or (name.startswith("rosbag2") and read.code == 3)
                objected = None if whole else f"a recording that is damaged itself: {read}"
            if objected is not None:
                wrong.append(f"case {number} ({name}: {how}): {objected}\n{said.err[-1500:]}")
    assert not wrong, "\n".join(wrong[:5])
