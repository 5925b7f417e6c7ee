"""Small recordings for the tests: written by `vmf`, or message by message where they must be wrong."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import serialize_dynamic

from vmf.data.poses import BodyPoses, PanTiltJoints, Poses
from vmf.data.recording import RecordingData, read, schemas
from vmf.data.tracks import Tracks, from_dense
from vmf.spec.model import JointSource, PoseSource, Recording, TrackSource

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 33_333_333

_POINT = "float64 x\nfloat64 y\nfloat64 z\n"
_RULE = "=" * 80 + "\n"
_HEADER = f"{_RULE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_QUATERNION = f"{_RULE}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
_TRANSFORM = (
    f"{_HEADER}{_RULE}MSG: geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\n"
    f"geometry_msgs/Quaternion rotation\n{_RULE}MSG: geometry_msgs/Vector3\n{_POINT}{_QUATERNION}"
)
_TRANSFORM_STAMPED = "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
ROS_TEXT = {
    schemas.POSE_STAMPED: schemas.POSE_STAMPED_TEXT,
    schemas.JOINT_STATE: schemas.JOINT_STATE_TEXT,
    schemas.TRANSFORM_STAMPED: _TRANSFORM_STAMPED + _TRANSFORM,
    schemas.TF_MESSAGE: (
        "geometry_msgs/TransformStamped[] transforms\n"
        f"{_RULE}MSG: geometry_msgs/TransformStamped\n{_TRANSFORM_STAMPED}{_TRANSFORM}"
    ),
    schemas.ODOMETRY: (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n"
        f"geometry_msgs/TwistWithCovariance twist\n{_HEADER}"
        f"{_RULE}MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
        f"{_RULE}MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance\n"
        f"{_RULE}MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
        f"{_RULE}MSG: geometry_msgs/Vector3\n{_POINT}"
        f"{_RULE}MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\n"
        f"geometry_msgs/Quaternion orientation\n{_RULE}MSG: geometry_msgs/Point\n{_POINT}{_QUATERNION}"
    ),
}


def moving_robot(n: int, seed: int = 0) -> tuple[np.ndarray, BodyPoses]:
    """Return times (n,) and poses of a body that moves and turns smoothly."""
    random = np.random.default_rng(seed)
    position = np.cumsum(random.normal(0.05, 0.02, (n, 3)), axis=0)
    quaternion = np.cumsum(random.normal(0, 0.02, (n, 4)), axis=0) + np.array([0, 0, 0, 1.0])
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return START_NS + PERIOD_NS * np.arange(n), BodyPoses(position, quaternion)


def example(
    n: int = 40, targets: int = 5, mounting: str = "eye_in_hand", joints: bool = False
) -> tuple[Tracks, Poses]:
    """Return tracks with holes in either camera, and poses or joints, one a frame."""
    random = np.random.default_rng(n + targets)
    times, body = moving_robot(n)
    poses: Poses = PanTiltJoints(*random.normal(0, 0.5, (2, n))) if joints else body
    pixels = random.uniform(0, 640, (n, targets, 4))
    pixels[random.random((n, targets)) < 0.3] = np.nan
    pixels[..., :2][random.random((n, targets)) < 0.1] = np.nan
    pixels[..., 2:][random.random((n, targets)) < 0.1] = np.nan
    pixels[0, 0] = pixels[7] = np.nan
    ids = tuple(f"target {k}" for k in range(targets))
    return from_dense(times, poses.motions(mounting), pixels, ids, (640, 480)), poses


def stamp(ns: int, rest: str = "nsec") -> dict[str, int]:
    return {"sec": ns // 10**9, rest: ns % 10**9}


def header(ns: int, frame_id: str = "world") -> dict[str, object]:
    return {"stamp": stamp(ns, "nanosec"), "frame_id": frame_id}


def pose_fields(p: np.ndarray, q: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
    return dict(zip("xyz", map(float, p), strict=True)), dict(zip("xyzw", map(float, q), strict=True))


def pose_stamped(ns: int, p: np.ndarray, q: np.ndarray, frame_id: str = "world") -> dict[str, object]:
    position, orientation = pose_fields(p, q)
    return {"header": header(ns, frame_id), "pose": {"position": position, "orientation": orientation}}


def track_message(ns: int, tracks: list[tuple[str, object, object]], **more: object) -> dict[str, object]:
    listed = [{"id": i, "left": left, "right": right} for i, left, right in tracks]
    return {"timestamp": stamp(ns), **more, "tracks": listed}


class File:
    """A recording written message by message, without asking whether it makes sense."""

    def __init__(self, path: Path, **options: object) -> None:
        self.path = path
        self._file = open(path, "wb")  # noqa: SIM115
        self.writer = Writer(self._file, **{"chunk_size": 1024, **options})  # type: ignore[arg-type]
        self.writer.start()
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def __enter__(self) -> File:
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.finish()
        self._file.close()

    def raw(
        self, topic: str, schema: str, encodings: tuple[str, str], text: bytes, data: bytes, log_ns: int
    ) -> None:
        if topic not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = self.writer.register_schema(schema, encodings[1], text)
            self._channels[topic] = self.writer.register_channel(topic, encodings[0], self._schemas[schema])
        self.writer.add_message(self._channels[topic], log_ns, data, log_ns)

    def ros(self, topic: str, schema: str, message: object, log_ns: int = START_NS) -> None:
        encode = serialize_dynamic(schema, ROS_TEXT[schema])[schema]
        self.raw(topic, schema, ("cdr", "ros2msg"), ROS_TEXT[schema].encode(), encode(message), log_ns)

    def json(self, topic: str, schema: str, message: object, log_ns: int = START_NS) -> None:
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        self.raw(topic, schema, ("json", "jsonschema"), b"{}", data, log_ns)

    def protobuf(self, topic: str, message: object, log_ns: int = START_NS) -> None:
        from mcap_protobuf.schema import build_file_descriptor_set

        name = type(message).DESCRIPTOR.full_name  # type: ignore[attr-defined]
        text = build_file_descriptor_set(type(message)).SerializeToString()
        data = message.SerializeToString()  # type: ignore[attr-defined]
        self.raw(topic, name, ("protobuf", "protobuf"), text, data, log_ns)

    def tracks(self, message: object, log_ns: int = START_NS) -> None:
        self.json("/tracks", schemas.STEREO_TRACKS, message, log_ns)

    def pose(self, ns: int, p: np.ndarray, q: np.ndarray) -> None:
        self.ros("/pose", schemas.POSE_STAMPED, pose_stamped(ns, p, q), ns)

    def sound(self, n: int = 10) -> SimpleNamespace:
        """Write n good frames with a pose each and return their times and poses."""
        times, poses = moving_robot(n)
        for i, ns in enumerate(times.tolist()):
            self.pose(ns, poses.position_m[i], poses.quaternion_xyzw[i])
            self.tracks(track_message(ns, [("a", [1.5 * i, 2.0], [3.0, 4.1 * i])]), ns)
        return SimpleNamespace(times=times, poses=poses)


UNCOMPRESSED, LZ4 = CompressionType.NONE, CompressionType.LZ4


def source(path: Path, **options: object) -> Recording:
    fields: dict[str, object] = {"pose": PoseSource(topic="/pose"), "tracks": TrackSource(topic="/tracks")}
    return Recording(path=path.name, **{**fields, **options})  # type: ignore[arg-type]


def read_at(path: Path, mounting: str = "eye_in_hand", **options: object) -> RecordingData:
    """Read a recording whose topics are /pose and /tracks unless told otherwise."""
    return read(source(path, **options), mounting, path.parent)


def read_written(
    path: Path, mounting: str = "eye_in_hand", joints: bool = False, **options: object
) -> RecordingData:
    """Read a recording written by `vmf.data.recording.write` with its standard topics."""
    motion: dict[str, object] = {"pose": PoseSource(topic="/robot/pose")}
    if joints:
        motion = {"pose": None, "joints": JointSource(topic="/robot/joints")}
    return read_at(path, mounting, tracks=TrackSource(topic="/stereo/tracks"), **motion, **options)


def losses(data: RecordingData) -> str:
    return "\n".join(map(str, data.losses))


def assert_same(a: Tracks, b: Tracks) -> None:
    """Bit for bit, NaN being equal to NaN."""
    for name in ("times_ns", "E_S_from_W", "frame", "target", "pixels"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name, strict=True)
    assert a.ids == b.ids
    assert a.image_size == b.image_size
