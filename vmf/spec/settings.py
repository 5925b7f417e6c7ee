"""One section of a spec on its own, from the settings a command line gives."""

from __future__ import annotations

from collections.abc import Sequence

from vmf.errors import InputError
from vmf.spec.check import ModelType, checked
from vmf.spec.overrides import overridden
from vmf.spec.shape import shape_of
from vmf.spec.yaml_source import Node, Place, Problem


def settings(model: type[ModelType], texts: Sequence[str]) -> ModelType:
    """Return the model with `a.b=value` texts put over its defaults.

    Raises
    ------
    InputError : unknown keys or wrong values, one line each.
    """
    place = Place(0, 0, 0, "command line")
    problems: list[Problem] = []
    root = overridden(Node({}, place, place), shape_of(model), texts, problems)
    result = None if problems else checked(model, root, problems)
    if result is None:
        raise InputError(*map(str, sorted(problems, key=lambda problem: problem.place)))
    return result
