"""Messages for constructs that the spec does not use yet but may tomorrow."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator
from pydantic_core import PydanticCustomError

from vmf.spec.check import checked
from vmf.spec.yaml_source import Problem, in_file, parse


class Base(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Circle(Base):
    kind: Literal["circle"] = "circle"
    radius_m: float = 1.0


class Square(Base):
    kind: Literal["square"] = "square"
    side_m: float = 1.0


def custom(value: Any) -> Any:
    if value == "bad":
        raise PydanticCustomError("our_own", "no good, {choice} is accepted", {"choice": "good"})
    return value


Form = Annotated[Circle | Square, Field(discriminator="kind")]


class Toy(Base):
    flag: bool = True
    code: Annotated[str, Field(pattern="^[a-z]+$")] = "a"
    short: Annotated[str, Field(min_length=1, max_length=3)] = "a"
    own: Annotated[str, BeforeValidator(custom)] = "good"
    even: Annotated[int, Field(multiple_of=2, ge=2, le=8)] = 2
    odd: int = 1
    some: Annotated[list[int], Field(min_length=1, max_length=2)] = [1]
    pair: tuple[int, str] = (1, "a")
    table: dict[str, int] = {}
    count: int | Literal["all"] = 1
    weights: float | tuple[float, ...] = 1.0
    form: Form | None = None
    forms: tuple[Form, ...] = ()
    either: Literal["off"] | Form = "off"
    child: Toy | None = None
    anything: Any = None

    @field_validator("odd")
    @classmethod
    def _odd(cls, value: int) -> int:
        if value % 2 == 0:
            raise AssertionError("an odd number is accepted")
        return value


def check(text: str) -> Toy | list[str]:
    problems: list[Problem] = []
    root = parse(text, in_file("t"), problems)
    assert root is not None
    toy = checked(Toy, root, problems)
    return toy if toy is not None else [str(problem).split(": ", 1)[1] for problem in problems]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("flag: on", "flag: found 'on', true or false is accepted"),
        ("code: A1", "code: found 'A1', text that matches ^[a-z]+$ is accepted"),
        ("short: ''", "short: found '', text of at least 1 and at most 3 characters is accepted"),
        ("own: bad", "own: no good, good is accepted"),
        (
            "even: 3",
            "even: found 3, a whole number of at least 2 and of at most 8 "
            "and that is a multiple of 2 is accepted",
        ),
        ("odd: 2", "odd: an odd number is accepted"),
        ("some: []", "some: found [], accepted: a list of at least 1 and at most 2, each a whole number"),
        ("some: 3", "some: found 3, accepted: a list of at least 1 and at most 2, each a whole number"),
        ("pair: [1]", "pair: found [1], a list of 2 is accepted"),
        ("table: {a: b}", "table.a: found 'b', a whole number is accepted"),
        ("table: 3", "table: found 3, a mapping is accepted"),
        ("count: al", "count: found 'al', accepted: a whole number or all; did you mean all?"),
        ("weights: [1, a]", "weights.1: found 'a', a number is accepted"),
        ("weights: a", "weights: found 'a', accepted: a number or a list, each a number"),
        ("form: {radius_m: 1}", "form.kind: missing, accepted: circle, square"),
        ("forms: [{kind: circle}, {kind: sqare}]",
         "forms.1.kind: found 'sqare', accepted: circle, square; did you mean square?"),
        ("forms: [{kind: circle, side_m: 1}]",
         "forms.0.side_m: unknown key for kind: circle, side_m belongs to kind: square "
         "(accepted: kind, radius_m)"),
        ("either: {kind: circle, radius_m: a}", "either.radius_m: found 'a', a number is accepted"),
        ("either: on", "either: found 'on', accepted: off or a mapping with kind: circle / square"),
        ("child: {child: {odd: a}}", "child.child.odd: found 'a', a whole number is accepted"),
        ("qqqq: 1", f"qqqq: unknown key (accepted: {', '.join(Toy.model_fields)})"),
    ],
)  # fmt: skip
def test_a_message_in_plain_words(text: str, line: str) -> None:
    assert check(text) == [line]


@pytest.mark.parametrize(
    "text",
    [
        "count: all",
        "weights: [1, 2]",
        "either: {kind: square}",
        "table: {a: 2.0}",
        "some: [1]",
        "anything: [1]",
    ],
)
def test_what_is_accepted(text: str) -> None:
    assert isinstance(check(text), Toy)
