"""What `vmf solve` is told: two views, and what the robot reports, from files and from the command line."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, model_validator

from vmf.data.poses import NORM_TOLERANCE
from vmf.errors import InputError
from vmf.spec.base import Model
from vmf.spec.check import checked
from vmf.spec.load import decoded, read_text
from vmf.spec.yaml_source import Node, Place, Problem, in_file, parse, plain_scalar

Floats = NDArray[np.float64]

# Beyond this no metre or pixel means anything, and squares overflow.
_LARGEST = 1e9
_ACCEPTED = "views in YAML or JSON"
_NOT_SEEN = "-"
_LISTED = 8


def _sensible(value: float) -> float:
    if abs(value) > _LARGEST:
        raise ValueError(f"found {value:g}, a number up to {_LARGEST:g} in size is accepted")
    return value


def _unit(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    norm = float(np.linalg.norm(quaternion[-4:]))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise ValueError(f"found a quaternion of norm {norm:.6g}, 1 within {NORM_TOLERANCE:g} is accepted")
    return quaternion


def _whole_pixels(code: tuple[float | None, ...]) -> tuple[float | None, ...]:
    if any((code[i] is None) != (code[i + 1] is None) for i in (0, 2)):
        raise ValueError("found half a pixel, both x and y or neither are accepted")
    return code


Number = Annotated[float, AfterValidator(_sensible)]
Quaternion = Annotated[tuple[Number, Number, Number, Number], AfterValidator(_unit)]
PoseNumbers = Annotated[tuple[Number, Number, Number, Number, Number, Number, Number], AfterValidator(_unit)]
Code = Annotated[
    tuple[Number | None, Number | None, Number | None, Number | None], AfterValidator(_whole_pixels)
]


class Point(Model):
    """`geometry_msgs/msg/Point`."""

    x: Number
    y: Number
    z: Number


class Orientation(Point):
    """`geometry_msgs/msg/Quaternion`."""

    w: Number


class RosPose(Model):
    """`geometry_msgs/msg/Pose`."""

    position: Point
    orientation: Orientation

    @model_validator(mode="after")
    def _of_unit_norm(self) -> RosPose:
        _unit(self.numbers)
        return self

    @property
    def numbers(self) -> tuple[float, ...]:
        """`x, y, z, qx, qy, qz, qw`."""
        p, q = self.position, self.orientation
        return p.x, p.y, p.z, q.x, q.y, q.z, q.w


class SeenTarget(Model):
    """One target in a `vmf.StereoTracks` message; null in a camera that does not see it."""

    id: str | int
    left: tuple[Number, Number] | None = None
    right: tuple[Number, Number] | None = None


class Stamp(Model):
    """Time of a message."""

    sec: int
    nsec: int


class StereoView(Model):
    """A `vmf.StereoTracks` message."""

    timestamp: Stamp | None = None
    left_size: tuple[int, int] | None = None
    right_size: tuple[int, int] | None = None
    tracks: tuple[SeenTarget, ...]

    @model_validator(mode="after")
    def _each_id_once(self) -> StereoView:
        names = [str(track.id) for track in self.tracks]
        twice = [name for i, name in enumerate(names) if name in names[:i]]
        if twice:
            raise ValueError(f"target {twice[0]} is given twice, once is accepted")
        return self


class Request(Model):
    """Two views of some targets, and what is known of the robot.

    Attributes
    ----------
    initial, desired : what is seen now, and what should be seen: a `vmf.StereoTracks` message, or a list of
        `x_L, y_L, x_R, y_R` (px) in which targets have the same place in both views.
    pose : present pose as the robot reports it (m, quaternion x y z w): `W_T_S` eye-in-hand, `B_T_tool`
        eye-to-hand, in the frames of the poses trained with.
    joints : present pan and tilt (rad), for `pan_tilt`.
    rotation : rotation of the motion E', for models with `known: rotation` (quaternion x y z w).
    orientation : the same as the orientation of `pose` at the goal.
    """

    initial: StereoView | tuple[Code, ...]
    desired: StereoView | tuple[Code, ...]
    pose: PoseNumbers | RosPose | None = None
    joints: tuple[Number, Number] | None = None
    rotation: Quaternion | None = None
    orientation: Quaternion | None = None

    @model_validator(mode="after")
    def _nothing_twice(self) -> Request:
        for one, other in (("pose", "joints"), ("rotation", "orientation")):
            if getattr(self, one) is not None and getattr(self, other) is not None:
                raise ValueError(f"found both {one} and {other}, one of them is accepted")
        return self

    @property
    def pose_numbers(self) -> tuple[float, ...] | None:
        """Position and quaternion of the present pose."""
        return self.pose.numbers if isinstance(self.pose, RosPose) else self.pose

    def pairs(self) -> Pairs:
        """Return the targets that both views show, matched by id.

        Raises
        ------
        InputError : there is none.
        """
        initial, desired = _by_id(self.initial), _by_id(self.desired)
        shared = [name for name in initial if name in desired]
        if not shared:
            raise InputError(
                f"views: no target is in both, initial shows {_some(initial)}, desired shows "
                f"{_some(desired)}; targets with the same id are accepted"
            )
        return Pairs(
            tuple(shared),
            np.array([initial[name] for name in shared], float),
            np.array([desired[name] for name in shared], float),
            tuple(name for name in {**initial, **desired} if name not in shared),
        )


@dataclass(frozen=True)
class Pairs:
    """n targets in two views.

    Attributes
    ----------
    ids : (n,) names.
    initial, desired : (n, 4) `x_L, y_L, x_R, y_R` (px), NaN where not seen.
    unused : targets that only one view shows.
    """

    ids: tuple[str, ...]
    initial: Floats
    desired: Floats
    unused: tuple[str, ...]


def _by_id(view: StereoView | tuple[Code, ...]) -> dict[str, Sequence[float | None]]:
    """Return the codes of what a view shows; numpy makes NaN of None."""
    if isinstance(view, StereoView):
        nothing = (None, None)
        codes = {str(t.id): (*(t.left or nothing), *(t.right or nothing)) for t in view.tracks}
    else:
        codes = {str(number): code for number, code in enumerate(view, start=1)}
    return {name: code for name, code in codes.items() if any(value is not None for value in code)}


def _some(ids: Iterable[str]) -> str:
    names = list(ids)
    rest = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return (", ".join(names[:_LISTED]) or "none") + rest


@dataclass(frozen=True)
class Sources:
    """Where the views and the robot's report come from, as given on the command line.

    Attributes
    ----------
    targets : `x_L,y_L,x_R,y_R:x_L,y_L,x_R,y_R`, one per target, initial before desired.
    file : file of all there is to say, `-` for standard input.
    initial, desired : files of one view each, `-` for standard input.
    pose, joints, rotation, orientation : numbers separated by commas; they override the file's.
    """

    targets: tuple[str, ...] = ()
    file: str | None = None
    initial: str | None = None
    desired: str | None = None
    pose: str | None = None
    joints: str | None = None
    rotation: str | None = None
    orientation: str | None = None

    def read(self) -> Request:
        """Read everything and check it.

        Raises
        ------
        InputError : with one line for everything that is wrong.
        """
        problems: list[Problem] = []
        children = self._views(problems)
        for name in ("pose", "joints", "rotation", "orientation"):
            text = getattr(self, name)
            if text is not None:
                children[name] = _numbers(text, _place(f"--{name} {text}"))
        asked = checked(Request, Node(children, _place("views"), _place("views")), problems)
        if asked is None or problems:
            raise InputError(*map(str, sorted(problems, key=lambda problem: problem.place)))
        return asked

    def _views(self, problems: list[Problem]) -> dict[str, Node]:
        single = {"initial": self.initial, "desired": self.desired}
        ways = [bool(self.targets), self.file is not None, any(path is not None for path in single.values())]
        if sum(ways) != 1:
            found = "nothing" if not any(ways) else "several of these"
            raise InputError(
                f"views: found {found}, one of --target …, --file FILE, --initial FILE with --desired FILE "
                "is accepted"
            )
        if self.targets:
            return _of_targets(self.targets)
        if self.file is not None:
            root = _parsed(self.file, problems)
            if root is not None and not isinstance(root.value, dict):
                raise InputError(
                    f"{root.place.label}: found no mapping, one of initial and desired is accepted"
                )
            return dict(root.value) if root is not None and isinstance(root.value, dict) else {}
        if list(single.values()).count("-") > 1:
            raise InputError("--initial - --desired -: standard input is one view, or all with --file -")
        missing = [name for name, path in single.items() if path is None]
        if missing:
            raise InputError(f"--{missing[0]}: missing, a file with this view is accepted")
        views = {name: _parsed(str(path), problems) for name, path in single.items()}
        return {name: node for name, node in views.items() if node is not None}


def _parsed(path: str, problems: list[Problem]) -> Node | None:
    """Return the tree in a file or on standard input.

    Raises
    ------
    InputError : there is none.
    """
    if path == "-":
        name = "standard input"
        text = decoded(sys.stdin.buffer.read(), name, _ACCEPTED)
    else:
        name, text = path, read_text(Path(path), _ACCEPTED)
    found: list[Problem] = []
    root = parse(text, in_file(name), found)
    if found:
        raise InputError(*map(str, found))
    if root is None:
        raise InputError(f"{name}: empty, {_ACCEPTED} are accepted")
    return root


def _of_targets(texts: Sequence[str]) -> dict[str, Node]:
    initial, desired = [], []
    for text in texts:
        place = _place(f"--target {text}")
        halves = text.split(":")
        if len(halves) != 2:
            raise InputError(
                f"{place.label}: found {len(halves)} of 2 views, initial:desired with x_L,y_L,x_R,y_R each "
                "is accepted"
            )
        initial.append(_numbers(halves[0], place))
        desired.append(_numbers(halves[1], place))
    views = _place("--target")
    return {"initial": Node(list(initial), views, views), "desired": Node(list(desired), views, views)}


def _numbers(text: str, place: Place) -> Node:
    """Return a list of what stands between commas, `-` being null."""
    values: list[Any] = []
    for part in map(str.strip, text.split(",")):
        value = None if part == _NOT_SEEN else (plain_scalar(part) if part else part)
        values.append(Node(value, place, place, part))
    return Node(values, place, place, text)


def _place(label: str) -> Place:
    return Place(1, 0, 0, label)
