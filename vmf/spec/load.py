"""A spec from a YAML file and the command line, or everything that is wrong with it at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from vmf.errors import InputError
from vmf.regular_file import open_regular
from vmf.spec.base import Model
from vmf.spec.check import checked
from vmf.spec.model import Spec
from vmf.spec.overrides import Override, overridden
from vmf.spec.shape import shape_of
from vmf.spec.studies import StudySpec
from vmf.spec.yaml_source import Node, Problem, in_file, parse

_MOST_BYTES = 1_000_000
# The key that tells a study from an experiment.
_STUDY = "study"

S = TypeVar("S", bound=Model)


@dataclass(frozen=True)
class Loaded(Generic[S]):
    """A checked spec with the file it came from, the file's text, and the command line's overrides."""

    spec: S
    path: Path
    overrides: tuple[str, ...]
    text: str


LoadedSpec = Loaded[Spec]
LoadedStudy = Loaded[StudySpec]


def load(path: Path, overrides: Sequence[str] = ()) -> LoadedSpec:
    """The spec in a file, overridden by `a.b.c=value` texts; raises `InputError` with all problems."""
    return load_all(path, [overrides])[0]


def load_all(path: Path, variants: Sequence[Sequence[str | Override]]) -> list[LoadedSpec]:
    """One spec per variant of overrides of the same file; raises `InputError` with all problems of all."""
    return _loads_all(Spec, read_text(path, "a spec in YAML"), str(path), variants)


def load_study(path: Path, overrides: Sequence[str] = ()) -> LoadedStudy:
    """The study in a file, overridden; raises `InputError` with all problems."""
    return load_studies(path, [overrides])[0]


def load_studies(path: Path, variants: Sequence[Sequence[str | Override]]) -> list[LoadedStudy]:
    """One study per variant of overrides of the same file; raises `InputError` with all problems of all."""
    return _loads_all(StudySpec, read_text(path, "a study in YAML"), str(path), variants)


def is_study(path: Path) -> bool:
    """Whether a file says `study:`; one that cannot be read or parsed does not."""
    try:
        root = parse(read_text(path, "a spec in YAML"), in_file(str(path)), [])
    except InputError:
        return False
    return root is not None and isinstance(root.value, dict) and _STUDY in root.value


def loads(text: str, name: str = "<spec>", overrides: Sequence[str] = ()) -> LoadedSpec:
    """The spec in `text`, called `name` in messages; see `load`."""
    return _loads_all(Spec, text, name, [overrides])[0]


def loads_study(text: str, name: str = "<study>", overrides: Sequence[str] = ()) -> LoadedStudy:
    """The study in `text`, called `name` in messages; see `load_study`."""
    return _loads_all(StudySpec, text, name, [overrides])[0]


def _loads_all(
    model: type[S], text: str, name: str, variants: Sequence[Sequence[str | Override]]
) -> list[Loaded[S]]:
    unreadable: list[Problem] = []
    root = parse(text, in_file(name), unreadable)
    if root is None and not unreadable:
        needed = ", ".join(shape_of(model).required)
        raise InputError(f"{name}: empty, a mapping is accepted (required: {needed})")
    if root is None:
        raise _refusal(unreadable)
    _check_sort(model, root, name)
    loaded, found = [], list(unreadable)
    for overrides in variants:
        problems = list(unreadable)
        spec = _checked(model, root, overrides, problems)
        found += problems
        if spec is not None and not problems:
            texts = tuple(o if isinstance(o, str) else o.text for o in overrides)
            loaded.append(Loaded(spec, Path(name), texts, text))
    if found:
        raise _refusal(found)
    return loaded


def _check_sort(model: type[Model], root: Node, name: str) -> None:
    """Raise `InputError` for a study where an experiment is accepted, and for the opposite."""
    if not isinstance(root.value, dict):
        return
    study = root.value.get(_STUDY)
    if study is not None and model is Spec:
        label = study.key.label
        raise InputError(f"{label}: found a study, an experiment is accepted; `vmf study {name}` runs it")
    if study is None and model is StudySpec and {"task", "data"} & root.value.keys():
        raise InputError(f"{name}: found an experiment, a study is accepted; `vmf train {name}` runs it")


def _refusal(problems: list[Problem]) -> InputError:
    # Variants of one file have mistakes in common.
    return InputError(*dict.fromkeys(map(str, sorted(problems, key=lambda problem: problem.place))))


def _checked(
    model: type[S], root: Node, overrides: Sequence[str | Override], problems: list[Problem]
) -> S | None:
    if isinstance(root.value, dict):
        root = overridden(root, shape_of(model), overrides, problems)
    # What could not be read stands in the tree as null, and is not to be reported again for that.
    unreadable = {problem.place for problem in problems}
    found: list[Problem] = []
    spec = checked(model, root, found)
    problems += [problem for problem in found if problem.place not in unreadable]
    return spec


def read_text(path: Path, accepted: str) -> str:
    """The text of a file in which `accepted`, such as "a spec in YAML", is expected; raises `InputError`."""
    try:
        with open_regular(path) as file:
            content = file.read(_MOST_BYTES + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, {accepted} is accepted") from None
    except IsADirectoryError:
        raise InputError(f"{path}: a directory, {accepted} is accepted") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from None
    return decoded(content, str(path), accepted)


def decoded(content: bytes, name: str, accepted: str) -> str:
    """The text of a file's content, if it is short enough and UTF-8; raises `InputError`."""
    if len(content) > _MOST_BYTES:
        raise InputError(f"{name}: larger than {_MOST_BYTES} bytes, {accepted} is accepted")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = error.object[: error.start].split(b"\n")
        place = in_file(name)(len(before) - 1, len(before[-1].decode("utf-8")))
        found = f"byte 0x{error.object[error.start]:02x}"
        raise InputError(f"{place.label}: found {found}, text in UTF-8 is accepted") from None
