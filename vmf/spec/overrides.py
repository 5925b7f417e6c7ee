"""What the command line says of a spec: `a.b.c=value`, applied to the file's tree before it is checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vmf.spec.shape import Shape
from vmf.spec.yaml_source import Node, Path, Place, Problem, dotted, parse

_FORM = "key=value is accepted, such as noise.pixel_px=1.5"


@dataclass(frozen=True)
class Override:
    """A text `a.b.c=value`, and what messages call the place where it was written."""

    text: str
    label: str


@dataclass(frozen=True)
class _Override:
    keys: tuple[str, ...]
    node: Node


def on_command_line(text: str) -> Override:
    """What the command line says."""
    return Override(text, f"command line: {text}")


def overridden(root: Node, shape: Shape, texts: Sequence[str | Override], problems: list[Problem]) -> Node:
    """The tree with every override put in, in order; of two for the same key the last one counts."""
    last: dict[tuple[str, ...], _Override] = {}
    for rank, text in enumerate(texts, start=1):
        override = _parsed(text, rank, problems)
        if override is not None:
            last.pop(override.keys, None)
            last[override.keys] = override
    for override in last.values():
        root = _put(root, shape, override.keys, override.node, (), problems)
    return root


def _parsed(given: str | Override, rank: int, problems: list[Problem]) -> _Override | None:
    override = on_command_line(given) if isinstance(given, str) else given
    text, place = override.text, Place(rank, 0, 0, override.label)
    key, equals, value = text.partition("=")
    keys = tuple(step.strip() for step in key.split("."))
    if not equals or not all(keys):
        problems.append(Problem(place, (), f"not an override, {_FORM}"))
        return None
    if "\n" in value.strip():
        problems.append(Problem(place, (), "found several lines, a value on one line is accepted"))
        return None
    found: list[Problem] = []
    node = parse(value, lambda line, column: place, found, keys)
    problems += found
    return None if found else _Override(keys, node or Node(None, place, place))


def _put(
    node: Node | None, shape: Shape, keys: Sequence[str], new: Node, path: Path, problems: list[Problem]
) -> Node:
    if not keys:
        return new
    key, rest = keys[0], keys[1:]
    if node is None or not isinstance(node.value, dict | list):
        node = _made(shape, new.place)
    if isinstance(node.value, list):
        return _put_in_list(node, shape, keys, new, path, problems)
    assert isinstance(node.value, dict)
    branch, inner = shape.branch(node), shape.narrow(node)
    children = node.value if rest or key != branch.tag else _switched(branch, node, new)
    child = _put(children.get(key), inner.child(key), rest, new, (*path, key), problems)
    return Node({**children, key: child}, node.place, node.key)


def _put_in_list(
    node: Node, shape: Shape, keys: Sequence[str], new: Node, path: Path, problems: list[Problem]
) -> Node:
    assert isinstance(node.value, list)
    children = list(node.value)
    if not keys[0].isdecimal() or int(keys[0]) >= len(children):
        indices = f"an index from 0 to {len(children) - 1}" if children else "no index, it is empty,"
        text = f"found {keys[0]!r} as an index of {dotted(path)}, {indices} is accepted"
        problems.append(Problem(new.place, (), text))
        return node
    index = int(keys[0])
    inner = shape.branch(node).child(index)
    children[index] = _put(children[index], inner, keys[1:], new, (*path, index), problems)
    return Node(children, node.place, node.key)


def _made(shape: Shape, place: Place) -> Node:
    """What an override reaches into where the file has nothing: the default list, or a new mapping."""
    default = shape.schema.get("default")
    return _node_of(default if isinstance(default, list) else {}, place)


def _node_of(value: object, place: Place) -> Node:
    if isinstance(value, dict):
        return Node({key: _node_of(child, place) for key, child in value.items()}, place, place)
    if isinstance(value, list):
        return Node([_node_of(child, place) for child in value], place, place)
    assert value is None or isinstance(value, str | int | float)
    return Node(value, place, place, str(value))


def _switched(shape: Shape, node: Node, new: Node) -> dict[str, Node]:
    """The children of a section whose kind changes, without the file's keys that only the old kind has."""
    assert isinstance(node.value, dict)
    kinds, old = shape.kinds, shape.kind_of(node)
    if old not in kinds or new.value not in kinds or old == new.value:
        return node.value
    lost = set(kinds[old].properties) - set(kinds[str(new.value)].properties)
    return {key: child for key, child in node.value.items() if key not in lost or child.key.rank > 0}
