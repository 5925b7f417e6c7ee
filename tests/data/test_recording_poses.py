"""Every kind of pose and joint message, good and bad."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from recording_files import (
    File,
    header,
    losses,
    moving_robot,
    pose_fields,
    pose_stamped,
    read_at,
    stamp,
    track_message,
)

from vmf.data.recording import describe, schemas
from vmf.errors import InputError

Put = Callable[[File, int, np.ndarray, np.ndarray], None]


def _transform(ns: int, p: np.ndarray, q: np.ndarray, parent: str, child: str) -> dict[str, object]:
    translation, rotation = pose_fields(p, q)
    return {
        "header": header(ns, parent),
        "child_frame_id": child,
        "transform": {"translation": translation, "rotation": rotation},
    }


def _pose_stamped(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    file.ros("/pose", schemas.POSE_STAMPED, pose_stamped(ns, p, q))


def _transform_stamped(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    file.ros("/pose", schemas.TRANSFORM_STAMPED, _transform(ns, p, q, "world", "rig"))


def _tf(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    other = _transform(ns, p + 1, q, "rig", "left_camera")
    both = [other, _transform(ns, p, q, "world", "rig")]
    file.ros("/pose", schemas.TF_MESSAGE, {"transforms": both})


def _odometry(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    position, orientation = pose_fields(p, q)
    zero = dict.fromkeys("xyz", 0.0)
    message = {
        "header": header(ns),
        "child_frame_id": "rig",
        "pose": {"pose": {"position": position, "orientation": orientation}, "covariance": [0.0] * 36},
        "twist": {"twist": {"linear": zero, "angular": zero}, "covariance": [0.0] * 36},
    }
    file.ros("/pose", schemas.ODOMETRY, message)


def _pose_in_frame_json(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    position, orientation = pose_fields(p, q)
    pose = {"position": position, "orientation": orientation}
    file.json("/pose", schemas.POSE_IN_FRAME, {"timestamp": stamp(ns), "frame_id": "world", "pose": pose})


def _frame_transform_json(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    translation, rotation = pose_fields(p, q)
    frames = {"parent_frame_id": "world", "child_frame_id": "rig"}
    message = {"timestamp": stamp(ns), **frames, "translation": translation, "rotation": rotation}
    file.json("/pose", schemas.FRAME_TRANSFORM, message)


def _pose_in_frame_protobuf(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    position, orientation = pose_fields(p, q)
    message = PoseInFrame(frame_id="world", pose={"position": position, "orientation": orientation})
    message.timestamp.FromNanoseconds(int(ns))
    file.protobuf("/pose", message)


def _frame_transform_protobuf(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
    translation, rotation = pose_fields(p, q)
    message = FrameTransform(
        parent_frame_id="world", child_frame_id="rig", translation=translation, rotation=rotation
    )
    message.timestamp.FromNanoseconds(int(ns))
    file.protobuf("/pose", message)


KINDS: list[Put] = [
    _pose_stamped,
    _transform_stamped,
    _tf,
    _odometry,
    _pose_in_frame_json,
    _frame_transform_json,
    _pose_in_frame_protobuf,
    _frame_transform_protobuf,
]
NAMES = [kind.__name__.strip("_") for kind in KINDS]


def _record(path: Path, put: Put, n: int = 6) -> np.ndarray:
    times, poses = moving_robot(n)
    with File(path) as file:
        for i, ns in enumerate(times.tolist()):
            put(file, ns, poses.position_m[i], poses.quaternion_xyzw[i])
            file.tracks(track_message(ns, [("a", [i, 1], [i, 2])]))
    return poses.motions("eye_in_hand")


# Kinds whose messages name the parent frame alone.
CHILDLESS = [_pose_stamped, _pose_in_frame_json, _pose_in_frame_protobuf]


@pytest.mark.parametrize("put", KINDS, ids=NAMES)
def test_every_kind_of_pose_says_the_same(tmp_path: Path, put: Put) -> None:
    expected = _record(tmp_path / "a.mcap", put)
    child = {} if put in CHILDLESS else {"child": "rig"}
    data = read_at(tmp_path / "a.mcap", pose={"topic": "/pose", "parent": "/world", **child})
    np.testing.assert_array_equal(data.tracks.E_S_from_W, expected)
    assert data.losses == data.repairs == ()
    assert describe(tmp_path / "a.mcap").losses == ()


@pytest.mark.parametrize("put", CHILDLESS)
def test_a_child_cannot_be_chosen_where_none_is_named(tmp_path: Path, put: Put) -> None:
    """To ignore it would be to train with whatever body the topic is about."""
    _record(tmp_path / "a.mcap", put)
    with pytest.raises(InputError, match="/pose: its poses name no child frame, found child: rig") as error:
        read_at(tmp_path / "a.mcap", pose={"topic": "/pose", "child": "rig"})
    assert len(error.value.lines) == 1


@pytest.mark.parametrize("put", KINDS, ids=NAMES)
def test_another_parent_than_the_poses_have_is_refused(tmp_path: Path, put: Put) -> None:
    _record(tmp_path / "a.mcap", put)
    with pytest.raises(InputError, match=r"/pose: no transform with parent map.*present: .*parent world"):
        read_at(tmp_path / "a.mcap", pose={"topic": "/pose", "parent": "map"})


@pytest.mark.parametrize("put", [k for k in KINDS if k is not _tf], ids=[n for n in NAMES if n != "tf"])
def test_one_transform_alone_needs_no_names(tmp_path: Path, put: Put) -> None:
    expected = _record(tmp_path / "a.mcap", put)
    np.testing.assert_array_equal(read_at(tmp_path / "a.mcap").tracks.E_S_from_W, expected)


def test_several_transforms_need_names_and_are_listed(tmp_path: Path) -> None:
    expected = _record(tmp_path / "a.mcap", _tf)
    with pytest.raises(InputError) as several:
        read_at(tmp_path / "a.mcap")
    with pytest.raises(InputError) as none:
        read_at(tmp_path / "a.mcap", pose={"topic": "/pose", "parent": "map"})
    for error in (several, none):
        assert "parent rig child left_camera, parent world child rig" in str(error.value)
    by_child = read_at(tmp_path / "a.mcap", pose={"topic": "/pose", "child": "rig"})
    np.testing.assert_array_equal(by_child.tracks.E_S_from_W, expected)
    assert len(describe(tmp_path / "a.mcap").poses) == 2


def test_a_quaternion_off_the_unit_sphere_is_refused_by_place_and_norm(tmp_path: Path) -> None:
    def put(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
        _pose_stamped(file, ns, p, q * (1.01 if p[0] > 0.2 else 1.0))

    _record(tmp_path / "a.mcap", put)
    with pytest.raises(
        InputError, match=r"a\.mcap: /pose: message \d has a quaternion of norm 1\.01; expected 1"
    ):
        read_at(tmp_path / "a.mcap")
    assert "norm 1.01" in "\n".join(describe(tmp_path / "a.mcap").lines())


def test_a_quaternion_within_rounding_is_normalised_not_refused(tmp_path: Path) -> None:
    expected = _record(tmp_path / "a.mcap", lambda file, ns, p, q: _pose_stamped(file, ns, p, q * (1 + 5e-4)))
    np.testing.assert_allclose(read_at(tmp_path / "a.mcap").tracks.E_S_from_W, expected, atol=1e-14)


@pytest.mark.parametrize("put", [_pose_stamped, _pose_in_frame_json], ids=["cdr", "json"])
def test_poses_of_nan_are_dropped_and_counted(tmp_path: Path, put: Put) -> None:
    def some_nan(file: File, ns: int, p: np.ndarray, q: np.ndarray) -> None:
        put(file, ns, p * (1 if some_nan.calls % 3 != 1 else np.nan if some_nan.calls < 3 else 1e300), q)  # type: ignore[attr-defined]
        some_nan.calls += 1  # type: ignore[attr-defined]

    some_nan.calls = 0  # type: ignore[attr-defined]
    _record(tmp_path / "a.mcap", some_nan)
    data = read_at(tmp_path / "a.mcap")
    assert data.tracks.n_frames == 4
    assert "/pose: poses with NaN, infinite or absurd values dropped (2)" in losses(data)
    assert "frames without a pose" in losses(data)


def test_no_usable_pose_at_all_is_refused(tmp_path: Path) -> None:
    _record(tmp_path / "a.mcap", lambda file, ns, p, q: _pose_stamped(file, ns, p * np.nan, q))
    with pytest.raises(InputError, match="/pose holds no usable pose"):
        read_at(tmp_path / "a.mcap")


def test_malformed_poses_are_dropped_and_counted(tmp_path: Path) -> None:
    times, _ = moving_robot(6)
    _, encodings = schemas.POSE_STAMPED, ("cdr", "ros2msg")
    with File(tmp_path / "a.mcap") as file:
        file.sound(6)
        text = schemas.POSE_STAMPED_TEXT.encode()
        for i, data in enumerate((b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40)):
            file.raw("/pose", schemas.POSE_STAMPED, encodings, text, data, int(times[i]))
    data = read_at(tmp_path / "a.mcap")
    assert data.tracks.n_frames == 6
    assert [loss.count for loss in data.losses] == [3]
    assert "malformed pose messages" in losses(data)


@pytest.mark.parametrize(
    ("encodings", "text", "said"),
    [
        (
            ("cdr", "ros2idl"),
            b"module x {};",
            "encoded as cdr with a ros2idl schema; accepted: cdr with ros2msg",
        ),
        (("cdr", "ros2msg"), b"int33 what is this", "cannot be parsed"),
        (("cdr", "ros2msg"), b"\xff\xfe", "cannot be parsed"),
        (("protobuf", "protobuf"), b"\xff\xfe", "cannot be parsed"),
    ],
)
def test_a_schema_that_cannot_be_used_is_refused(
    tmp_path: Path, encodings: tuple[str, str], text: bytes, said: str
) -> None:
    with File(tmp_path / "a.mcap") as file:
        file.raw("/pose", schemas.POSE_STAMPED, encodings, text, b"\0\1\0\0", 1)
        file.tracks(track_message(1, []))
    with pytest.raises(InputError, match=said):
        read_at(tmp_path / "a.mcap")


JOINTS = {"pose": None, "joints": {"topic": "/joints", "pan": "neck_pan", "tilt": "neck_tilt"}}


def _joint_state(ns: int, **angles: float) -> dict[str, object]:
    state = {"name": list(angles), "position": list(angles.values()), "velocity": [], "effort": []}
    return {"header": header(ns), **state}


def test_joints_are_found_by_name_among_others(tmp_path: Path) -> None:
    times, _ = moving_robot(6)
    with File(tmp_path / "a.mcap") as file:
        for i, ns in enumerate(times.tolist()):
            pan = np.nan if i == 2 else 0.1 * i
            file.ros("/joints", schemas.JOINT_STATE, _joint_state(ns, elbow=1.0))
            file.ros("/joints", schemas.JOINT_STATE, _joint_state(ns, x=9.0, neck_tilt=0.2, neck_pan=pan))
            file.tracks(track_message(ns, [("a", [i, 1], [i, 2])]))
    data = read_at(tmp_path / "a.mcap", **JOINTS)
    assert data.tracks.n_frames == 5
    assert "joint angles with NaN" in losses(data)
    # R_y(tilt) R_z(pan) takes x to (cos tilt cos pan, sin pan, −sin tilt cos pan).
    pan = 0.1 * np.array([0, 1, 3, 4, 5])
    np.testing.assert_allclose(data.tracks.E_S_from_W[:, 1, 0], np.sin(pan), atol=1e-15)


def test_joints_that_are_not_there_are_refused_with_the_names_present(tmp_path: Path) -> None:
    with File(tmp_path / "a.mcap") as file:
        file.ros("/joints", schemas.JOINT_STATE, _joint_state(5, elbow=1.0, neck_pan=0.0))
        file.tracks(track_message(5, []))
    with pytest.raises(InputError, match=r"'neck_pan' and 'neck_tilt'; names present: elbow, neck_pan"):
        read_at(tmp_path / "a.mcap", **JOINTS)


def test_malformed_joint_messages_are_dropped_and_counted(tmp_path: Path) -> None:
    with File(tmp_path / "a.mcap") as file:
        uneven = {**_joint_state(6, neck_pan=0.1, neck_tilt=0.2), "position": [0.1]}
        file.ros("/joints", schemas.JOINT_STATE, _joint_state(5, neck_pan=0.1, neck_tilt=0.2))
        file.ros("/joints", schemas.JOINT_STATE, uneven)
        file.tracks(track_message(5, []))
    data = read_at(tmp_path / "a.mcap", **JOINTS)
    assert data.tracks.n_frames == 1
    assert "/joints: malformed joint messages dropped" in losses(data)
