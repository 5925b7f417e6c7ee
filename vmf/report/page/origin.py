"""Which runs are of the thesis's experiments: what their specs say counts, not the names of directories."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

import vmf
from vmf.report.page.claims import UNKNOWNS, Thesis, ThesisFigure
from vmf.report.page.numbers import listed
from vmf.report.page.runs import Run, flat
from vmf.spec import Spec, StudySpec, is_study, load_all, load_studies, variants
from vmf.spec.overrides import Override

# What may differ from a config: how much work goes into the same question, and when it is asked.
_AMOUNTS = (
    "data.simulate.frames",
    *(
        f"evaluate.{name}"
        for name in ("trials", "checkpoints", "beyond", "queries", "curve_points", "curve_last", "bootstrap")
    ),
    *(
        f"study.{name}"
        for name in ("tests", "timed", "repeats", "starts", "questions", "points", "orders", "runs")
    ),
)
# Of these lists it may be a part: of several cases some, but no others.
_CASES = tuple(f"study.{name}" for name in ("codes", "noise", "gains_per_s", "sources", "rank_overlays"))
# A list of cases in one study, an amount in another.
_EITHER = ("study.frames",)
# What may be left out (`null`), but not be something else.
_OPTIONAL = ("study.other_tilt_deg",)
EFFORT = (*_AMOUNTS, *_CASES, *_EITHER, *_OPTIONAL)
# Keys that are named where a run differs in more.
_MOST_KEYS = 3

Question = frozenset[tuple[str, Any]]


@dataclass(frozen=True)
class Counted:
    """The runs that the page is made of.

    Attributes
    ----------
    runs : those of the thesis's experiments and of the sweeps over what it leaves open, by their names.
    others : those of no experiment of the thesis.
    points : how many points the grid of each sweep has, by its name.
    notes : what is not counted though its directory has an experiment's name.
    """

    runs: tuple[Run, ...]
    others: tuple[Run, ...]
    points: Mapping[str, int]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Origin:
    """A config, or a point of the grid of a sweep.

    Attributes
    ----------
    name : of its runs.
    command : what makes them.
    swept : whether it is a point of a grid.
    spec : what it says.
    effort : keys in which its runs may say something else.
    """

    name: str
    command: str
    swept: bool
    spec: Mapping[str, Any]
    effort: frozenset[str]

    @property
    def question(self) -> Question:
        """What it asks."""
        return _question(self.spec, self.effort)


def configs() -> Path | None:
    """Return the directory of the thesis's configs: below the working directory, or in the source tree."""
    roots = (Path(), Path(vmf.__file__).parents[1])
    return next((found for root in roots if (found := root / "configs" / "thesis").is_dir()), None)


def counted(runs: Sequence[Run], thesis: Thesis, directory: Path | None) -> Counted:
    """Return which of some runs are of the thesis's experiments.

    A run is of a config if its spec is the config's, but for how much work goes into it, such as some of a
    list of cases; of a sweep over what the thesis leaves open if it is so of a point of the grid as it is
    now. Of several runs of a point the one with the grid's own effort counts, and the newest of those.

    Parameters
    ----------
    runs : finished runs.
    thesis : the experiments.
    directory : of their configs; without it no run is known.

    Raises
    ------
    InputError : a config or a grid cannot be read.
    """
    origins = [one for figure in thesis.figures for one in _origins(figure, directory)]
    asked: dict[tuple[str, frozenset[str]], dict[Question, _Origin]] = {
        (one.command, one.effort): {} for one in origins
    }
    for one in origins:
        asked[one.command, one.effort][one.question] = one
    found: dict[int, _Origin] = {}
    for number, run in enumerate(runs):
        spec = as_it_is_now(run.record.get("spec"))
        for (command, effort), known in asked.items():
            origin = known.get(_question(spec, effort)) if command == run.command else None
            if origin is not None and not _other_cases(spec, origin):
                found[number] = origin
    points: dict[int, list[int]] = {}
    for number, origin in found.items():
        if origin.swept:
            points.setdefault(id(origin), []).append(number)
    doubles = {n for several in points.values() for n in several} - {
        max(several, key=lambda n: _rank(runs[n], found[n])) for several in points.values()
    }
    counted = [
        replace(runs[n], name=origin.name, overrides=_overrides(runs[n], origin))
        for n, origin in found.items()
        if n not in doubles
    ]
    lost = [run for number, run in enumerate(runs) if number not in found]
    grids = {figure.sweep for figure in thesis.figures if figure.unknowns}
    sizes = {name: sum(one.name == name and one.swept for one in origins) for name in grids}
    return Counted(
        tuple(counted),
        tuple(run for run in lost if run.name not in grids),
        {name: size for name, size in sizes.items() if size},
        (*_strangers(lost, origins, grids, directory), *_superseded([runs[n].name for n in sorted(doubles)])),
    )


def _origins(figure: ThesisFigure, directory: Path | None) -> Iterable[_Origin]:
    if directory is None or not (path := directory / f"{figure.config}.yaml").exists():
        return
    specs = _specs(path, [()])
    yield _Origin(figure.config, figure.command, False, specs[0], frozenset(EFFORT))
    grid = directory / "unknowns" / f"{figure.config}.yaml"
    if figure.unknowns and grid.exists():
        specs = _specs(path, [variant.overrides for variant in variants((), grid)])
        # What the grid varies is no matter of effort.
        effort = frozenset(key for key in EFFORT if all(_at(s, key) == _at(specs[0], key) for s in specs))
        for spec in specs:
            yield _Origin(figure.sweep, figure.command, True, spec, effort)


def _specs(path: Path, given: Sequence[Sequence[str | Override]]) -> list[Mapping[str, Any]]:
    if is_study(path):
        return [one.spec.model_dump(mode="json") for one in load_studies(path, given)]
    return [one.spec.model_dump(mode="json") for one in load_all(path, given)]


def as_it_is_now(spec: object) -> Mapping[str, Any]:
    """Return a recorded spec with what has since been added to specs, as it was where it fits no more."""
    model = StudySpec if isinstance(spec, Mapping) and "study" in spec else Spec
    try:
        return model.model_validate(spec).model_dump(mode="json")
    except ValidationError:
        return spec if isinstance(spec, Mapping) else {}


def _question(spec: Mapping[str, Any], effort: Iterable[str]) -> Question:
    """Return what a spec asks, whatever work goes into it."""
    below = tuple(f"{key}." for key in effort)
    return frozenset(
        (key, value) for key, value in flat(spec).items() if key not in effort and not key.startswith(below)
    )


def _other_cases(spec: Mapping[str, Any], origin: _Origin) -> dict[str, str]:
    """Return how a spec differs from its origin in more than effort, though in keys of effort, by key."""
    pairs = [(key, _at(spec, key), _at(origin.spec, key)) for key in EFFORT if key in origin.effort]
    return {
        key: f"{key} is {json.dumps(value)}, not {_accepted(key, given)}"
        for key, value, given in pairs
        if not _is_effort(key, value, given)
    }


def _is_effort(key: str, value: Any, given: Any) -> bool:
    """Return whether a value in place of that of a config asks the same, with less or more work."""
    if value == given or key in _AMOUNTS:
        return True
    if key in _OPTIONAL:
        return value is None
    if isinstance(given, list):
        return isinstance(value, list) and bool(value) and all(one in given for one in value)
    return key in _EITHER


def _accepted(key: str, given: Any) -> str:
    said = json.dumps(given)
    if key in _OPTIONAL:
        return f"{said} or null"
    return f"{said} or a part of it" if isinstance(given, list) else said


def _overrides(run: Run, origin: _Origin) -> tuple[str, ...]:
    """Return what makes a run from its origin: it differs in nothing but effort."""
    spec = as_it_is_now(run.record.get("spec"))
    pairs = [(key, _at(spec, key), _at(origin.spec, key)) for key in EFFORT]
    return tuple(f"{key}={json.dumps(value)}" for key, value, given in pairs if value != given)


def _at(nested: Any, key: str) -> Any:
    for part in key.split("."):
        nested = nested.get(part) if isinstance(nested, Mapping) else None
    return nested


def _rank(run: Run, origin: _Origin) -> tuple[bool, str]:
    return not _overrides(run, origin), str(run.record.get("finished", ""))


def _strangers(
    lost: Sequence[Run], origins: Sequence[_Origin], grids: Iterable[str], directory: Path | None
) -> list[str]:
    """Return a line on each run that has the name of an experiment and is none of it, and on stale points."""
    said = []
    for name in sorted(grids):
        stale = sum(run.name == name for run in lost)
        if stale:
            config = name.removesuffix(UNKNOWNS)
            are = "is" if stale == 1 else "are"
            said.append(
                f"not counted: {_number(stale, 'run')} of {name} that {are} no point of "
                f"{directory}/unknowns/{config}.yaml as it is now"
            )
    named = {one.name: one for one in origins if not one.swept}
    others = [run for run in lost if run.name in named]
    return said + [
        f"not counted: {run.path.name} is no run of {run.name}: {_difference(run, named[run.name])}"
        for run in others
    ]


def _difference(run: Run, origin: _Origin) -> str:
    if run.command != origin.command:
        return f"made by `vmf {run.command}`, not by `vmf {origin.command}`"
    spec = as_it_is_now(run.record.get("spec"))
    mine, its = dict(_question(spec, origin.effort)), dict(origin.question)
    keys = [key for key in dict.fromkeys([*its, *mine]) if mine.get(key) != its.get(key)]
    said = {key: f"{key} is {_value(mine, key)}, not {_value(its, key)}" for key in keys}
    said |= _other_cases(spec, origin)
    shown = [said[key] for key in sorted(said)[:_MOST_KEYS]]
    more = len(said) - _MOST_KEYS
    return listed([*shown, *([f"{_number(more, 'more key')}"] if more > 0 else [])])


def _value(settings: Mapping[str, Any], key: str) -> str:
    return json.dumps(settings[key]) if key in settings else "absent"


def _superseded(names: Sequence[str]) -> list[str]:
    return [
        f"not counted: {_number(names.count(name), 'run')} of {name}, of whose points there are others"
        for name in dict.fromkeys(names)
    ]


def _number(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
