"""What a folder says about its cameras is in the recording, for those who look; nothing learns from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import import_folders as folders
import numpy as np
import pytest
from import_folders import imported, lines, scene
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from vmf.geometry import from_rotation_translation, inverse
from vmf.geometry.camera import R_CAMERA_FROM_BODY

# Of EuRoC's MH_01: the cameras look along different axes than the body, and not quite side by side.
T_BS = from_rotation_translation(
    Rotation.from_euler("zyx", [1.556, 0.02, -0.01]).as_matrix(), [0.1, -0.02, 0.03]
)
T_BS_RIGHT = T_BS @ from_rotation_translation(
    Rotation.from_rotvec([0.0, 0.01, 0.0]).as_matrix(), [0.11, 0, 0]
)
INTRINSICS = [458.654, 457.296, 367.215, 248.375]
LENS = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]


def known(path: Path) -> dict[str, Any]:
    """The message on each protobuf topic about cameras."""
    found: dict[str, Any] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        topics = [
            f"/stereo/{side}/{what}" for side in ("left", "right") for what in ("calibration", "transform")
        ]
        for _, channel, _, message in reader.iter_decoded_messages(topics=topics):
            assert channel.topic not in found
            found[channel.topic] = message
    return found


def matrix(T: Any) -> np.ndarray:
    t, q = T.translation, T.rotation
    return from_rotation_translation(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), [t.x, t.y, t.z])


def described(folder: Path, T: np.ndarray, *more: str) -> Path:
    data = ", ".join(map(repr, T.ravel().tolist()))
    return lines(
        folder / "sensor.yaml",
        "%YAML:1.0",
        "sensor_type: camera",
        f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]",
        "resolution: [752, 480]",
        "camera_model: pinhole",
        f"intrinsics: {INTRINSICS} #fu, fv, cu, cv",
        *(more or ("distortion_model: radial-tangential", f"distortion_coefficients: {LENS}")),
    )


def test_euroc_cameras(tmp_path: Path) -> None:
    mav = folders.euroc(tmp_path / "MH_01", scene()) / "mav0"
    described(mav / "cam0", T_BS)
    described(mav / "cam1", T_BS_RIGHT)
    path, result = imported("euroc", mav)
    assert result.losses == ()
    found = known(path)
    for side, T in (("left", T_BS), ("right", T_BS_RIGHT)):
        camera, at = found[f"/stereo/{side}/calibration"], found[f"/stereo/{side}/transform"]
        fx, fy, cx, cy = INTRINSICS
        assert list(camera.K) == [fx, 0, cx, 0, fy, cy, 0, 0, 1]
        assert (camera.distortion_model, list(camera.D)) == ("plumb_bob", [*LENS, 0.0])
        assert (camera.width, camera.height, camera.frame_id) == (752, 480, side)
        assert (at.parent_frame_id, at.child_frame_id) == ("body", side)
        # As quaternions and back.
        np.testing.assert_allclose(matrix(at), T, atol=1e-14)
        # Images that are not rectified: each camera projects from its own frame.
        np.testing.assert_array_equal(np.array(camera.P).reshape(3, 4)[:, 3], 0.0)


def test_euroc_cameras_about_what_the_poses_are_of(tmp_path: Path) -> None:
    """A motion-capture frame has a pose in the body of its own; without it nobody knows where cameras are."""
    mav = folders.euroc(tmp_path / "V1", scene(), pose="vicon0") / "mav0"
    described(mav / "cam0", T_BS)
    described(
        mav / "cam1", T_BS_RIGHT, "distortion_model: equidistant", "distortion_coefficients: [0.1, 0.2]"
    )
    path, result = imported("euroc", mav)
    assert result.losses == ()
    found = known(path)
    assert set(found) == {"/stereo/left/calibration", "/stereo/right/calibration"}
    right = found["/stereo/right/calibration"]
    assert (right.distortion_model, list(right.D)) == ("kannala_brandt", [0.1, 0.2, 0.0, 0.0])
    path.unlink()
    T_body_marker = from_rotation_translation(
        Rotation.from_rotvec([0.3, 0.1, 0]).as_matrix(), [0.0, 0.1, 0.2]
    )
    described(mav / "vicon0", T_body_marker)
    found = known(imported("euroc", mav)[0])
    np.testing.assert_allclose(
        matrix(found["/stereo/left/transform"]), inverse(T_body_marker) @ T_BS, atol=1e-14
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[752, 480]", "[752]", "resolution"),
        ("pinhole", "omni", "camera_model"),
        ("[458.654,", "[0.0,", "positive focal lengths"),
        ("resolution:", "resolution: [", "is no YAML"),
        ("cols: 4", "cols: 3", "T_BS.cols"),
        ("data: [", "data: [2.0, ", "T_BS.data"),
        (repr(float(T_BS[0, 1])), "1.5", "found no rotation"),
        ("458.654", "1e300", "intrinsics.0"),
    ],
)
def test_a_description_that_cannot_be_used_is_a_loss(tmp_path: Path, old: str, new: str, words: str) -> None:
    world = scene()
    mav = folders.euroc(tmp_path / "MH_01", world) / "mav0"
    for camera in ("cam0", "cam1"):
        path = described(mav / camera, T_BS)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    written, result = imported("euroc", mav)
    (loss,) = result.losses
    assert f"calibration not used: {path}: " in loss.what
    assert words in loss.what
    assert known(written) == {}
    folders.assert_holds(written, world)


P0 = [707.0912, 0.0, 601.8873, 0.0, 0.0, 707.0912, 183.1104, 0.0, 0.0, 0.0, 1.0, 0.0]


def calib(*columns: tuple[float, float, float]) -> list[str]:
    rows = []
    for number, last in enumerate(columns):
        P = np.array(P0).reshape(3, 4)
        P[:, 3] = last
        rows.append(f"P{number}: " + " ".join(map(repr, P.ravel().tolist())))
    return [*rows, "Tr: " + " ".join(["0"] * 12)]


@pytest.mark.parametrize(("names", "axes"), [((0, 1), "camera"), ((2, 3), "camera"), ((0, 1), "body")])
def test_kitti_cameras(tmp_path: Path, names: tuple[int, int], axes: str) -> None:
    columns = [(0.0, 0.0, 0.0), (-379.8, 0.0, 0.0), (46.9, 0.11, 0.003), (-333.4, 2.2, 0.003)]
    cameras = f"image_{names[0]}", f"image_{names[1]}"
    source = folders.kitti(tmp_path / "07", scene(start_ns=0), cameras)
    lines(source / "calib.txt", *calib(*columns))
    path, result = imported("kitti", source, f"axes={axes}")
    assert result.losses == ()
    found = known(path)
    R_S_from_camera = np.eye(3) if axes == "camera" else R_CAMERA_FROM_BODY.T
    P_S = R_S_from_camera @ np.array([0.3, -0.2, 5.0])
    for side, number in zip(("left", "right"), names, strict=True):
        camera, at = found[f"/stereo/{side}/calibration"], found[f"/stereo/{side}/transform"]
        assert (camera.width, camera.height, list(camera.D)) == (40, 30, [0.0] * 5)
        # A viewer's way, through the camera's frame, ends where KITTI's own projection does.
        p = np.array(camera.K).reshape(3, 3) @ (inverse(matrix(at)) @ np.append(P_S, 1.0))[:3]
        P = np.array(P0).reshape(3, 4)
        P[:, 3] = columns[number]
        q = P @ np.append(R_S_from_camera.T @ P_S, 1.0)
        np.testing.assert_allclose(p[:2] / p[2], q[:2] / q[2], atol=1e-9)
    baseline_px = found["/stereo/right/calibration"].P[3] - found["/stereo/left/calibration"].P[3]
    assert baseline_px == pytest.approx(columns[names[1]][0] - columns[names[0]][0], abs=0.5)


def test_a_kitti_calibration_that_cannot_be_used_is_a_loss(tmp_path: Path) -> None:
    source = folders.kitti(tmp_path / "07", scene(start_ns=0))
    for rows, words in (
        (calib((0.0, 0.0, 0.0)), "no line P1:"),
        (["P0: 1 2 3", *calib((0.0, 0.0, 0.0))[1:]], "found 4 columns"),
        ([row.replace("707.0912", "-1") for row in calib((0, 0, 0), (-380, 0, 0))], "positive focal lengths"),
        (
            [row.replace("707.0912", "nan") for row in calib((0, 0, 0), (-380, 0, 0))],
            "positive focal lengths",
        ),
    ):
        lines(source / "calib.txt", *rows)
        path, result = imported("kitti", source)
        assert [words in loss.what for loss in result.losses] == [True], result.losses
        assert known(path) == {}
