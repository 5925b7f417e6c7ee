"""Importers: what the folders of others hold is in the recording, bit for bit where numbers allow it."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import import_folders as folders
import numpy as np
import pytest
import recording_files as files
from image_files import encoded, picture
from import_folders import N, Scene, imported, lines, scene, seconds

from vmf.data.images import StereoImages
from vmf.data.importers import csv, tables
from vmf.data.poses import BodyPoses
from vmf.data.tracks import Tracks
from vmf.errors import InputError
from vmf.experiment.importing import import_recording
from vmf.geometry.camera import R_CAMERA_FROM_BODY
from vmf.spec import ImageSource

MakeFolder = Callable[[Path, Scene], Path]
IMAGE_FORMATS: dict[str, MakeFolder] = {"euroc": folders.euroc, "tum": folders.tum, "kitti": folders.kitti}


def lost(result: Any) -> dict[str, int]:
    return {loss.what.split(";")[0]: loss.count for loss in result.losses}


def refused(kind: str, source: Path, *options: str) -> str:
    """The one line with which an import is refused; nothing is left behind."""
    before = set(source.parent.iterdir())
    with pytest.raises(InputError) as error:
        imported(kind, source, *options)
    assert set(source.parent.iterdir()) == before
    return error.value.lines[0]


@pytest.mark.parametrize("form", ["png", "jpeg"])
def test_euroc(tmp_path: Path, form: str) -> None:
    world = scene(form=form)
    source = folders.euroc(tmp_path / "MH_01", world)
    path, result = imported("euroc", source)
    folders.assert_holds(path, world, form)
    assert (result.losses, result.repairs) == ((), ())
    by_mav0, _ = imported("euroc", source / "mav0")
    folders.assert_holds(by_mav0, world, form)


def test_euroc_takes_the_poses_there_are(tmp_path: Path) -> None:
    world = scene()
    source = folders.euroc(tmp_path / "V1", world, pose="vicon0")
    folders.assert_holds(imported("euroc", source)[0], world)
    (source / "mav0" / "vicon0").rename(source / "mav0" / "tracker")
    assert "no state_groundtruth_estimate0/data.csv or vicon0/data.csv" in refused("euroc", source)
    folders.assert_holds(imported("euroc", source, "pose=tracker")[0], world)


@pytest.mark.parametrize("listed", [True, False])
def test_tum(tmp_path: Path, listed: bool) -> None:
    world = scene()
    path, result = imported("tum", folders.tum(tmp_path / "seq", world, listed))
    folders.assert_holds(path, world)
    assert result.losses == ()


@pytest.mark.parametrize("cameras", [("image_0", "image_1"), ("image_2", "image_3")])
def test_kitti(tmp_path: Path, cameras: tuple[str, str]) -> None:
    # From 0 on, like KITTI's, so that a double holds the times to the nanosecond.
    world = scene(start_ns=0)
    path, result = imported("kitti", folders.kitti(tmp_path / "07", world, cameras))
    assert result.losses == ()
    for got, images in zip(folders.images_in(path), world.images, strict=True):
        assert got == [(t, "png", data) for t, data in zip(world.times_ns.tolist(), images, strict=True)]
    stream = folders.poses_in(path)
    np.testing.assert_array_equal(stream.times_ns, world.times_ns)
    E = BodyPoses(stream.values[:, :3], stream.values[:, 3:]).motions("eye_to_hand")
    # Matrix to quaternion and back: a few roundings of numbers up to 1.
    np.testing.assert_allclose(E, world.poses.motions("eye_to_hand"), rtol=0, atol=16 * np.finfo(float).eps)


def test_kitti_turned_to_body_axes(tmp_path: Path) -> None:
    """A point in front of the camera, z ahead, is x ahead in body axes; the same holds of the fixed frame."""
    world = scene(start_ns=0)
    path, _ = imported("kitti", folders.kitti(tmp_path / "07", world), "axes=body")
    values = folders.poses_in(path).values
    E = BodyPoses(values[:, :3], values[:, 3:]).motions("eye_to_hand")
    P_camera = np.array([0.3, -0.2, 4.0])
    P_body = np.array([4.0, -0.3, 0.2])
    T = world.poses.motions("eye_to_hand")
    x, y, z = (T[:, :3, :3] @ P_camera + T[:, :3, 3]).T
    np.testing.assert_allclose(E[:, :3, :3] @ P_body + E[:, :3, 3], np.stack([z, -x, -y], axis=1), atol=1e-13)
    np.testing.assert_array_equal(R_CAMERA_FROM_BODY @ P_body, P_camera)


def test_kitti_finds_the_poses_of_the_dataset(tmp_path: Path) -> None:
    world = scene(start_ns=0)
    source = folders.kitti(tmp_path / "sequences" / "07", world)
    (tmp_path / "poses").mkdir()
    (source / "poses.txt").rename(tmp_path / "poses" / "07.txt")
    assert folders.poses_in(imported("kitti", source)[0]).times_ns.tolist() == world.times_ns.tolist()
    (tmp_path / "poses" / "07.txt").rename(source / "mine.txt")
    assert "poses=FILE" in refused("kitti", source)
    assert len(folders.poses_in(imported("kitti", source, "poses=mine.txt")[0]).times_ns) == N


def dense(tracks: Tracks) -> np.ndarray:
    pixels = np.full((tracks.n_frames, tracks.n_targets, 4), np.nan)
    pixels[tracks.frame, tracks.target] = tracks.pixels
    return pixels


def npz(path: Path, **changed: object) -> tuple[Path, Tracks]:
    """Write an example; arrays `changed` to None are left out."""
    tracks, poses = files.example()
    assert isinstance(poses, BodyPoses)
    arrays: dict[str, object] = {
        "times_ns": tracks.times_ns,
        "position_m": poses.position_m,
        "quaternion_xyzw": poses.quaternion_xyzw,
        "pixels": dense(tracks),
        "ids": np.array(tracks.ids),
        "image_size": np.array(tracks.image_size),
        **changed,
    }
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})  # type: ignore[arg-type]
    return path, tracks


def test_npz_comes_back_bit_for_bit(tmp_path: Path) -> None:
    source, tracks = npz(tmp_path / "a.npz")
    path, result = imported("npz", source)
    assert (result.losses, result.repairs) == ((), ())
    files.assert_same(files.read_written(path).tracks, tracks)


def test_npz_with_matrices_and_seconds(tmp_path: Path) -> None:
    tracks, poses = files.example()
    T = poses.motions("eye_to_hand")
    source, _ = npz(
        tmp_path / "a.npz",
        times_ns=None,
        times_s=(tracks.times_ns - files.START_NS) / 1e9,
        position_m=None,
        quaternion_xyzw=None,
        poses=T,
        ids=None,
        image_size=None,
    )
    found = files.read_written(imported("npz", source)[0], mounting="eye_to_hand").tracks
    np.testing.assert_array_equal(found.times_ns, tracks.times_ns - files.START_NS)
    np.testing.assert_allclose(found.E_S_from_W, T, rtol=0, atol=16 * np.finfo(float).eps)
    np.testing.assert_array_equal(found.pixels, tracks.pixels)
    assert found.ids == tuple(map(str, range(tracks.n_targets)))
    assert found.image_size is None


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"pixels": None}, ["no array pixels; found: times_ns, position_m"]),
        ({"pixels": np.zeros((39, 5, 4))}, ["pixels: found float64 of shape (39, 5, 4)", "(40, any, 4)"]),
        ({"pixel": np.zeros(3)}, ["found an array 'pixel'; accepted: times_s"]),
        ({"quaternion_xyzw": np.full((40, 4), 0.6)}, ["quaternion_xyzw[0]", "norm 1.2", "1 within 0.001"]),
        (
            {
                "poses": np.tile(np.diag([1, 1, -1.0, 1]), (40, 1, 1)),
                "position_m": None,
                "quaternion_xyzw": None,
            },
            ["poses[0]: found no rotation", "determinant -1"],
        ),
        ({"ids": np.array(list("aabcd"))}, ["ids: found a name twice"]),
        ({"ids": np.array(["a", "b\ud800", "c", "d", "e"])}, ["ids: found 'b\\ud800'", "Unicode"]),
        ({"ids": np.array([{}] * 5, object)}, ["Object arrays cannot be loaded"]),
        ({"times_ns": -np.arange(40)}, ["times_ns[1]: found -1"]),
        ({"times_ns": None, "times_s": np.full(40, np.nan)}, ["times_s[0]: found nan"]),
        ({"image_size": np.array([0, 4])}, ["image_size: found 0, 4"]),
        ({"image_size": np.array([640, 2**40])}, ["image_size: found 640, 1099511627776", "to 65535"]),
        ({"times_s": np.arange(40.0)}, ["found both times_s and times_ns, one of them"]),
        ({"poses": np.tile(np.eye(4), (40, 1, 1))}, ["found both poses and position_m"]),
        (
            {"poses": np.tile(np.eye(4), (40, 1, 1)), "position_m": None},
            ["found both poses and quaternion_xyzw"],
        ),
        ({"position_m": np.full((40, 3), np.nan)}, ["no usable pose (40 with NaN"]),
        ({"pixels": np.full((40, 5, 4), np.nan)}, ["no pixel of any target"]),
    ],
)
def test_npz_refused(tmp_path: Path, changed: dict[str, object], words: list[str]) -> None:
    line = refused("npz", npz(tmp_path / "a.npz", **changed)[0])
    assert line.startswith(f"{tmp_path / 'a.npz'}")
    for word in words:
        assert word in line


def test_npz_of_other_bytes_is_refused(tmp_path: Path) -> None:
    data = npz(tmp_path / "a.npz")[0].read_bytes()
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "cut.npz").write_bytes(data[: len(data) // 2])
    flipped = bytearray(data)
    flipped[data.find(b"quaternion_xyzw.npy") + 300] ^= 0x10
    (tmp_path / "flipped.npz").write_bytes(flipped)
    for name in ("text", "cut", "flipped", "missing"):
        assert str(tmp_path / f"{name}.npz") in refused("npz", tmp_path / f"{name}.npz")


def test_npz_with_flipped_bits_is_refused_or_whole(tmp_path: Path, rng: np.random.Generator) -> None:
    """Every array has a checksum: what is read is what was written."""
    source, tracks = npz(tmp_path / "a.npz")
    with np.load(source) as archive:
        np.savez_compressed(source, **dict(archive))
    data = source.read_bytes()
    read = 0
    for at in rng.integers(0, 8 * len(data), 150):
        flipped = bytearray(data)
        flipped[at // 8] ^= 1 << (at % 8)
        source.write_bytes(flipped)
        try:
            path, _ = imported("npz", source)
        except InputError:
            continue
        read += 1
        found = files.read_written(path).tracks
        np.testing.assert_array_equal(dense(found), dense(tracks))
    assert read < 150


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        # 30 MB as they are, 240 MB as doubles; no memory may be taken for the one or the other.
        (
            {"pixels": np.zeros((40, 187_500, 4), np.int8)},
            ["pixels (40, 187500, 4)", "201326592 are"],
        ),
        ({"times_ns": np.zeros(2**20 + 1, np.int8)}, ["times_ns: found shape (1048577,)", "1048576"]),
    ],
)
def test_npz_too_large_is_refused_before_memory_is_taken(
    tmp_path: Path, changed: dict[str, object], words: list[str]
) -> None:
    path, _ = npz(tmp_path / "a.npz", **changed)
    with np.load(path) as archive:
        np.savez_compressed(path, **dict(archive))
    tracemalloc.start()
    line = refused("npz", path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2**20
    for word in words:
        assert word in line


def test_one_camera_is_no_stereo_pair(tmp_path: Path) -> None:
    euroc = folders.euroc(tmp_path / "euroc", scene())
    for options in (["left=cam1"], ["left=cam1", "right=cam1"], ["right=./cam0"]):
        assert "is given for both cameras" in refused("euroc", euroc, *options)
    tum = folders.tum(tmp_path / "tum", scene(), listed=False)
    assert "image_left is given for both" in refused("tum", tum, "left=image_left", "right=image_left")


def test_npz_losses_are_counted(tmp_path: Path) -> None:
    tracks, poses = files.example()
    pixels = dense(tracks)
    pixels[3, 1] = [1.0, np.nan, 5.0, 6.0]
    pixels[4, 1] = [1.0, 2.0, np.inf, 6.0]
    assert isinstance(poses, BodyPoses)
    position = poses.position_m.copy()
    position[5] = np.nan
    path, result = imported("npz", npz(tmp_path / "a.npz", pixels=pixels, position_m=position)[0])
    assert lost(result) == {
        "poses with NaN, infinite or absurd values dropped": 1,
        "pixels with NaN in one coordinate, infinite or absurd values dropped": 2,
    }
    pixels[3, 1, :2] = pixels[4, 1, 2:] = np.nan
    found = files.read_written(path, sync_tolerance_s=1e-6).tracks
    np.testing.assert_array_equal(dense(found), np.delete(pixels, 5, axis=0))


def csv_rows(tracks: Tracks) -> list[str]:
    """A row for each observation, frame by frame, and one for each empty frame."""
    rows = []
    for i, time in enumerate(tracks.times_ns.tolist()):
        seen = np.flatnonzero(tracks.frame == i)
        for k in seen:
            code = ["" if np.isnan(v) else repr(v) for v in tracks.pixels[k].tolist()]
            rows.append(",".join([seconds(time), tracks.ids[tracks.target[k]], *code]))
        if not len(seen):
            rows.append(f"{seconds(time)},,,,,")
    return rows


POSE_HEADER, TRACK_HEADER = "time_s,x_m,y_m,z_m,qx,qy,qz,qw", "time_s,id,x_L_px,y_L_px,x_R_px,y_R_px"


def csv_folder(folder: Path) -> tuple[Path, Tracks]:
    # Ids are numbered by first appearance: target 0 comes first.
    tracks, poses = files.example()
    assert isinstance(poses, BodyPoses)
    values = np.hstack([poses.position_m, poses.quaternion_xyzw]).tolist()
    rows = [
        ",".join([seconds(t), *map(repr, row)])
        for t, row in zip(tracks.times_ns.tolist(), values, strict=True)
    ]
    lines(folder / "pose.csv", POSE_HEADER, *rows)
    lines(folder / "tracks.csv", TRACK_HEADER, *csv_rows(tracks))
    return folder, tracks


def same_but_for_numbering(found: Tracks, tracks: Tracks) -> None:
    order = [found.ids.index(name) for name in tracks.ids]
    np.testing.assert_array_equal(dense(found)[:, order], dense(tracks))
    np.testing.assert_array_equal(found.times_ns, tracks.times_ns)
    np.testing.assert_array_equal(found.E_S_from_W, tracks.E_S_from_W)


def test_csv_in_two_files(tmp_path: Path) -> None:
    source, tracks = csv_folder(tmp_path / "seq")
    path, result = imported("csv", source, "image_size=[640,480]")
    assert result.losses == ()
    found = files.read_written(path).tracks
    same_but_for_numbering(found, tracks)
    assert found.image_size == (640, 480)


def test_comments_stand_above_the_header_of_a_table(tmp_path: Path) -> None:
    source, tracks = csv_folder(tmp_path / "seq")
    table = source / "tracks.csv"
    cells = [row.split(",") for row in table.read_text().splitlines()]
    # The name first, and beginning like a comment.
    rows = [
        ",".join([row[1] if k == 0 or not row[1] else f"#{row[1]}", row[0], *row[2:]])
        for k, row in enumerate(cells)
    ]
    lines(table, "# made by hand", *rows)
    path, result = imported("csv", source)
    assert result.losses == ()
    found = files.read_written(path).tracks
    assert sorted(found.ids) == sorted(f"#{name}" for name in tracks.ids)
    assert len(found.frame) == len(tracks.frame)


def test_csv_in_one_file(tmp_path: Path) -> None:
    folder, tracks = csv_folder(tmp_path / "seq")
    pose_of = dict(row.split(",", 1) for row in (folder / "pose.csv").read_text().splitlines())
    rows = (folder / "tracks.csv").read_text().splitlines()
    one = lines(tmp_path / "all.csv", *(f"{row},{pose_of[row.split(',')[0]]},more" for row in rows))
    same_but_for_numbering(files.read_written(imported("csv", one)[0]).tracks, tracks)
    text = one.read_text().splitlines()
    cells = text[2].split(",")
    cells[6] = "9.5"
    text[2] = ",".join(cells)
    lines(one, *text)
    found = refused("csv", one)
    assert found == f"{one}:4: found another pose than {one}:3 has at the same time"


def test_csv_counts_in_nanoseconds_too(tmp_path: Path) -> None:
    folder, tracks = csv_folder(tmp_path / "seq")
    for path in folder.iterdir():
        head, *rows = path.read_text().splitlines()
        lines(path, head.replace("time_s", "time_ns"), *(row.replace(".", "", 1) for row in rows))
    same_but_for_numbering(files.read_written(imported("csv", folder)[0]).tracks, tracks)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("pose.csv", "x_m", "x", ["pose.csv:1: no column x_m", "found: time_s, x, y_m"]),
        ("pose.csv", "time_s", "time", ["pose.csv:1: no column time_s; is time meant?"]),
        ("tracks.csv", "y_R_px", "x_R_px", ["tracks.csv:1: several columns x_R_px"]),
        ("pose.csv", "qw", "time_ns", ["pose.csv:1: found both time_s and time_ns"]),
        ("tracks.csv", "1700000000.000000000", "soon", ["tracks.csv:2, column 1: found 'soon', a time in s"]),
        (
            "tracks.csv",
            "1700000000.000000000",
            "-1",
            ["tracks.csv:2, column 1: found '-1', a time in s from 0"],
        ),
        ("tracks.csv", "1700000000.000000000", "1e999", ["tracks.csv:2, column 1: found '1e999'"]),
        ("tracks.csv", "target 1,", ",", ["found pixels without an id"]),
        ("tracks.csv", "target 1", '"target 1', ["tracks.csv"]),
    ],
)
def test_csv_refused(tmp_path: Path, name: str, old: str, new: str, words: list[str]) -> None:
    folder, _ = csv_folder(tmp_path / "seq")
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    line = refused("csv", folder)
    for word in words:
        assert word in line


def test_csv_without_rows_or_of_other_bytes_is_refused(tmp_path: Path) -> None:
    folder, _ = csv_folder(tmp_path / "seq")
    for data, word in (
        (b"", "is empty"),
        (b"\xff\xfe\x00", "is no text in UTF-8"),
        (TRACK_HEADER.encode(), "found no pixel of any target"),
        (b"x" * 100_000, "tracks.csv:1: is longer than the 65536 characters"),
        (TRACK_HEADER.encode() + b"\n1.0,a,1,2\n", "tracks.csv:2: found 4 columns, 6 are accepted"),
    ):
        (folder / "tracks.csv").write_bytes(data)
        assert word in refused("csv", folder)
    (folder / "tracks.csv").unlink()
    assert refused("csv", folder) == f"{folder / 'tracks.csv'}: no such file"


def test_csv_losses_are_counted(tmp_path: Path) -> None:
    folder, tracks = csv_folder(tmp_path / "seq")
    with (folder / "tracks.csv").open("a") as file:
        file.write(f"{seconds(int(tracks.times_ns[-1]))},new,1.0,,3.0,4.0\n")
        file.write(f"{seconds(int(tracks.times_ns[-1]))},new,7.0,8.0,9.0,4.0\n")
    path, result = imported("csv", folder)
    assert lost(result) == {
        "pixels with NaN in one coordinate, infinite or absurd values dropped": 1,
        "second observations of an id within one frame dropped": 1,
    }
    found = files.read_written(path).tracks
    mine = found.pixels[found.target == found.ids.index("new")]
    np.testing.assert_array_equal(mine, [[np.nan, np.nan, 3.0, 4.0]])


@pytest.mark.parametrize("kind", IMAGE_FORMATS)
def test_images_that_cannot_be_used_are_counted(tmp_path: Path, kind: str) -> None:
    world = scene(start_ns=0)
    source = IMAGE_FORMATS[kind](tmp_path / "seq", world)
    pictures = sorted(source.rglob("*.png"))
    left, right = pictures[:N], pictures[N:]
    left[1].unlink()
    left[2].write_bytes(b"GIF89a and so on")
    right[3].write_bytes(b"")
    right[4].write_bytes(encoded(picture(0))[:20])
    path, result = imported(kind, source)
    # Where a folder is listed by what is in it, nothing says that a file is missing.
    missing = {} if kind == "tum" and not (source / "left.txt").exists() else {"images listed but missing": 1}
    counts: dict[str, int] = {}
    for loss in result.losses:
        what = loss.what.split(";")[0]
        counts[what] = counts.get(what, 0) + loss.count
    assert counts == {**missing, "files that are no image dropped": 3}
    assert any("accepted: JPEG, PNG" in loss.what for loss in result.losses)
    assert [len(images) for images in folders.images_in(path)] == [N - 2, N - 2]
    assert sum(p is not None for p in StereoImages(path, ImageSource()).pairs(grey=True)) == N - 4
    for picture_file in right:
        picture_file.write_bytes(b"")
    path.unlink()
    assert "no image can be used" in refused(kind, source)


@pytest.mark.parametrize("kind", IMAGE_FORMATS)
def test_the_file_and_line_of_a_mistake_are_named(tmp_path: Path, kind: str) -> None:
    source = IMAGE_FORMATS[kind](tmp_path / "seq", scene(start_ns=0))
    names = {"euroc": "mav0/state_groundtruth_estimate0/data.csv", "tum": "groundtruth.txt"}
    table = source / names.get(kind, "poses.txt")
    separator = "," if kind == "euroc" else " "
    text = table.read_text().splitlines()
    row = 4 if kind == "kitti" else 5

    def with_cells(change: Callable[[list[str]], None]) -> str:
        cells = text[row - 1].split(separator)
        change(cells)
        lines(table, *text[: row - 1], separator.join(cells), *text[row:])
        return refused(kind, source)

    assert f"{table}:{row}, column 4: found 'abc', a number is accepted" in with_cells(
        lambda cells: cells.__setitem__(3, "abc")
    )
    assert f"{table}:{row}: found 3 columns" in with_cells(lambda cells: cells.__delitem__(slice(3, None)))
    found = with_cells(lambda cells: cells.__setitem__(6, "3.0"))
    assert f"{table}:{row}: found " in found
    assert "0.001 is accepted" in found
    table.unlink()
    assert source.name in refused(kind, source)


def test_names_that_lead_out_of_the_folder_are_refused(tmp_path: Path) -> None:
    source = folders.euroc(tmp_path / "seq", scene())
    table = source / "mav0" / "cam0" / "data.csv"
    for name in ("../../../../etc/passwd", "/etc/passwd", ""):
        lines(table, f"{files.START_NS},{name}")
        assert f"{table}:1: found {name!r}" in refused("euroc", source)


@pytest.mark.parametrize(
    ("kind", "name", "text", "words"),
    [
        ("kitti", "times.txt", "0.0\n0.1", ["found 6 poses for the 2 times"]),
        ("kitti", "times.txt", "0.0\nx\n", ["times.txt:2, column 1: found 'x', a time in s"]),
        ("tum", "left.txt", "1.0\n", ["left.txt:1: found 1 columns, 2 are accepted"]),
        ("tum", "left.txt", "# none\n", ["left.txt: names no image"]),
        ("euroc", "mav0/cam1/data.csv", "1.5,a.png\n", ["cam1/data.csv:1"]),
    ],
)
def test_lists_refused(tmp_path: Path, kind: str, name: str, text: str, words: list[str]) -> None:
    source = IMAGE_FORMATS[kind](tmp_path / "seq", scene(start_ns=0))
    (source / name).write_text(text)
    line = refused(kind, source)
    for word in words:
        assert word in line


def test_tum_names_must_be_times(tmp_path: Path) -> None:
    source = folders.tum(tmp_path / "seq", scene(), listed=False)
    (source / "image_left" / "000000_left.png").write_bytes(b"")
    assert "000000_left.png: name: found '000000_left', a time in s" in refused("tum", source)
    (source / "image_right").rename(source / "r")
    assert "left=NAME and right=NAME name others; found: groundtruth.txt, image_left, r" in refused(
        "tum", source
    )


def test_out_of_order_is_put_in_order_and_said(tmp_path: Path) -> None:
    world = scene()
    source = folders.euroc(tmp_path / "seq", world)
    table = source / "mav0" / "cam1" / "data.csv"
    head, *rows = table.read_text().splitlines()
    lines(table, head, rows[1], rows[0], *rows[2:])
    path, result = imported("euroc", source)
    folders.assert_holds(path, world)
    assert [(r.place, r.count) for r in result.repairs] == [(str(table), 1)]
    assert result.losses == ()


def test_an_existing_file_is_replaced_only_by_a_whole_one(tmp_path: Path) -> None:
    source = folders.euroc(tmp_path / "seq", scene())
    output = tmp_path / "imported.mcap"
    output.write_bytes(b"old")
    for image in (source / "mav0" / "cam1" / "data").iterdir():
        image.unlink()
    assert "no image can be used" in refused("euroc", source)
    assert output.read_bytes() == b"old"
    folders.euroc(source, scene())
    folders.assert_holds(imported("euroc", source)[0], scene())


def test_what_it_is_made_of_is_not_overwritten(tmp_path: Path) -> None:
    source = folders.tum(tmp_path / "seq", scene())
    mine = source / "mine.mcap"
    mine.write_bytes(b"mine")
    with pytest.raises(InputError, match="part of the source"):
        import_recording("tum", source, mine, ())
    assert mine.read_bytes() == b"mine"


def test_memory_does_not_grow_with_the_number_of_images(tmp_path: Path, rng: np.random.Generator) -> None:
    """Noise does not compress: an image has about a megabyte."""
    data = encoded(rng.integers(0, 256, (600, 600, 3), dtype=np.uint8))

    def peak(name: str, n: int) -> int:
        folder = tmp_path / name / "seq"
        for side in ("left", "right"):
            folders.image_folder(folder / f"image_{side}", [data] * n, [f"{i}.0.png" for i in range(n)])
        lines(folder / "groundtruth.txt", *(f"{i}.0 0 0 {i} 0 0 0 1" for i in range(n)))
        tracemalloc.start()
        try:
            imported("tum", folder)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak("warm", 1)
    few, many = peak("few", 4), peak("many", 12)
    assert many < few + len(data)


def test_images_of_one_number_in_kitti_are_counted(tmp_path: Path) -> None:
    source = folders.kitti(tmp_path / "07", scene(start_ns=0))
    (source / "image_0" / "0.png").write_bytes(b"no image")
    _, result = imported("kitti", source)
    (loss,) = result.losses
    assert (loss.what, loss.count) == ("images with the number of another one left out", 1)


def test_tables_longer_than_fits_in_memory_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.csv"
    lines = [f"{i},0,0,0,0,0,0,1,a,1,2,3,4" for i in range(40)]
    path.write_text("\n".join(["time_s,x_m,y_m,z_m,qx,qy,qz,qw,id,x_L_px,y_L_px,x_R_px,y_R_px", *lines]))
    imported("csv", path)
    (tmp_path / "imported.mcap").unlink()
    with monkeypatch.context() as few:
        few.setattr(csv, "_MOST_SHARED", 30)
        assert refused("csv", path).startswith(f"{path}:32: more than 30 poses")
    monkeypatch.setattr(tables, "MAX_ROWS", 20)
    assert refused("csv", path) == f"{path}:21: more than the 20 lines accepted"
