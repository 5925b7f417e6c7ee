"""Pydantic's errors as sentences a person can act on: where, what was found, what is accepted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, get_args

from pydantic_core import ErrorDetails
from pydantic_core.core_schema import ErrorType

from vmf.spec.shape import Shape, nearest
from vmf.spec.words import accepted, sentence, shown
from vmf.spec.yaml_source import Node, Path, Problem

_OWN_WORDS = {"value_error", "assertion_error"}
_MOST_HOMES = 3


@dataclass(frozen=True)
class _Holder:
    """The mapping or list around an error; `section` is the tagged union its `shape` was chosen from."""

    node: Node
    shape: Shape
    section: Shape | None = None

    @property
    def unknown(self) -> list[str]:
        keys = self.node.value if isinstance(self.node.value, dict) else {}
        return [key for key in keys if key not in self.shape.properties]


@dataclass(frozen=True)
class _Spot:
    """Where an error's location leads; `node` is the nearest one above if there is none at `path`."""

    path: Path
    node: Node
    shape: Shape
    holder: _Holder
    whole_union: bool = False


def problems_in(errors: list[ErrorDetails], root: Node, shape: Shape) -> list[Problem]:
    """Every error as a `Problem`, knock-on errors left out."""
    spots = [(error, _spot(error, root, shape)) for error in errors]
    told = [spot.path for _, spot in spots if not spot.whole_union]
    found: dict[Problem, None] = {}
    for error, spot in spots:
        # Where one member of a union has more to say, that the others do not fit is no news; nor that a list
        # is too short without its wrong items, which pydantic does not count.
        inside = any(path[: len(spot.path)] == spot.path and path != spot.path for path in told)
        same = spot.whole_union and spot.path in told
        outdone = same or (inside and (spot.whole_union or error["type"] == "too_short"))
        if not outdone and not (error["type"] == "missing" and _is_misspelt(spot)):
            found[_problem(error, spot, shape)] = None
    return list(found)


def _spot(error: ErrorDetails, root: Node, shape: Shape) -> _Spot:
    path: Path = ()
    node, section, whole_union = root, None, False
    holder = _Holder(root, shape)
    steps: list[str | int] = list(error["loc"])
    while steps:
        step = steps.pop(0)
        if shape.alternatives:
            # Pydantic names a member of the union here; an error of the value itself concerns them all.
            whole_union = not steps and error["type"] not in _OWN_WORDS
            shape = shape if whole_union else shape.branch(node)
        elif shape.tag is not None:
            section, shape = shape, shape.kinds.get(str(step), shape)
        else:
            holder, section = _Holder(node, shape, section), None
            node, shape, path = _child(node, step), shape.child(step), (*path, step)
    return _Spot(path, node, shape, holder, whole_union)


def _child(node: Node, step: str | int) -> Node:
    if isinstance(node.value, dict):
        return node.value.get(str(step), node)
    if isinstance(node.value, list) and isinstance(step, int) and step < len(node.value):
        return node.value[step]
    return node


def _is_misspelt(spot: _Spot) -> bool:
    """Whether a missing key is there under a wrong name, which is reported by itself."""
    holder = spot.holder
    return any(nearest(key, holder.shape.properties) == spot.path[-1] for key in holder.unknown)


def _problem(error: ErrorDetails, spot: _Spot, root: Shape) -> Problem:
    kind, holder = error["type"], spot.holder
    if kind == "extra_forbidden":
        return Problem(spot.node.key, spot.path, _unknown_key(str(spot.path[-1]), holder, root))
    if kind == "missing" and isinstance(holder.node.value, list):
        return Problem(holder.node.place, spot.path[:-1], _wrong_value(error, holder.node, holder.shape))
    if kind == "missing":
        return Problem(holder.node.place, spot.path, f"missing, {sentence(spot.shape)}")
    if kind.startswith("union_tag"):
        return _wrong_kind(spot)
    if kind in _OWN_WORDS:
        return Problem(spot.node.place, spot.path, str(error.get("ctx", {}).get("error") or error["msg"]))
    if kind not in get_args(ErrorType):
        return Problem(spot.node.place, spot.path, error["msg"])
    return Problem(spot.node.place, spot.path, _wrong_value(error, spot.node, spot.shape))


def _unknown_key(key: str, holder: _Holder, root: Shape) -> str:
    shape, section = holder.shape, holder.section
    listed = f" (accepted: {', '.join(shape.properties)})" if shape.properties else ""
    if section is not None and (owners := [k for k, s in section.kinds.items() if key in s.properties]):
        kind, tag = section.kind_of(holder.node), section.tag
        return f"unknown key for {tag}: {kind}, {key} belongs to {tag}: {' / '.join(owners)}{listed}"
    if (name := nearest(key, shape.properties)) is not None:
        return f"unknown key, did you mean {name}?{listed}"
    kinds = {} if section is None else section.kinds
    for kind, member in kinds.items():
        if section is not None and (name := nearest(key, member.properties)) is not None:
            return f"unknown key, did you mean {name} of {section.tag}: {kind}?{listed}"
    homes = root.homes(key)
    place = f", {key} belongs in {' / '.join(homes)}" if 0 < len(homes) <= _MOST_HOMES else ""
    return f"unknown key{place}{listed}"


def _wrong_kind(spot: _Spot) -> Problem:
    tag, kinds = str(spot.shape.tag), list(spot.shape.kinds)
    listed = f"accepted: {', '.join(kinds)}"
    children = spot.node.value if isinstance(spot.node.value, dict) else {}
    if tag not in children:
        return Problem(spot.node.place, (*spot.path, tag), f"missing, {listed}")
    found = children[tag]
    return Problem(
        found.place, (*spot.path, tag), f"found {shown(found)}, {listed}{_did_you_mean(found, kinds)}"
    )


def _wrong_value(error: ErrorDetails, node: Node, shape: Shape) -> str:
    if not (phrase := accepted(shape)):
        return f"found {shown(node)}, accepted: {error['msg'].removeprefix('Input should be ')}"
    if error["type"] == "finite_number":
        phrase = phrase.replace("number", "finite number", 1).replace("whole finite", "finite whole")
    choices = [choice for member in (shape, *shape.alternatives) for choice in member.choices]
    return f"found {shown(node)}, {sentence(shape, phrase)}{_did_you_mean(node, choices)}"


def _did_you_mean(node: Node, choices: list[Any]) -> str:
    name = nearest(node.value, choices) if isinstance(node.value, str) else None
    return "" if name is None else f"; did you mean {name}?"
