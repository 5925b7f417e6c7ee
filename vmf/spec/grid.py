"""Many specs from one: `key=a,b,c` on the command line, or a grid in a YAML file."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from vmf.errors import InputError
from vmf.spec.load import read_text
from vmf.spec.overrides import Override, on_command_line
from vmf.spec.yaml_source import Node, Problem, in_file, parse, plain_scalar

_GRID = "`sweep:` with lists of values by key, or a list of mappings from keys to values, is accepted"
# Text that reads the same with and without quotes.
_PLAIN = re.compile(r"[\w.+/-]+")


@dataclass(frozen=True)
class Variant:
    """One point of a grid.

    Attributes
    ----------
    overrides : what it says of the spec, in order.
    settings : values, as written, by the keys that make it differ from other points.
    """

    overrides: tuple[Override, ...]
    settings: Mapping[str, str]


def variants(texts: Sequence[str], grid: Path | None = None) -> list[Variant]:
    """The cartesian product of `key=a,b,c` texts and a grid file; the last key varies fastest.

    Parameters
    ----------
    texts : from the command line; they beat the file's values for the same key. Commas in brackets, braces
        or quotes belong to a value.
    grid : YAML: `sweep:` and below it a list of values for each key, of which the product is taken, or a
        list of mappings, one for each point.

    Raises
    ------
    InputError : the file or a text is not of this form.
    """
    rows: list[dict[str, Override]] = [{}]
    axes: dict[str, list[Override]] = {}
    if grid is not None:
        rows, axes = _read(grid)
    for text in texts:
        key = text.partition("=")[0].strip()
        # The last of several for a key counts, in the place where it stands.
        axes.pop(key, None)
        axes[key] = [on_command_line(piece) for piece in _pieces(text)]
    many = {key for key, values in axes.items() if len(values) > 1}
    found = []
    for row in rows:
        for values in itertools.product(*axes.values()):
            told = {**row, **dict(zip(axes, values, strict=True))}
            differing = many | (row.keys() - axes.keys())
            settings = {key: _value(told[key]) for key in told if key in differing}
            found.append(Variant(tuple(told.values()), settings))
    return found


def _value(override: Override) -> str:
    return override.text.partition("=")[2].strip()


def _pieces(text: str) -> list[str]:
    """The text once for each of the values that its commas separate."""
    key, equals, value = text.partition("=")
    if "," not in value:
        return [text]
    # YAML itself knows which commas are inside of something.
    try:
        spans = _spans(f"[{value}]")
    except yaml.YAMLError:
        spans = []
    if not spans or value.rstrip().endswith(","):
        raise InputError(f"command line: {text}: values separated by commas are accepted, such as {key}=1,2")
    return [f"{key}{equals}{value[begin - 1 : end - 1].strip()}" for begin, end in spans]


def _spans(sequence: str) -> list[tuple[int, int]]:
    """Where the items of a YAML flow sequence begin and end."""
    spans, depth, begin = [], 0, 0
    events: Iterator[Any] = yaml.parse(sequence, Loader=yaml.SafeLoader)
    for event in events:
        if isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth == 1:
            if not isinstance(event, yaml.CollectionEndEvent):
                begin = event.start_mark.index
            if not isinstance(event, yaml.CollectionStartEvent):
                spans.append((begin, event.end_mark.index))
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
    return spans


def _read(path: Path) -> tuple[list[dict[str, Override]], dict[str, list[Override]]]:
    """The points that a grid file lists, and the values of which it wants the product."""
    problems: list[Problem] = []
    root = parse(read_text(path, "a grid in YAML"), in_file(str(path)), problems)
    if problems:
        raise InputError(*map(str, sorted(problems, key=lambda problem: problem.place)))
    below = root
    if root is not None and isinstance(root.value, dict) and list(root.value) == ["sweep"]:
        below = root.value["sweep"]
        if isinstance(below.value, dict) and below.value:
            return [{}], {key: _axis(key, node) for key, node in below.value.items()}
    if below is not None and isinstance(below.value, list) and below.value:
        return [_row(node) for node in below.value], {}
    raise InputError(f"{path if below is None else below.place.label}: {_GRID}")


def _row(node: Node) -> dict[str, Override]:
    if not isinstance(node.value, dict) or not node.value:
        raise InputError(f"{node.place.label}: {_GRID}")
    return {key: _override(key, child) for key, child in node.value.items()}


def _axis(key: str, node: Node) -> list[Override]:
    if not isinstance(node.value, list) or not node.value:
        raise InputError(f"{node.place.label}: {key}: a list of values is accepted, such as [1, 2]")
    return [_override(key, child) for child in node.value]


def _override(key: str, node: Node) -> Override:
    return Override(f"{key}={_flow(node)}", node.place.label)


def _flow(node: Node) -> str:
    """The node on one line, as the command line would have it."""
    if isinstance(node.value, dict):
        return "{" + ", ".join(f"{_quoted(key)}: {_flow(child)}" for key, child in node.value.items()) + "}"
    if isinstance(node.value, list):
        return "[" + ", ".join(_flow(child) for child in node.value) + "]"
    if isinstance(node.value, str):
        return _quoted(node.value)
    return node.text or "null"


def _quoted(text: str) -> str:
    if _PLAIN.fullmatch(text) and plain_scalar(text) == text:
        return text
    return json.dumps(text, ensure_ascii=False)
