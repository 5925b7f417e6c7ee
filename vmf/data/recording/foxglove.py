"""What Foxglove draws: targets over images, frames and cameras in space."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.TextAnnotation_pb2 import TextAnnotation
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

# Our pixel (0, 0) is the top-left pixel's centre, Foxglove's its corner.
HALF_PIXEL = 0.5
# More names than these would hide the image.
_MOST_NAMES = 60
_FONT_PX = 12.0
_LEGEND_PX = 16.0
_ARM_PX = 6.0
# Rotation matrices of cameras that are parallel differ by rounding alone.
_PARALLEL = 1e-9
_COEFFICIENTS = {"plumb_bob": 5, "kannala_brandt": 4}
_BACKGROUND = Color(r=0.0, g=0.0, b=0.0, a=0.6)


@dataclass(frozen=True)
class Layer:
    """One kind of targets and how it is drawn.

    Attributes
    ----------
    name : what the legend says.
    rgb : colour, each from 0 to 1.
    arms : (m, 2) ends of the lines drawn about each target, two by two (px); a dot where there are none.
    """

    name: str
    rgb: tuple[float, float, float]
    arms: tuple[tuple[float, float], ...]

    @property
    def color(self) -> Color:
        """The colour as a message."""
        r, g, b = self.rgb
        return Color(r=r, g=g, b=b, a=1.0)


def _crossing(x: float, y: float) -> tuple[tuple[float, float], ...]:
    return (-x, -y), (x, y), (-y, x), (y, -x)


# Okabe and Ito's sky blue, orange and reddish purple; shapes differ as well, for those who see no colours.
OBSERVED = Layer("observed", (0x56 / 255, 0xB4 / 255, 0xE9 / 255), ())
DESIRED = Layer("desired", (0xE6 / 255, 0x9F / 255, 0x00 / 255), _crossing(_ARM_PX, 0.0))
PREDICTED = Layer("predicted", (0xCC / 255, 0x79 / 255, 0xA7 / 255), _crossing(0.7 * _ARM_PX, 0.7 * _ARM_PX))
LAYERS = (OBSERVED, DESIRED, PREDICTED)


@dataclass(frozen=True)
class Drawn:
    """Targets in both images to be drawn alike.

    Attributes
    ----------
    layer : how.
    ids : (n,) names.
    pixels : (n, 4) `x_L, y_L, x_R, y_R` (px), NaN where not seen.
    note : what the legend says behind the layer's name.
    """

    layer: Layer
    ids: Sequence[str]
    pixels: Floats
    note: str = ""


def image_annotations(
    drawn: Iterable[Drawn], camera: int, time_ns: int, first_row: int = 1
) -> ImageAnnotations:
    """Return what is to be drawn over the image that camera 0 (left) or 1 (right) took at `time_ns`.

    The legend begins in row `first_row`, so that several messages over one image do not hide each other's.
    """
    at = stamp(time_ns)
    out = ImageAnnotations(timestamp=at)
    for row, one in enumerate(drawn, start=first_row):
        color = one.layer.color
        xy = one.pixels[:, 2 * camera : 2 * camera + 2] + HALF_PIXEL
        seen = np.nonzero(np.isfinite(xy).all(axis=1))[0]
        xy = xy[seen]
        dots = not one.layer.arms
        ends = xy if dots else (xy[:, None] + np.array(one.layer.arms)).reshape(-1, 2)
        out.points.append(
            PointsAnnotation(
                timestamp=at,
                type=PointsAnnotation.POINTS if dots else PointsAnnotation.LINE_LIST,
                points=[Point2(x=x, y=y) for x, y in ends.tolist()],
                outline_color=color,
                fill_color=color,
                thickness=_ARM_PX if dots else 2.0,
            )
        )
        legend = f"{one.layer.name} {one.note}".rstrip()
        out.texts.append(_text(at, (4.0, row * (_LEGEND_PX + 4.0)), legend, _LEGEND_PX, color))
        if one.layer is OBSERVED:
            for i, (x, y) in zip(seen.tolist()[:_MOST_NAMES], xy.tolist(), strict=False):
                out.texts.append(_text(at, (x + _ARM_PX, y - _ARM_PX), one.ids[i], _FONT_PX, color))
    return out


def _text(at: Timestamp, xy: tuple[float, float], text: str, size: float, color: Color) -> TextAnnotation:
    return TextAnnotation(
        timestamp=at,
        position=Point2(x=xy[0], y=xy[1]),
        text=text,
        font_size=size,
        text_color=color,
        background_color=_BACKGROUND,
    )


@dataclass(frozen=True)
class Camera:
    """One camera whose calibration is known.

    Attributes
    ----------
    K : (3, 3) camera matrix (px).
    distortion : coefficients of the lens, k1, k2, p1, p2, k3 or as many of them as are known.
    size : (width, height) px.
    E_S_from_camera : (4, 4) its pose in S (m), None where it is not known.
    lens : Foxglove's name of the model that `distortion` belongs to.
    """

    K: Floats
    distortion: tuple[float, ...]
    size: tuple[int, int]
    E_S_from_camera: Floats | None
    lens: Literal["plumb_bob", "kannala_brandt"] = "plumb_bob"


def calibration(camera: Camera, left: Camera, frame_id: str, time_ns: int) -> CameraCalibration:
    """Return a camera as a message; in a parallel rig it knows how far the left one is."""
    width, height = camera.size
    P = camera.K @ np.column_stack([np.eye(3), _apart(camera, left)])
    count = _COEFFICIENTS[camera.lens]
    return CameraCalibration(
        timestamp=stamp(time_ns),
        frame_id=frame_id,
        width=width,
        height=height,
        distortion_model=camera.lens,
        D=[*camera.distortion, *[0.0] * count][:count],
        K=camera.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=P.ravel().tolist(),
    )


def _apart(camera: Camera, left: Camera) -> Floats:
    """Return where (3,) a camera sees the left one of a parallel rig: −baseline along x for the right one."""
    if camera is left or camera.E_S_from_camera is None or left.E_S_from_camera is None:
        return np.zeros(3)
    E = np.linalg.inv(camera.E_S_from_camera) @ left.E_S_from_camera
    # Only of rectified images has a projection from the left camera's frame this form.
    return (
        np.asarray(E[:3, 3]) if np.allclose(E[:3, :3], np.eye(3), rtol=0.0, atol=_PARALLEL) else np.zeros(3)
    )


def frame_transform(T: Floats, parent: str, child: str, time_ns: int) -> FrameTransform:
    """Return the pose T (4, 4) of the frame `child` in `parent` as a message."""
    x, y, z = T[:3, 3].tolist()
    return FrameTransform(
        timestamp=stamp(time_ns),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=Vector3(x=x, y=y, z=z),
        rotation=_quaternion(T),
    )


def pose_in_frame(T: Floats, frame_id: str, time_ns: int) -> PoseInFrame:
    """Return the pose T (4, 4) in a frame as a message."""
    x, y, z = T[:3, 3].tolist()
    pose = Pose(position=Vector3(x=x, y=y, z=z), orientation=_quaternion(T))
    return PoseInFrame(timestamp=stamp(time_ns), frame_id=frame_id, pose=pose)


def stamp(time_ns: int) -> Timestamp:
    """Return a time as a message."""
    return Timestamp(seconds=time_ns // 10**9, nanos=time_ns % 10**9)


def _quaternion(T: Floats) -> Quaternion:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)
