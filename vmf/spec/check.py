"""A tree of nodes against a model: the model's instance, or everything that is wrong with the tree."""

from __future__ import annotations

import json
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from vmf.spec.messages import problems_in
from vmf.spec.shape import Shape, shape_of
from vmf.spec.yaml_source import Node, Problem

ModelType = TypeVar("ModelType", bound=BaseModel)

_EXACT = 2.0**53


def checked(model: type[ModelType], root: Node, problems: list[Problem]) -> ModelType | None:
    """An instance of `model`, or None after what is wrong has joined `problems`."""
    shape = shape_of(model)
    try:
        # Strict JSON takes lists for tuples and 3 for 3.0, yet neither "3" nor true for a number.
        return model.model_validate_json(json.dumps(_plain(root, shape)), strict=True)
    except ValidationError as error:
        problems += problems_in(error.errors(include_url=False), root, shape)
        return None


def _plain(node: Node, shape: Shape) -> Any:
    """The value without places; a section without a kind gets the kind of the model's default."""
    if isinstance(node.value, dict):
        inner, branch = shape.narrow(node), shape.branch(node)
        values = {key: _plain(child, inner.child(key)) for key, child in node.value.items()}
        if branch.tag is not None and branch.tag not in values:
            kind = branch.kind_of(node)
            return values if kind is None else {**values, branch.tag: kind}
        return values
    if isinstance(node.value, list):
        inner = shape.branch(node)
        return [_plain(child, inner.child(index)) for index, child in enumerate(node.value)]
    choices = shape.branch(node).choices
    if isinstance(node.value, bool) and choices and not any(choice is node.value for choice in choices):
        return node.text  # pydantic takes true for the choice 1, even when strict
    if isinstance(node.value, float) and node.value.is_integer() and abs(node.value) < _EXACT:
        return int(node.value)  # 2.0 is a whole number too, and JSON keeps the two apart
    return node.value
