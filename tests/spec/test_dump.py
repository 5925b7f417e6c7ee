"""What a dumped spec looks like, and what its hash depends on."""

from __future__ import annotations

import re

import pytest
import yaml

from vmf.spec import dump, loads, spec_hash
from vmf.spec.model import Spec

from .test_load import spec


def test_every_key_is_there_in_the_order_of_the_model() -> None:
    text = dump(spec(""))
    assert list(yaml.safe_load(text)) == list(Spec.model_fields)
    assert "name: null" in text
    assert "targets: null" in text


@pytest.mark.parametrize(
    "name",
    [
        "1e-3",
        "08",
        "+.5",
        "on",
        "null",
        "~",
        "",
        "<<",
        "=",
        "1:30",
        "a\nb\n",
        "\x85",
        "\u2028",
        "ä",
        "a: b #c",
    ],
)
def test_text_that_looks_like_something_else(name: str) -> None:
    named = spec("").model_copy(update={"name": name})
    assert loads(dump(named)).spec == named


def test_other_readers_of_yaml_see_the_same_numbers() -> None:
    text = dump(spec("noise: {pixel_px: 1e-7, point_m: 1e22}"))
    assert yaml.safe_load(text)["noise"]["pixel_px"] == 1e-7
    assert yaml.safe_load(text)["noise"]["point_m"] == 1e22


def test_a_list_that_occurs_twice_is_written_twice() -> None:
    assert "&" not in dump(spec("rivals: [{method: pnp}, {method: pnp}]"))


def test_the_hash_names_the_content() -> None:
    one = spec_hash(spec("noise: {pixel_px: 2}"))
    assert re.fullmatch("[0-9a-f]{10}", one)
    assert one == spec_hash(spec("name: x\nnoise: {pixel_px: 2.0, point_m: -0.0}"))
    assert one != spec_hash(spec("noise: {pixel_px: 2.5}"))
