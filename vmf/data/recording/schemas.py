"""The schemas that are read, and the texts of those that are written."""

from __future__ import annotations

import json

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TRANSFORM_STAMPED = "geometry_msgs/msg/TransformStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
POSE_IN_FRAME = "foxglove.PoseInFrame"
FRAME_TRANSFORM = "foxglove.FrameTransform"
JOINT_STATE = "sensor_msgs/msg/JointState"
STEREO_TRACKS = "vmf.StereoTracks"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
FOXGLOVE_RAW_IMAGE = "foxglove.RawImage"
FOXGLOVE_COMPRESSED_IMAGE = "foxglove.CompressedImage"
CAMERA_CALIBRATION = "foxglove.CameraCalibration"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"

POSE_SCHEMAS = (POSE_STAMPED, TRANSFORM_STAMPED, ODOMETRY, TF_MESSAGE, POSE_IN_FRAME, FRAME_TRANSFORM)
IMAGE_SCHEMAS = (IMAGE, COMPRESSED_IMAGE, FOXGLOVE_RAW_IMAGE, FOXGLOVE_COMPRESSED_IMAGE)
# Their poses do not say what they are the poses of, and Foxglove makes no frames of them.
CHILDLESS_SCHEMAS = (POSE_STAMPED, POSE_IN_FRAME)
CALIBRATION_SCHEMAS = (CAMERA_CALIBRATION, CAMERA_INFO)

_RULE = "=" * 80
_HEADER_TEXT = f"""{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""

POSE_STAMPED_TEXT = f"""std_msgs/Header header
geometry_msgs/Pose pose
{_HEADER_TEXT}{_RULE}
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
{_RULE}
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
{_RULE}
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""

JOINT_STATE_TEXT = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_HEADER_TEXT}"""

COMPRESSED_IMAGE_TEXT = f"""std_msgs/Header header
string format
uint8[] data
{_HEADER_TEXT}"""


def _pair(number: str, **more: object) -> dict[str, object]:
    return {"type": "array", "items": {"type": number}, "minItems": 2, "maxItems": 2, **more}


# Foxglove shows no topic whose schema gives a choice of types, so that null stands in words alone.
_PIXEL = _pair("number", description="x, y in px; null: not seen")
STEREO_TRACKS_TEXT = json.dumps(
    {
        "title": STEREO_TRACKS,
        "description": "Pixels of tracked points in both cameras; 0, 0 is the top-left pixel's centre.",
        "type": "object",
        "properties": {
            "timestamp": {
                "type": "object",
                "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
                "required": ["sec", "nsec"],
            },
            "left_size": _pair("integer", description="width, height in px"),
            "right_size": _pair("integer", description="width, height in px"),
            "tracks": {
                "type": "array",
                "items": {
                    "type": "object",
                    "properties": {
                        "id": {"type": "string"},
                        "left": _PIXEL,
                        "right": _PIXEL,
                        "quality": {
                            "type": "number",
                            "minimum": 0,
                            "maximum": 1,
                            "description": "how well the tracker found the target; 1 is perfect",
                        },
                    },
                    "required": ["id", "left", "right"],
                },
            },
        },
        "required": ["timestamp", "tracks"],
    }
)
