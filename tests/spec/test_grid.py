"""Grids of settings: what commas separate, what a file lists, and who beats whom."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.errors import InputError
from vmf.spec import Variant, load_all, variants
from vmf.spec.yaml_source import Node, in_file, parse

SPEC = Path(__file__).resolve().parents[2] / "configs" / "quickstart.yaml"


def texts(found: list[Variant]) -> list[list[str]]:
    return [[override.text for override in variant.overrides] for variant in found]


def test_the_product_has_the_last_key_vary_fastest() -> None:
    found = variants(["a=1,2", "b=x", "c=u,v"])
    assert texts(found) == [
        ["a=1", "b=x", "c=u"],
        ["a=1", "b=x", "c=v"],
        ["a=2", "b=x", "c=u"],
        ["a=2", "b=x", "c=v"],
    ]
    assert [dict(variant.settings) for variant in found][1] == {"a": "1", "c": "v"}


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a=[1,2],[3]", ["[1,2]", "[3]"]),
        ("a=[1,2]", ["[1,2]"]),
        ("a='x,y',z", ["'x,y'", "z"]),
        ("a={p: 1, q: [2,3]}, null", ["{p: 1, q: [2,3]}", "null"]),
        ('a="x\\",y",z', ['"x\\",y"', "z"]),
        ("a=", [""]),
        ("a=b=c,d", ["b=c", "d"]),
    ],
)
def test_commas_inside_of_a_value_belong_to_it(text: str, values: list[str]) -> None:
    assert texts(variants([text])) == [[f"a={value}"] for value in values]


@pytest.mark.parametrize("text", ["a=1,,2", "a=1,", "a=,1", "a=[1,2", "a=1],2"])
def test_a_comma_without_a_value_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^command line: a=.*values separated by commas are accepted"):
        variants([text])


def test_of_two_settings_of_a_key_the_last_counts() -> None:
    assert texts(variants(["a=1,2", " a =3"])) == [[" a =3"]]


@given(st.lists(st.lists(st.integers(-99, 99), min_size=1, max_size=3), min_size=1, max_size=4))
def test_a_file_and_the_command_line_say_the_same(
    tmp_path_factory: pytest.TempPathFactory, lists: list[list[int]]
) -> None:
    line = [f"k{i}=" + ",".join(map(str, values)) for i, values in enumerate(lists)]
    grid = tmp_path_factory.getbasetemp() / "grid.yaml"
    grid.write_text("sweep:\n" + "".join(f"  k{i}: {values}\n" for i, values in enumerate(lists)))
    assert texts(variants(line)) == texts(variants([], grid))
    assert len(variants(line)) == len(list(itertools.product(*lists)))


def test_a_file_may_list_points_one_by_one(tmp_path: Path) -> None:
    grid = tmp_path / "grid.yaml"
    listed = "- {noise.pixel_px: 0, learner.kind: structured}\n- {learner.kind: transport, name: 'a b'}\n"
    for text in (listed, "sweep:\n" + listed):
        grid.write_text(text)
        found = variants([], grid)
        assert texts(found) == [
            ["noise.pixel_px=0", "learner.kind=structured"],
            ["learner.kind=transport", 'name="a b"'],
        ]
        assert dict(found[1].settings) == {"learner.kind": "transport", "name": '"a b"'}
        beaten = variants(["noise.pixel_px=1,2"], grid)
        assert [t[0] for t in texts(beaten)[:2]] == ["noise.pixel_px=1", "noise.pixel_px=2"]
        assert len(beaten) == 4


@pytest.mark.parametrize(
    "value",
    [
        "1e-3",
        "null",
        "true",
        "[50, 200]",
        "{kind: transport, estimator: tls}",
        '"1"',
        "'on'",
        "'a, b'",
        "'ä\\'",
    ],
)
def test_values_of_a_file_stay_what_they_are(tmp_path: Path, value: str) -> None:
    grid = tmp_path / "grid.yaml"
    grid.write_text(f"sweep: {{k: [{value}]}}\n", encoding="utf-8")
    text = texts(variants([], grid))[0][0].removeprefix("k=")
    a, b = parse(text, in_file("a"), []), parse(value, in_file("b"), [])
    assert plain(a) == plain(b)


def plain(node: Node | None) -> object:
    value = None if node is None else node.value
    if isinstance(value, dict):
        return {key: plain(child) for key, child in value.items()}
    return [plain(child) for child in value] if isinstance(value, list) else value


def test_a_wrong_value_is_told_where_it_is_written_and_once(tmp_path: Path) -> None:
    grid = tmp_path / "grid.yaml"
    grid.write_text("sweep:\n  noise.pixel_px: [0, -1]\n  data.simulate.seed: [1, 2]\n")
    with pytest.raises(InputError) as caught:
        load_all(SPEC, [v.overrides for v in variants(["solver.coost=ml"], grid)])
    assert [line.split(": found")[0] for line in caught.value.lines] == [
        f"{grid}:2:23: noise.pixel_px",
        "command line: solver.coost=ml: unknown key, did you mean cost? (accepted: cost, cameras, start, "
        "known, max_iterations)",
    ]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "grid.yaml: `sweep:` with lists"),
        ("task: six_dof\n", "grid.yaml:1:1: `sweep:` with lists"),
        ("sweep: {}\n", "grid.yaml:1:8: `sweep:` with lists"),
        ("sweep: {a: 1}\n", "grid.yaml:1:12: a: a list of values"),
        ("sweep: {a: []}\n", "grid.yaml:1:12: a: a list of values"),
        ("- 1\n", "grid.yaml:1:3: `sweep:` with lists"),
        ("sweep: [\n", "not valid YAML"),
        ("sweep: {a: [&x 1]}\n", "anchor"),
    ],
)
def test_a_file_of_another_form_is_refused(tmp_path: Path, content: str, said: str) -> None:
    grid = tmp_path / "grid.yaml"
    grid.write_text(content)
    with pytest.raises(InputError) as caught:
        variants([], grid)
    assert said in caught.value.lines[0]
    with pytest.raises(InputError, match="no such file, a grid in YAML is accepted"):
        variants([], tmp_path / "none.yaml")
