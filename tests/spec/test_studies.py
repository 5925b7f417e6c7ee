"""Studies are read as strictly as experiments, and neither is taken for the other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings

from vmf.errors import InputError
from vmf.spec import StudySpec, dump, is_study, load, load_study, loads_study, spec_hash
from vmf.spec.images import RenderedImages
from vmf.spec.studies import PlanarSiftStudy
from vmf.study.planar_sift import functions

from .walk import Section, instances, required, sections

SECTIONS = list(sections(StudySpec))
FIELDS = [(section, name) for section in SECTIONS for name in section.model.model_fields]


def identity(section: Section, name: str = "") -> str:
    return f"{section.path}.{section.model.__name__}.{name}"


def refused(text: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        loads_study(text, "f.yaml")
    return caught.value.lines


@pytest.mark.parametrize(("section", "name"), FIELDS, ids=[identity(*field) for field in FIELDS])
def test_a_misspelt_key_is_one_line_with_its_place_and_the_right_name(section: Section, name: str) -> None:
    content = dict(required(section.model))
    value = content.pop(name, 1)
    wrong = name + name[-1]
    text = yaml.safe_dump(section.document({**content, wrong: value}), sort_keys=False)
    (message,) = refused(text)
    assert re.match(r"f\.yaml:\d+:\d+: ", message)
    assert f"{wrong}: unknown key, did you mean {name}?" in message


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(instances(StudySpec))
def test_what_is_dumped_loads_as_the_same_study(spec: StudySpec) -> None:
    again = loads_study(dump(spec)).spec
    assert again == spec
    assert spec_hash(again) == spec_hash(spec.model_copy(update={"name": "another"}))


@settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck))
@given(instances(PlanarSiftStudy))
def test_what_a_study_accepts_the_experiments_it_is_made_of_accept_too(study: PlanarSiftStudy) -> None:
    images = RenderedImages(size_m=study.poster_m, blur_px=study.blur_px, noise=study.image_noise)
    for spec in functions(study).values():
        assert spec.data.simulate is not None
        assert spec.data.simulate.images == images


@pytest.mark.parametrize(
    ("key", "most"), [("image_noise", 255), ("blur_px", 100), ("poster_m", 1000), ("features", 10_000)]
)
def test_how_a_study_may_draw_images_is_bounded_like_an_experiment(key: str, most: int) -> None:
    assert getattr(loads_study(f"study: {{kind: planar_sift, {key}: {most}}}").spec.study, key) == most
    (message,) = refused(f"study: {{kind: planar_sift, {key}: {most + 1}}}\n")
    assert re.search(rf"study\.{key}: found {most + 1}, .* at most {most} .*is accepted", message), message


def test_a_kind_that_does_not_exist_is_told_with_the_nearest() -> None:
    (message,) = refused("study: {kind: stereo_code}\n")
    assert message.startswith("f.yaml:1:15: study.kind: found 'stereo_code', accepted: ")
    assert message.endswith("did you mean stereo_codes?")


def test_neither_is_taken_for_the_other(tmp_path: Path) -> None:
    study, experiment = tmp_path / "s.yaml", tmp_path / "e.yaml"
    study.write_text("name: x\nstudy: {kind: stereo_codes}\n")
    experiment.write_text("task: planar\ndata: {simulate: {}}\n")
    assert is_study(study)
    assert not is_study(experiment)
    assert not is_study(tmp_path / "nowhere.yaml")
    with pytest.raises(InputError, match=r"s\.yaml:2:1: found a study.*`vmf study .*s\.yaml` runs it"):
        load(study)
    with pytest.raises(InputError, match=r"e\.yaml: found an experiment.*`vmf train .*e\.yaml` runs it"):
        load_study(experiment)
