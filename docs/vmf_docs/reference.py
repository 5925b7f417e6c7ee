"""The reference of all keys of a spec, written from the models that check it."""

from __future__ import annotations

import ast
import inspect
import json
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from mdit_py_plugins.anchors.index import slugify

from vmf.data.importers import FORMATS
from vmf.spec import Spec, StudySpec
from vmf.spec.base import Model
from vmf.spec.shape import Shape, shape_of
from vmf.spec.words import accepted

_HEAD = """\
# Reference of all keys

Written by `make docs` from the models that check a spec. To change a line, change its model in `vmf/spec/`.

A spec is a YAML file. A key that is not listed here is refused, with the nearest key that exists. Every key
can also be given behind a command, with dots between the levels: `vmf train SPEC noise.pixel_px=1`. The
command line beats the file, and the file beats the default. The `spec.yaml` of a run shows every key with its
value.

The unit is part of a key: `_px` pixels, `_m` metres, `_rad` radians, `_deg` degrees, `_s` seconds, `_hz` per
second. S is the frame that the robot moves: that of the hand, head or base with the cameras (eye-in-hand), or
of the tool that fixed cameras look at (eye-to-hand). `null` means "not given": the program chooses, as the
text says.

`vmf track FILE.mcap --tracker NAME key=value …` has the keys of the [tracker](#datarecordingimages) of that
name.
"""
_IMPORT = """\
## Settings of vmf import

Given as `vmf import FORMAT SOURCE -o FILE.mcap key=value …`.
"""
_UNITS = {"px": "px", "m": "m", "rad": "rad", "deg": "°", "s": "s", "hz": "Hz", "percent": "%"}
_COMPOUND = {"_per_sqrt_m": "/√m", "_per_s": "1/s"}
# Defaults longer than this are those of a section of their own.
_LONGEST = 70


def reference() -> str:
    """Return the page."""
    return "\n".join([_HEAD, *_written().sections])


def documented_models() -> tuple[type[Model], ...]:
    """Return every model with a section on the page."""
    return tuple(_written().models)


def _written() -> _Tables:
    tables = _Tables()
    tables.write(Spec, "## A spec")
    tables.write(StudySpec, "## A study")
    tables.sections.append(_IMPORT)
    for name, form in FORMATS.items():
        tables.write(form.options, f"### vmf import {name}")
    return tables


def unit(key: str) -> str:
    """Return the unit that a key ends with, or nothing."""
    for ending, name in _COMPOUND.items():
        if key.endswith(ending):
            return f"{_UNITS.get(key.removesuffix(ending).rsplit('_', 1)[-1], '')}{name}".removeprefix("/1")
    return _UNITS.get(key.rsplit("_", 1)[-1], "") if "_" in key else ""


def meanings(model: type[Model]) -> dict[str, str]:
    """Return what the strings below a model's attributes, and below those it inherits, say."""
    found: dict[str, str] = {}
    for cls in reversed(model.__mro__):
        if not issubclass(cls, Model) or cls is Model:
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0]
        assert isinstance(body, ast.ClassDef)
        for node, after in zip(body.body, body.body[1:], strict=False):
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                match after:
                    case ast.Expr(value=ast.Constant(value=str(text))):
                        found[node.target.id] = inspect.cleandoc(text)
    return found


def _all_models(base: type[Model] = Model) -> Iterator[type[Model]]:
    for model in base.__subclasses__():
        yield model
        yield from _all_models(model)


@dataclass
class _Tables:
    """One section for a file's top level and for each mapping in it, each model once.

    Attributes
    ----------
    sections : what has been written.
    models : the models that have a section.
    anchors : of the sections, by the models' names.
    """

    sections: list[str] = field(default_factory=list)
    models: list[type[Model]] = field(default_factory=list)
    anchors: dict[str, str] = field(default_factory=dict)

    def write(self, model: type[Model], heading: str) -> None:
        """Write the section of a model, and those of the models it holds."""
        self._section(shape_of(model), "", heading)

    def _section(self, shape: Shape, path: str, heading: str) -> None:
        name = shape.schema["title"]
        self.anchors[name] = slugify(heading.lstrip("# ").replace("`", ""))
        at = len(self.sections)
        model = next(model for model in _all_models() if model.__name__ == name)
        self.models.append(model)
        text = meanings(model)
        # The heading says which kind it is.
        keys = [key for key in shape.properties if key != "kind"]
        rows = [self._row(shape, key, path, text.get(key, "")) for key in keys]
        lines = [heading, "", inspect.cleandoc(shape.schema.get("description", "")), ""]
        if rows:
            lines += [
                "| key | accepted | unit | default | meaning |",
                "| --- | --- | --- | --- | --- |",
                *rows,
                "",
            ]
        self.sections.insert(at, "\n".join(lines))

    def _row(self, shape: Shape, key: str, path: str, meaning: str) -> str:
        child = shape.child(key)
        links = [self._link(*inner) for inner in _mappings(child, f"{path}.{key}" if path else key)]
        phrase = _cell(accepted(child)) or "a value"
        if links:
            values = [_cell(accepted(other)) for other in child.alternatives if not other.properties]
            phrase = " or ".join([*values, ", ".join(links)]) + (" or null" if child.nullable else "")
            phrase = f"a list, each: {phrase}" if child.schema.get("type") == "array" else phrase
        default = "required" if key in shape.required else _default(child.schema.get("default"), bool(links))
        return f"| `{key}` | {phrase} | {unit(key)} | {default} | {_cell(meaning)} |"

    def _link(self, shape: Shape, path: str, kind: str) -> str:
        name = shape.schema["title"]
        if name not in self.anchors:
            self._section(shape, path, f"### `{path}`" + (f" with `kind: {kind}`" if kind else ""))
        return f"[{kind or path.rsplit('.', 1)[-1]}](#{self.anchors[name]})"


def _mappings(shape: Shape, path: str) -> Iterator[tuple[Shape, str, str]]:
    """Yield the mappings that may stand in a place, with their path and their kind."""
    if shape.tag is not None:
        for kind, inner in shape.kinds.items():
            yield inner, path, kind
    elif shape.properties:
        yield shape, path, ""
    elif shape.schema.get("type") == "array" and "items" in shape.schema:
        yield from _mappings(shape.child(0), f"{path}[…]")
    for inner in shape.alternatives:
        yield from _mappings(inner, path)


def _default(value: Any, is_section: bool) -> str:
    if is_section and isinstance(value, dict):
        return f"`{value['kind']}`" if "kind" in value else "the section's"
    text = json.dumps(value, ensure_ascii=False) if isinstance(value, list) else _scalar(value)
    return f"`{_cell(text)}`" if len(text) <= _LONGEST else f"{len(value)} entries, see a run's `spec.yaml`"


def _scalar(value: Any) -> str:
    return json.dumps(value) if not isinstance(value, str) else value


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
