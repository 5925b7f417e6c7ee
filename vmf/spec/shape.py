"""What may stand where in a spec, read off the models' JSON schema, so that no key is listed twice."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel

from vmf.spec.yaml_source import Node

Schema = Mapping[str, Any]

_DEEPEST = 8


@dataclass(frozen=True)
class Shape:
    """What one place in a spec accepts: a schema without references, `null` noted apart."""

    schema: Schema
    definitions: Schema
    nullable: bool = False

    @property
    def properties(self) -> tuple[str, ...]:
        """The keys a mapping here may have."""
        return tuple(self.schema.get("properties", ()))

    @property
    def required(self) -> tuple[str, ...]:
        """The keys a mapping here must have."""
        return tuple(self.schema.get("required", ()))

    @property
    def choices(self) -> tuple[Any, ...]:
        """The values accepted here, if they are counted."""
        const = (self.schema["const"],) if "const" in self.schema else ()
        return (*self.schema.get("enum", ()), *const)

    @property
    def alternatives(self) -> tuple[Shape, ...]:
        """The members of a union without a tag."""
        if self.tag is not None:
            return ()
        members = (*self.schema.get("anyOf", ()), *self.schema.get("oneOf", ()))
        return tuple(self._of(member) for member in members if member.get("type") != "null")

    @property
    def tag(self) -> str | None:
        """The key that tells the members of a tagged union apart."""
        name = self.schema.get("discriminator", {}).get("propertyName")
        return None if name is None else str(name)

    @property
    def kinds(self) -> dict[str, Shape]:
        """The members of a tagged union by their tag's value, in the order of the model."""
        by_reference = {ref: kind for kind, ref in self.schema["discriminator"]["mapping"].items()}
        members = [member["$ref"] for member in self.schema["oneOf"]]
        return {by_reference[ref]: self._of({"$ref": ref}) for ref in members}

    def kind_of(self, node: Node) -> Any:
        """The kind a mapping says it has; without one (or with its key misspelt) the best guess, or None."""
        assert isinstance(node.value, dict)
        assert self.tag is not None
        if self.tag in node.value:
            return node.value[self.tag].value
        names = {name for kind in self.kinds.values() for name in kind.properties}
        for key, child in node.value.items():
            misspelt = key not in names and nearest(key, names) == self.tag
            if misspelt and isinstance(child.value, str) and child.value in self.kinds:
                return child.value
        default = self.schema.get("default")
        return default.get(self.tag) if isinstance(default, dict) else None

    def branch(self, node: Node) -> Shape:
        """The member of an untagged union that fits the sort of `node`: mapping, list or scalar."""
        for alternative in self.alternatives:
            if alternative.fits(node):
                return alternative.branch(node)
        return self

    def narrow(self, node: Node) -> Shape:
        """The shape that applies to `node` itself, its kind chosen."""
        shape = self.branch(node)
        if shape.tag is None or not isinstance(node.value, dict):
            return shape
        kind = shape.kind_of(node)
        return shape.kinds[kind] if isinstance(kind, str) and kind in shape.kinds else shape

    def child(self, step: str | int) -> Shape:
        """What is accepted under a key or index; a shape that says nothing where nothing is known."""
        if isinstance(step, int):
            items = self.schema.get("prefixItems", ())
            return self._of(items[step] if step < len(items) else self.schema.get("items", {}))
        rest = self.schema.get("additionalProperties")
        return self._of(
            self.schema.get("properties", {}).get(step) or (rest if isinstance(rest, dict) else {})
        )

    def fits(self, node: Node) -> bool:
        """Whether `node` is of the right sort, whatever its content."""
        if self.alternatives:
            return any(alternative.fits(node) for alternative in self.alternatives)
        sort = "object" if self.tag is not None else self.schema.get("type")
        wanted = (
            "object" if isinstance(node.value, dict) else "array" if isinstance(node.value, list) else None
        )
        return sort == wanted if wanted else sort not in ("object", "array")

    def homes(self, key: str, path: Sequence[str] = ()) -> list[str]:
        """The dotted sections at or below this place that have `key`."""
        if len(path) > _DEEPEST:
            return []
        members = [*self.alternatives, *(self.kinds.values() if self.tag is not None else ())]
        if "items" in self.schema:
            members.append(self.child(0))
        found = [".".join(path) or "the top level"] if key in self.properties else []
        found += [home for member in members for home in member.homes(key, path)]
        found += [home for name in self.properties for home in self.child(name).homes(key, (*path, name))]
        return list(dict.fromkeys(found))

    def _of(self, schema: Schema) -> Shape:
        return resolved(schema, self.definitions)


@cache
def shape_of(model: type[BaseModel]) -> Shape:
    """What a file of `model` may say."""
    schema = model.model_json_schema()
    return resolved(schema, schema.get("$defs", {}))


def resolved(schema: Schema, definitions: Schema) -> Shape:
    """The shape of a schema, references followed and `X | None` opened."""
    nullable = False
    while True:
        members = [member for member in schema.get("anyOf", ()) if member.get("type") != "null"]
        nullable = nullable or len(members) < len(schema.get("anyOf", ()))
        if "$ref" in schema:
            inner, outer = definitions[schema["$ref"].rsplit("/", 1)[1]], "$ref"
        elif len(members) == 1:
            inner, outer = members[0], "anyOf"
        else:
            return Shape(schema, definitions, nullable)
        schema = {**inner, **{key: value for key, value in schema.items() if key != outer}}


def nearest(word: object, names: Iterable[Any]) -> Any:
    """The name a person most likely meant by `word`, or None."""
    by_fold = {str(name).casefold(): name for name in names}
    matches = difflib.get_close_matches(str(word).casefold(), by_fold, n=1)
    return by_fold[matches[0]] if matches else None
