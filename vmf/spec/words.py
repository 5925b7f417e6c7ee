"""Plain words for what was found and for what is accepted."""

from __future__ import annotations

from typing import Any

from vmf.spec.shape import Schema, Shape
from vmf.spec.yaml_source import Node

_LONGEST = 60


def sentence(shape: Shape, phrase: str = "") -> str:
    """What a shape accepts (or `phrase`, if given) as the end of a message."""
    phrase = phrase or accepted(shape)
    is_list = shape.choices or shape.alternatives or "," in phrase or ":" in phrase
    return f"accepted: {phrase}" if is_list else f"{phrase or 'a value'} is accepted"


def shown(node: Node) -> str:
    """A value as it was written, cut short."""
    if node.value is None:
        return node.text or "nothing"
    if isinstance(node.value, str):
        cut = node.value if len(node.value) <= _LONGEST else node.value[:_LONGEST] + "…"
        return repr(cut)
    if isinstance(node.value, dict):
        text = ", ".join(f"{key}: {shown(child)}" for key, child in node.value.items())
        return f"{{{text}}}" if len(text) <= _LONGEST else "a mapping"
    if isinstance(node.value, list):
        text = ", ".join(shown(child) for child in node.value)
        return f"[{text}]" if len(text) <= _LONGEST else f"a list of {len(node.value)}"
    return node.text if len(node.text) <= _LONGEST else node.text[:_LONGEST] + "…"


def accepted(shape: Shape) -> str:
    """What a shape accepts, in plain words."""
    phrase = _phrase(shape)
    if not shape.nullable or not phrase:
        return phrase
    return f"null or {phrase}" if shape.schema.get("type") in ("array", "object") else f"{phrase} or null"


def _phrase(shape: Shape) -> str:
    schema = shape.schema
    if shape.choices:
        return ", ".join(_literal(choice) for choice in shape.choices)
    if shape.tag is not None:
        return f"a mapping with {shape.tag}: {' / '.join(shape.kinds)}"
    if shape.alternatives:
        return " or ".join(filter(None, map(_phrase, shape.alternatives)))
    match schema.get("type"):
        case "object":
            return f"a mapping of {', '.join(shape.properties)}" if shape.properties else "a mapping"
        case "array":
            return _array(shape)
        case "integer":
            return f"a whole number{_range(schema)}"
        case "number":
            return f"a number{_range(schema)}"
        case "string":
            return _string(schema)
        case "boolean":
            return "true or false"
        case "null":
            return "null"
    return ""


def _literal(value: Any) -> str:
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else str(value)


def _range(schema: Schema) -> str:
    words = {
        "exclusiveMinimum": "greater than",
        "minimum": "of at least",
        "exclusiveMaximum": "less than",
        "maximum": "of at most",
        "multipleOf": "that is a multiple of",
    }
    bounds = [f"{text} {schema[key]:.12g}" for key, text in words.items() if key in schema]
    return f" {' and '.join(bounds)}" if bounds else ""


def _array(shape: Shape) -> str:
    schema = shape.schema
    fewest, most = schema.get("minItems"), schema.get("maxItems")
    if fewest is not None and fewest == most:
        size = f" of {fewest}"
    else:
        size = f" of at least {fewest}" if fewest else ""
        size += f"{' and' if size else ' of'} at most {most}" if most is not None else ""
    members = {accepted(shape.child(index)): None for index in range(len(schema.get("prefixItems", "1")))}
    each = next(iter(members)) if len(members) == 1 else ""
    return f"a list{size}, each {each}" if each else f"a list{size}"


def _string(schema: Schema) -> str:
    if "format" in schema:
        return f"a {schema['format']}"
    if "pattern" in schema:
        return f"text that matches {schema['pattern']}"
    fewest, most = schema.get("minLength"), schema.get("maxLength")
    size = [f"at least {fewest}"] if fewest else []
    size += [f"at most {most}"] if most is not None else []
    return f"text of {' and '.join(size)} characters" if size else "text"
