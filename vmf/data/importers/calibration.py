"""What folders say about their cameras: EuRoC's `sensor.yaml` and KITTI's `calib.txt`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from vmf.data.importers.tables import rows
from vmf.data.poses import NORM_TOLERANCE
from vmf.data.recording.foxglove import Camera
from vmf.data.recording.messages import MAX_NUMBER, MAX_SIDE_PX
from vmf.errors import InputError
from vmf.geometry import from_rotation_translation, inverse, nearest_rotation
from vmf.spec.base import Model
from vmf.spec.load import read_text

Floats = NDArray[np.float64]
Size = tuple[int, int]

Number = Annotated[float, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Side = Annotated[int, Field(ge=1, le=MAX_SIDE_PX)]
# By the names that EuRoC and those who write its format give them, as Foxglove calls them.
_LENSES: dict[str, Literal["plumb_bob", "kannala_brandt"]] = {
    "radial-tangential": "plumb_bob",
    "radtan": "plumb_bob",
    "plumb_bob": "plumb_bob",
    "equidistant": "kannala_brandt",
}


class _Motion(Model):
    """A matrix as EuRoC writes it."""

    cols: Literal[4]
    rows: Literal[4]
    data: Annotated[tuple[Number, ...], Field(min_length=16, max_length=16)]


class _Description(Model):
    """What is read of a camera's `sensor.yaml`; more may stand in it."""

    T_BS: _Motion | None = None
    resolution: tuple[Side, Side]
    camera_model: Literal["pinhole"] = "pinhole"
    intrinsics: tuple[Number, Number, Number, Number]
    distortion_model: Literal["radial-tangential", "radtan", "plumb_bob", "equidistant"] = "plumb_bob"
    distortion_coefficients: Annotated[tuple[Number, ...], Field(max_length=5)] = ()


def euroc_camera(path: Path, E_S_from_body: Floats | None) -> Camera:
    """Return the camera of a `sensor.yaml`, without a place in S where the body's is not known.

    Raises
    ------
    InputError : something that is needed is missing or wrong.
    """
    content = _content(path)
    try:
        known = {key: value for key, value in content.items() if key in _Description.model_fields}
        sensor = _Description.model_validate(known)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise InputError(f"{path}: {key}: {first['msg']}") from None
    fx, fy, cx, cy = sensor.intrinsics
    place: Floats | None = None
    if sensor.T_BS is not None and E_S_from_body is not None:
        place = E_S_from_body @ _rigid(path, np.array(sensor.T_BS.data).reshape(4, 4))
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    _check_focal(path, K)
    coefficients, lens = sensor.distortion_coefficients, _LENSES[sensor.distortion_model]
    return Camera(K, coefficients, sensor.resolution, place, lens)


def euroc_body(path: Path) -> Floats:
    """Return the pose (4, 4) of EuRoC's body in the frame S whose poses a `sensor.yaml` lies beside.

    Raises
    ------
    InputError : the pose of S in the body is missing or wrong.
    """
    found = _content(path).get("T_BS")
    try:
        motion = _Motion.model_validate(found)
    except ValidationError:
        raise InputError(f"{path}: T_BS: a matrix of 4 rows and 4 columns is accepted") from None
    return inverse(_rigid(path, np.array(motion.data).reshape(4, 4)))


def kitti_cameras(
    path: Path,
    numbers: tuple[int, int],
    sizes: tuple[Size, Size],
    R_S_from_camera: Floats,
) -> tuple[Camera, Camera]:
    """Return two of the cameras in a `calib.txt`, S being that of the left grey one but for its axes.

    Raises
    ------
    InputError : a camera is missing or its numbers are wrong.
    """
    wanted = [f"P{number}:" for number in numbers]
    found: dict[str, Floats] = {}
    for row in rows(path, None):
        if row.cells[0] in wanted:
            row.need(13)
            found[row.cells[0]] = np.array([row.number(i) for i in range(1, 13)]).reshape(3, 4)
    for name in wanted:
        if name not in found:
            raise InputError(f"{path}: no line {name}")
    left, right = (
        _projecting(path, found[name], size, R_S_from_camera)
        for name, size in zip(wanted, sizes, strict=True)
    )
    return left, right


def _projecting(path: Path, P: Floats, size: Size, R_S_from_camera: Floats) -> Camera:
    """Return the camera of a projection P (3, 4) of points in the left grey one's frame, axes alike."""
    K = P[:, :3]
    _check_focal(path, K)
    centre = -np.linalg.solve(K, P[:, 3])
    return Camera(K, (), size, from_rotation_translation(R_S_from_camera, R_S_from_camera @ centre))


def _check_focal(path: Path, K: Floats) -> None:
    if (
        not (np.abs(K) <= MAX_NUMBER).all()
        or min(K[0, 0], K[1, 1]) <= 0.0
        or K[2].tolist() != [0.0, 0.0, 1.0]
    ):
        raise InputError(f"{path}: found the camera matrix {K.tolist()}, positive focal lengths are accepted")


def _content(path: Path) -> dict[str, Any]:
    text = read_text(path, "a sensor's description in YAML")
    if text.startswith("%YAML"):  # OpenCV's head, which is none of YAML's
        text = text.partition("\n")[2]
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        first = str(error).partition("\n")[0]
        raise InputError(f"{path}: is no YAML: {first}") from None
    if not isinstance(content, dict):
        raise InputError(f"{path}: found no keys, those of a sensor are accepted")
    return content


def _rigid(path: Path, T: Floats) -> Floats:
    R = T[:3, :3]
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    if off > NORM_TOLERANCE or np.linalg.det(R) < 0.0:
        raise InputError(f"{path}: T_BS: found no rotation (off by {off:.3g})")
    return from_rotation_translation(nearest_rotation(R), T[:3, 3])
