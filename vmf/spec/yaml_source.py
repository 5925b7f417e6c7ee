"""YAML text as a tree in which every key and value knows where it was written.

Plain scalars follow the YAML 1.2 core schema: `1e-3` is a number, `on` and `1:30` are text. Aliases, anchors,
tags and merge keys are refused: a spec says everything where it is read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

Scalar = str | int | float | bool | None
Path = tuple[str | int, ...]

FLOAT = re.compile(
    r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
)
_INT = re.compile(r"[-+]?[0-9]{1,300}")
_NULL = {"", "~", "null", "Null", "NULL"}
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_DEEPEST = 50


@dataclass(frozen=True, order=True)
class Place:
    """Where something was written; the file (rank 0) comes before the command line (rank 1, 2, …)."""

    rank: int
    line: int
    column: int
    label: str = field(compare=False)


@dataclass(frozen=True)
class Node:
    """A value, where it was written, where its key was, and how a scalar was spelled."""

    value: Scalar | dict[str, Node] | list[Node]
    place: Place
    key: Place
    text: str = ""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: its place, the dotted key it concerns, what was found and what is accepted."""

    place: Place
    path: Path
    text: str

    def __str__(self) -> str:
        path = dotted(self.path)
        shown = path and not self.place.label.startswith(f"command line: {path}=")
        return " ".join(": ".join([self.place.label, *([path] if shown else []), self.text]).splitlines())


PlaceOf = Callable[[int, int], Place]


def dotted(path: Path) -> str:
    """A path as a person writes it: `rivals.0.method`."""
    return ".".join(text if (text := str(step)).isprintable() and text else repr(step) for step in path)


def in_file(name: str) -> PlaceOf:
    """Places in a file, from 0-based line and column."""
    return lambda line, column: Place(0, line + 1, column + 1, f"{name}:{line + 1}:{column + 1}")


def parse(text: str, place_of: PlaceOf, problems: list[Problem], path: Path = ()) -> Node | None:
    """The one document in `text`, or None if there is none to be read; what is wrong joins `problems`."""
    try:
        return _Builder(text, place_of, problems).document(path)
    except yaml.reader.ReaderError as error:
        before = text[: error.position].split("\n")
        place = place_of(len(before) - 1, len(before[-1]))
        problems.append(Problem(place, (), f"the character {text[error.position]!r} is not allowed in YAML"))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = place_of(mark.line, mark.column) if mark else place_of(0, 0)
        problems.append(Problem(place, (), f"not valid YAML: {_in_words(error)}"))
    return None


def _in_words(error: yaml.MarkedYAMLError) -> str:
    problem = error.problem or "it cannot be read"
    if "'\\t'" in problem:
        return "found a tab, only spaces may separate and indent"
    if "'`'" in problem or "'@'" in problem:
        return f"{problem}; put the text in quotes"
    return f"{problem} ({error.context})" if error.context else problem


class _Builder:
    """Builds nodes from PyYAML's events, which tell tags, anchors and quotes as they were written."""

    def __init__(self, text: str, place_of: PlaceOf, problems: list[Problem]) -> None:
        self._events: Iterator[Any] = yaml.parse(text, Loader=yaml.SafeLoader)
        self._place_of = place_of
        self._problems = problems

    def document(self, path: Path) -> Node | None:
        root: Node | None = None
        for event in self._events:
            if not isinstance(event, yaml.DocumentStartEvent):
                continue
            if root is not None:
                self._refuse(event, path, "a second document starts here, a spec is one document")
                return None
            root = self._node(next(self._events), path)
        empty = root is not None and root.value is None and not root.text
        return None if empty else root

    def _node(self, event: Any, path: Path, key: Place | None = None) -> Node:
        if len(path) > _DEEPEST:
            raise yaml.MarkedYAMLError(
                problem=f"nested more than {_DEEPEST} deep", problem_mark=event.start_mark
            )
        place = self._place(event)
        key = key or place
        if isinstance(event, yaml.AliasEvent):
            self._refuse(event, path, f"alias *{event.anchor}, write the value itself")
            return Node(None, place, key)
        if event.anchor is not None:
            self._refuse(event, path, f"anchor &{event.anchor}, specs have no anchors and aliases")
        if event.tag is not None:
            self._refuse(
                event, path, f"tag {event.tag.replace('tag:yaml.org,2002:', '!!')}, specs have no tags"
            )
        if isinstance(event, yaml.MappingStartEvent):
            return Node(self._mapping(path), place, key)
        if isinstance(event, yaml.SequenceStartEvent):
            return Node(self._sequence(path), place, key)
        return self._scalar(event, path, place, key)

    def _mapping(self, path: Path) -> dict[str, Node]:
        children: dict[str, Node] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            name = self._key(event, path)
            child = self._node(next(self._events), (*path, name), self._place(event))
            if name in children:
                first = children[name].key
                self._refuse(event, (*path, name), f"given twice, first at {first.label}; once is accepted")
            elif name == "<<":
                self._refuse(event, path, "merge key <<, write the values themselves")
            else:
                children[name] = child
        return children

    def _key(self, event: Any, path: Path) -> str:
        node = self._node(event, path)
        if not isinstance(event, yaml.ScalarEvent):
            self._refuse(event, path, "found a list or mapping as a key, a name is accepted")
            # The place keeps two such keys apart, lest they be called duplicates too.
            return f"? {node.place.line}:{node.place.column}"
        return node.text

    def _sequence(self, path: Path) -> list[Node]:
        children: list[Node] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            children.append(self._node(event, (*path, len(children))))
        return children

    def _scalar(self, event: Any, path: Path, place: Place, key: Place) -> Node:
        text: str = event.value.encode("utf-8", "replace").decode()
        if text != event.value:
            self._refuse(event, path, "half of a surrogate pair is not a character")
        return Node(plain_scalar(text) if event.implicit[0] else text, place, key, text)

    def _place(self, event: Any) -> Place:
        return self._place_of(event.start_mark.line, event.start_mark.column)

    def _refuse(self, event: Any, path: Path, text: str) -> None:
        self._problems.append(Problem(self._place(event), path, text))


def plain_scalar(text: str) -> Scalar:
    """The value of a plain scalar in the YAML 1.2 core schema."""
    if text in _NULL:
        return None
    if text in _BOOL:
        return _BOOL[text]
    if _INT.fullmatch(text):
        return int(text)
    if FLOAT.fullmatch(text):
        return _float(text)
    return text


def _float(text: str) -> float:
    if text.lower().endswith((".inf", ".nan")):
        return math.nan if text.lower() == ".nan" else math.copysign(math.inf, -1 if text[0] == "-" else 1)
    return float(text)
