"""The spec's models read as types, apart from the JSON schema that the loader reads them by."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from vmf.spec import Spec

MINIMAL: dict[str, Any] = {"task": "six_dof", "data": {"simulate": {}}}


@dataclass(frozen=True)
class Section:
    """A model somewhere in a spec; `document` puts a mapping there and valid values around it."""

    path: str
    model: type[BaseModel]
    document: Callable[[dict[str, Any]], dict[str, Any]]


def sections(model: type[BaseModel] = Spec) -> Iterator[Section]:
    """Every model reachable from the spec, at every place where it may stand."""
    yield from _sections(Section("", model, lambda content: content))


def _sections(section: Section) -> Iterator[Section]:
    yield section
    for name, field in section.model.model_fields.items():
        for step, model, wrap in _models(field.annotation):
            path = ".".join(filter(None, [section.path, name, step]))
            yield from _sections(Section(path, model, _nested(section, name, wrap)))


def _nested(section: Section, name: str, wrap: Callable[[Any], Any]) -> Callable[[dict[str, Any]], Any]:
    return lambda content: section.document({**required(section.model), name: wrap(content)})


def _models(annotation: Any) -> Iterator[tuple[str, type[BaseModel], Callable[[Any], Any]]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield "", annotation, lambda content: content
    elif get_origin(annotation) in (tuple, list):
        for step, model, wrap in _models(get_args(annotation)[0]):
            yield ".".join(filter(None, ["0", step])), model, _listed(wrap)
    elif get_origin(annotation) in (Annotated, Union, UnionType):
        for member in get_args(annotation):
            yield from _models(member)


def _listed(wrap: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda content: [wrap(content)]


def required(model: type[BaseModel]) -> dict[str, Any]:
    """Valid values for what a mapping of `model` must have, and the kind that tells it apart."""
    if model is Spec:
        return MINIMAL
    return {
        name: _example(field.annotation)
        for name, field in model.model_fields.items()
        if field.is_required() or len(_literals(field.annotation)) == 1
    }


def _literals(annotation: Any) -> tuple[Any, ...]:
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def _example(annotation: Any) -> Any:
    if get_origin(annotation) is tuple:
        return [_example(member) for member in get_args(annotation) if member is not Ellipsis]
    if get_origin(annotation) in (Annotated, Union, UnionType):
        return _example(get_args(annotation)[0])
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return required(annotation)
    return _literals(annotation)[0] if _literals(annotation) else "text" if annotation is str else 1


def values(annotation: Any, constraints: tuple[Any, ...] = ()) -> st.SearchStrategy[Any]:
    """Valid values of an annotation, models included."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return instances(annotation)
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        nested = [m for each in arguments[1:] for m in getattr(each, "metadata", [each])]
        return values(arguments[0], (*constraints, *nested))
    if origin in (Union, UnionType):
        return st.one_of([values(member, constraints) for member in arguments])
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(values(arguments[0]), max_size=3).map(tuple)
    if origin is tuple:
        return st.tuples(*map(values, arguments))
    if annotation in (int, float):
        return _numbers(annotation, constraints)
    return {str: st.text(), bool: st.booleans(), type(None): st.none()}[annotation]


def _numbers(kind: type, constraints: tuple[Any, ...]) -> st.SearchStrategy[Any]:
    bounds: dict[str, Any] = {
        key: getattr(constraint, key)
        for constraint in constraints
        for key in ("gt", "ge", "lt", "le")
        if getattr(constraint, key, None) is not None
    }
    low, high = bounds.get("gt", bounds.get("ge")), bounds.get("lt", bounds.get("le"))
    if kind is int:
        return st.integers(None if low is None else low + ("gt" in bounds), high)
    return st.floats(
        low,
        high,
        exclude_min="gt" in bounds,
        exclude_max="lt" in bounds,
        allow_nan=False,
        allow_infinity=False,
    )


def instances(model: type[BaseModel]) -> st.SearchStrategy[Any]:
    """Valid instances of a model."""
    fields = {name: values(f.annotation, tuple(f.metadata)) for name, f in model.model_fields.items()}
    needed = {name: fields[name] for name, field in model.model_fields.items() if field.is_required()}
    optional = {name: strategy for name, strategy in fields.items() if name not in needed}

    def build(content: dict[str, Any]) -> BaseModel | None:
        try:
            return model(**content)
        except ValidationError:
            return None  # a combination that a validator of the model refuses

    drawn = st.fixed_dictionaries(needed, optional=optional).map(build)
    return drawn.filter(lambda instance: instance is not None)
