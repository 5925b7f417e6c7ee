"""A solved motion on standard output or in a file: JSON, YAML, or a ROS 2 message."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from vmf.errors import InputError
from vmf.experiment.atomic import write_text
from vmf.experiment.move import Move, PoseCommand

_WIDTH = 150
# Formats that are a command and nothing else.
_MESSAGES = ("pose_stamped", "pose_with_covariance_stamped")


def to_json(move: Move) -> str:
    """Return everything as JSON."""
    return json.dumps(move.model_dump(mode="json"), indent=2, allow_nan=False)


def to_yaml(move: Move) -> str:
    """Return everything as YAML."""
    return _yaml(move.model_dump(mode="json"), None)


def to_pose_stamped(move: Move) -> str:
    """Return a `geometry_msgs/msg/PoseStamped` as `ros2 topic pub` takes it, with no stamp (the latest)."""
    command = _pose(move)
    return _yaml({"header": _header(command), "pose": _ros_pose(command)}, False)


def to_pose_with_covariance_stamped(move: Move) -> str:
    """Return a `geometry_msgs/msg/PoseWithCovarianceStamped`."""
    command = _pose(move)
    if command.covariance is None:
        raise InputError(
            "--format pose_with_covariance_stamped: the noise of the training and with it the covariance is "
            "unknown, pose_stamped is accepted"
        )
    values = [value for row in command.covariance.matrix for value in row]
    pose = {"pose": _ros_pose(command), "covariance": values}
    return _yaml({"header": _header(command), "pose": pose}, None)


FORMATS: Mapping[str, Callable[[Move], str]] = MappingProxyType(
    {
        "yaml": to_yaml,
        "json": to_json,
        "pose_stamped": to_pose_stamped,
        "pose_with_covariance_stamped": to_pose_with_covariance_stamped,
    }
)


def rendered(move: Move, style: str) -> str | None:
    """Return an answer in one of `FORMATS`, None where it has no motion and the format is one of a command.

    Raises
    ------
    InputError : no such format, or there is no pose to command.
    """
    check_format(style)
    if move.motion is None and style in _MESSAGES:
        return None
    return FORMATS[style](move)


def check_format(style: str) -> None:
    """Raise `InputError` for a format that is none."""
    if style not in FORMATS:
        raise InputError(f"--format: found {style!r}, accepted: {', '.join(FORMATS)}")


def write(path: Path, text: str) -> None:
    """Write a file, complete or not at all.

    Raises
    ------
    InputError : it cannot be written.
    """
    try:
        write_text(path, text + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def _pose(move: Move) -> PoseCommand:
    if move.command is None or move.command.pose is None:
        raise InputError("--format: a pose to command needs the present one, --pose is missing")
    return move.command.pose


def _header(command: PoseCommand) -> dict[str, Any]:
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": command.frame_id}


def _ros_pose(command: PoseCommand) -> dict[str, Any]:
    return {
        "position": dict(zip("xyz", command.position_m, strict=True)),
        "orientation": dict(zip("xyzw", command.quaternion_xyzw, strict=True)),
    }


def _yaml(content: dict[str, Any], flow: bool | None) -> str:
    return yaml.safe_dump(
        content, sort_keys=False, default_flow_style=flow, width=_WIDTH, allow_unicode=True
    ).rstrip()
