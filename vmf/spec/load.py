"""An experiment spec from a YAML file and the command line, or everything that is wrong with it at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vmf.errors import InputError
from vmf.spec.check import checked
from vmf.spec.model import Spec
from vmf.spec.overrides import Override, overridden
from vmf.spec.shape import shape_of
from vmf.spec.yaml_source import Node, Problem, in_file, parse

_MOST_BYTES = 1_000_000


@dataclass(frozen=True)
class LoadedSpec:
    """A checked spec with the file it came from, the file's text, and the command line's overrides."""

    spec: Spec
    path: Path
    overrides: tuple[str, ...]
    text: str


def load(path: Path, overrides: Sequence[str] = ()) -> LoadedSpec:
    """The spec in a file, overridden by `a.b.c=value` texts; raises `InputError` with all problems."""
    return load_all(path, [overrides])[0]


def load_all(path: Path, variants: Sequence[Sequence[str | Override]]) -> list[LoadedSpec]:
    """One spec per variant of overrides of the same file; raises `InputError` with all problems of all."""
    return _loads_all(read_text(path, "a spec in YAML"), str(path), variants)


def loads(text: str, name: str = "<spec>", overrides: Sequence[str] = ()) -> LoadedSpec:
    """The spec in `text`, called `name` in messages; see `load`."""
    return _loads_all(text, name, [overrides])[0]


def _loads_all(text: str, name: str, variants: Sequence[Sequence[str | Override]]) -> list[LoadedSpec]:
    unreadable: list[Problem] = []
    root = parse(text, in_file(name), unreadable)
    if root is None and not unreadable:
        needed = ", ".join(shape_of(Spec).required)
        raise InputError(f"{name}: empty, a mapping is accepted (required: {needed})")
    if root is None:
        raise _refusal(unreadable)
    loaded, found = [], list(unreadable)
    for overrides in variants:
        problems = list(unreadable)
        spec = _checked(root, overrides, problems)
        found += problems
        if spec is not None and not problems:
            texts = tuple(o if isinstance(o, str) else o.text for o in overrides)
            loaded.append(LoadedSpec(spec, Path(name), texts, text))
    if found:
        raise _refusal(found)
    return loaded


def _refusal(problems: list[Problem]) -> InputError:
    # Variants of one file have mistakes in common.
    return InputError(*dict.fromkeys(map(str, sorted(problems, key=lambda problem: problem.place))))


def _checked(root: Node, overrides: Sequence[str | Override], problems: list[Problem]) -> Spec | None:
    if isinstance(root.value, dict):
        root = overridden(root, shape_of(Spec), overrides, problems)
    # What could not be read stands in the tree as null, and is not to be reported again for that.
    unreadable = {problem.place for problem in problems}
    found: list[Problem] = []
    spec = checked(Spec, root, found)
    problems += [problem for problem in found if problem.place not in unreadable]
    return spec


def read_text(path: Path, accepted: str) -> str:
    """The text of a file in which `accepted`, such as "a spec in YAML", is expected; raises `InputError`."""
    try:
        with path.open("rb") as file:
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
