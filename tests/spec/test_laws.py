"""What holds for every key of every model and for every file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vmf.errors import InputError
from vmf.spec import Spec, dump, is_study, load, load_study, loads, loads_study, spec_hash
from vmf.spec.shape import shape_of

from .walk import Section, instances, required, sections

SECTIONS = list(sections())
FIELDS = [(section, name) for section in SECTIONS for name in section.model.model_fields]
FILES = sorted((Path(__file__).parents[2] / "configs").glob("**/*.yaml"))
# Grids are no specs.
CONFIGS = [path for path in FILES if path.parent.name != "unknowns"]
JARGON = re.compile(r"Input should|Value error|value_error|pydantic|https?:|NoneType|tuple|dict\b|Traceback")


def identity(section: Section, name: str = "") -> str:
    return f"{section.path}.{section.model.__name__}.{name}"


def misspellings(name: str) -> list[str]:
    swapped = name[:-2] + name[-1] + name[-2]
    return [wrong for wrong in (name + name[-1], swapped, name.swapcase()) if wrong != name]


def lines_of(text: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        loads(text, "f.yaml")
    return caught.value.lines


def written(document: Any) -> str:
    return str(yaml.safe_dump(document, sort_keys=False, default_flow_style=False))


@pytest.mark.parametrize(("section", "name"), FIELDS, ids=[identity(*field) for field in FIELDS])
def test_a_misspelt_key_is_one_line_with_its_place_and_the_right_name(section: Section, name: str) -> None:
    content = dict(required(section.model))
    value = content.pop(name, 1)
    for wrong in misspellings(name):
        text = written(section.document({**content, wrong: value}))
        (line, column) = next(
            (number, match.end("before") + 1)
            for number, line in enumerate(text.splitlines(), start=1)
            if (match := re.match(rf"(?P<before>[ -]*){re.escape(wrong)}:", line))
        )
        path = ".".join(filter(None, [section.path, wrong]))
        (message,) = lines_of(text)
        assert message.startswith(f"f.yaml:{line}:{column}: {path}: unknown key, did you mean {name}? (acc")


@pytest.mark.parametrize("section", SECTIONS, ids=identity)
def test_every_section_says_what_it_accepts(section: Section) -> None:
    (message,) = lines_of(written(section.document({**required(section.model), "qqqqqq": 1})))
    assert message.endswith(f"(accepted: {', '.join(section.model.model_fields)})")


def test_every_section_with_kinds_has_a_default_kind_in_its_schema() -> None:
    shape = shape_of(Spec)
    tagged = [shape.child(name) for name in shape.properties if shape.child(name).tag is not None]
    assert len(tagged) >= 2
    assert all(section.schema["default"][section.tag] in section.kinds for section in tagged)


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(instances(Spec))
def test_what_is_dumped_loads_as_the_same_spec(spec: Spec) -> None:
    text = dump(spec)
    again = loads(text).spec
    assert again == spec
    assert spec_hash(again) == spec_hash(spec.model_copy(update={"name": "another"}))


@settings(max_examples=60, deadline=None)
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_float_survives_exactly(number: float) -> None:
    spec = Spec.model_validate({"task": "planar", "data": {"simulate": {"rig": {"cx_px": number}}}})
    assert loads(dump(spec)).spec.data == spec.data


@settings(max_examples=150, deadline=None)
@given(st.one_of(st.text(), st.text(alphabet="ab:{}[],-#&*!|>'\"%@` \n\t?<=~.1e")))
def test_any_text_is_a_spec_or_an_input_error(text: str) -> None:
    assert all(line.startswith("f.yaml") and "\n" not in line for line in lines_of(text))


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.just("cmac"),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=5,
)


@settings(max_examples=80, deadline=None)
@given(st.sampled_from(FIELDS), junk)
def test_any_value_anywhere_is_accepted_or_refused_in_plain_words(
    field: tuple[Section, str], value: Any
) -> None:
    section, name = field
    text = written(section.document({**required(section.model), name: value}))
    try:
        loads(text, "f.yaml")
    except InputError as error:
        for line in error.lines:
            assert re.match(r"f\.yaml:\d+:\d+: ", line)
            assert not JARGON.search(re.sub(r"'.*'", "", line))


@settings(max_examples=60, deadline=None)
@given(st.text())
def test_any_override_is_accepted_or_refused(text: str) -> None:
    overrides = [f"noise.pixel_px={text}", text, "unknown=1"]
    with pytest.raises(InputError) as caught:
        loads("task: planar\ndata: {simulate: {}}", overrides=overrides)
    assert all(line.startswith("command line: ") and "\n" not in line for line in caught.value.lines)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_the_configs_load(path: Path) -> None:
    if is_study(path):
        study = load_study(path)
        assert loads_study(dump(study.spec)).spec == study.spec
        return
    loaded = load(path)
    assert loads(dump(loaded.spec)).spec == loaded.spec
