"""What the thesis printed: its figures, their numbers, and where ours is found among the results of runs."""

from __future__ import annotations

import string
from functools import cache
from importlib import resources
from typing import Annotated, Literal

import yaml
from pydantic import Field, PositiveFloat, PositiveInt, ValidationInfo, field_validator, model_validator

from vmf.spec.base import Model

Statistic = Literal["mean", "std", "median", "p95", "gain"]
Reading = Literal["error", "value", "at_most", "at_least"]
# How the name of a sweep over what an experiment leaves open ends; its grid is in `configs/thesis/unknowns/`.
UNKNOWNS = "_unknowns"
# What the sweep over what the thesis leaves open finds of a number: it is reproduced at some point; so it is
# under the usual assumptions, too, with as few frames and trials as the sweep has; it is passed on the way
# from one point to another; neither; or there was no sweep of it.
Found = Literal["reaches", "effort", "brackets", "misses", "none"]
# What the sentence of a reason may say beside what it measures: our number; and of the sweep the assumptions
# under which it comes nearest, those between which the thesis's number lies, how many points there are, what
# the number is with the sweep's effort under the usual assumptions, and where most questions are answered.
PLACEHOLDERS = ("ours", "at", "between", "points", "baseline", "most_at", "most_elsewhere_at")


class Answers(Model):
    """Mean, spread, … of |error| over all trials, after a number of frames or over all from one on.

    Attributes
    ----------
    config : whose run; the figure's own where it is left out.
    method : `function` is the learned function, as the thesis has it and as we have it; or a rival's name.
    after : `half` is the last half of the frames of a run, `end` the last frame; or all beyond a frame.
    statistic : of |error|; or `gain`, the slope of the answers over the truth, below 1 if they are too small.
    """

    of: Literal["answers"] = "answers"
    config: str | None = None
    protocol: Literal["trained_code", "held_out"] = "trained_code"
    method: str = "function"
    component: str
    after: Literal["half", "end"] | PositiveInt = "half"
    statistic: Statistic = "mean"


class Stable(Model):
    """The first frame after which the mean |error| stays near its final value.

    `by` is the thesis's frame, which a claim tells it; shorter curves say nothing about it.
    """

    of: Literal["stable"] = "stable"
    config: str | None = None
    method: str = "function"
    component: str
    by: PositiveFloat | None = None


class StableCondition(Model):
    """The first frame after which the median condition number stays near its final value; `by` as there."""

    of: Literal["stable_condition"] = "stable_condition"
    config: str | None = None
    by: PositiveFloat | None = None


class Condition(Model):
    """The median condition number after a number of frames, or over the last half of them."""

    of: Literal["condition"] = "condition"
    config: str | None = None
    after: Literal["half", "thesis"] | PositiveInt = "half"


class Answered(Model):
    """The greatest or least share of questions answered, in percent, over the sweep over what is open.

    `elsewhere` is over points that differ from what the thesis says (`Axis.given`) instead.
    """

    of: Literal["answered"] = "answered"
    elsewhere: bool = False
    share: Literal["greatest", "least"] = "greatest"


class Said(Model):
    """The thesis's own number."""

    of: Literal["said"] = "said"


class Strays(Model):
    """Of a claim about when a curve is stable: how far it is from its final value from the thesis's frame on.

    Attributes
    ----------
    at : `there`, the mean of the window that begins at the thesis's frame over the final value; or `most`,
        the factor (up or down) by which a window from there on differs most from it.
    """

    of: Literal["strays"] = "strays"
    at: Literal["there", "most"]


class Points(Model):
    """How far reconstructed points are off on an axis (`points.csv` of a comparison with 3-D methods)."""

    of: Literal["points"] = "points"
    config: str | None = None
    component: Literal["x", "y", "z"]
    statistic: Literal["mean", "std"] = "mean"


class Quantity(Model):
    """A row of a study's `quantities.csv`; `default` is the case that is our own way to do it, if any."""

    of: Literal["quantity"] = "quantity"
    config: str | None = None
    quantity: str
    case: str = ""
    component: str = ""
    default: str | None = None


Direct = Annotated[Answers | Stable | StableCondition | Points | Quantity, Field(discriminator="of")]


class Ratio(Model):
    """One measured quantity over another."""

    of: Literal["ratio"] = "ratio"
    over: Direct
    under: Direct


Ours = Annotated[Answers | Stable | StableCondition | Points | Quantity | Ratio, Field(discriminator="of")]


class Same(Model):
    """What a claim itself asks for, with some of it changed; of a ratio, one of its two sides."""

    of: Literal["same"] = "same"
    side: Literal["over", "under"] | None = None
    config: str | None = None
    protocol: Literal["trained_code", "held_out"] | None = None
    method: str | None = None
    component: str | None = None
    after: Literal["half", "end"] | PositiveInt | None = None
    statistic: Statistic | None = None


Measured = Annotated[
    Answers
    | Stable
    | StableCondition
    | Condition
    | Answered
    | Said
    | Strays
    | Points
    | Quantity
    | Ratio
    | Same,
    Field(discriminator="of"),
]


class Check(Model):
    """A measured number that a reason cites, and what it has to be for the reason to hold.

    Attributes
    ----------
    what : it in words.
    unit : of it, empty for ratios and shares; `same` for the claim's own.
    value, over : what is measured, or over what.
    by : whose numbers: `thesis`, `default` or `bound`; whose the reason is if it is left out.
    above, below : what it has to be; both left out for a number that is cited only.
    """

    what: str
    unit: str = ""
    value: Measured
    over: Measured | None = None
    by: Literal["thesis", "default", "bound"] | None = None
    above: float | None = None
    below: float | None = None


class Because(Model):
    """Why some numbers do not reproduce, and what has to be so in the runs for that to be the reason.

    Attributes
    ----------
    says : a sentence or two; cites what `when` and `holds` measure as `{name}`, and `PLACEHOLDERS`.
    common : whether it may be one of every claim, and no claim names it.
    by : whose number it is about, `thesis` or `default`; either if it is left out.
    ours : on which side of the thesis's number ours is where it may be the reason.
    sweep : what the sweep over what is left open finds where it may be the reason.
    few : whether it may be one where most questions were unanswered; `only`, nowhere else.
    when : what else is so where it may be the reason; elsewhere nothing is said of it.
    holds : what has to be so for it to be the reason; where it is not, the page says that it is none.
    explains : whether it is a reason at all, or says only what is none.
    """

    says: str
    common: bool = False
    by: Literal["thesis", "default"] | None = None
    ours: Literal["over", "under"] | None = None
    sweep: tuple[Found, ...] | None = None
    few: Literal["no", "too", "only"] = "no"
    when: dict[str, Check] = Field(default_factory=dict)
    holds: dict[str, Check] = Field(default_factory=dict)
    explains: bool = True

    @model_validator(mode="after")
    def _says_what_is_measured(self) -> Because:
        checks = self.when | self.holds
        bounded = [check for check in checks.values() if (check.above, check.below) != (None, None)]
        if self.sweep is None and not bounded:
            raise ValueError(
                f"{self.says[:40]}…: runs cannot refute it, `sweep`, `when` or `holds` is needed"
            )
        known = (*PLACEHOLDERS, *checks)
        for _, name, _, _ in string.Formatter().parse(self.says):
            if name is not None and name not in known:
                raise ValueError(f"{self.says[:40]}…: {{{name}}} is not one of {', '.join(known)}")
        return self


class Means(Model):
    """What a statement without a number says of ours: that it lies above something, or below."""

    above: float | None = None
    below: float | None = None

    def agrees(self, number: float) -> bool:
        """Return whether a number is as it says."""
        return (self.above is None or number > self.above) and (self.below is None or number < self.below)


class Claim(Model):
    """One number of the thesis, or one statement that has none.

    Attributes
    ----------
    what : the quantity in words.
    unit : of both numbers, empty for counts and ratios.
    thesis : its number; None where it says something in words alone.
    says : its words.
    means : what they say of our number, where they stand alone and say that much.
    reading : an `error` may be smaller, a `value` is to be met, `at_most` and `at_least` are bounds.
    ours : where our number is found.
    because : names of the reasons why it may not reproduce.
    """

    what: str
    unit: str = ""
    thesis: PositiveFloat | None = None
    says: str = ""
    means: Means | None = None
    reading: Reading = "error"
    ours: Ours
    because: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[Direct, ...]:
        """What is measured: of a ratio both sides."""
        return (self.ours.over, self.ours.under) if isinstance(self.ours, Ratio) else (self.ours,)

    @property
    def elsewhere(self) -> tuple[str, ...]:
        """The other experiments that it is about, too."""
        return tuple(dict.fromkeys(part.config for part in self.parts if part.config is not None))

    @field_validator("ours", mode="after")
    @classmethod
    def _asked_of_a_frame(cls, ours: Ours, info: ValidationInfo) -> Ours:
        is_stable = isinstance(ours, Stable | StableCondition)
        return ours.model_copy(update={"by": info.data.get("thesis")}) if is_stable else ours

    @model_validator(mode="after")
    def _says_something(self) -> Claim:
        if self.thesis is None and not self.says:
            raise ValueError(f"{self.what}: neither a number nor words of the thesis")
        if self.thesis is not None and self.means is not None:
            raise ValueError(
                f"{self.what}: what is held against a number is its reading, not what words mean"
            )
        return self


class Axis(Model):
    """A setting that is varied in the sweep over what the thesis leaves open.

    Attributes
    ----------
    name, unit : of it.
    key : in a spec (`a.b.0`).
    given : what the thesis says it is, None if it leaves it open; other values say what answers depend on,
        and are no evidence.
    """

    name: str
    unit: str = ""
    key: str
    given: float | None = None


class Plot(Model):
    """A figure of a run by its name, and what it shows."""

    name: str
    shows: str


class ThesisFigure(Model):
    """One figure of the thesis, or several that one experiment made.

    Attributes
    ----------
    id : as the thesis numbers them.
    title, protocol : what it is, and how it was done, a sentence each.
    config : the file in `configs/thesis` that makes it.
    command : how that is run.
    plots : those to show, by name, all where it is empty.
    unknowns : what the thesis leaves open, over which a sweep says what the numbers would be.
    claims : what was printed.
    remark : what a reader should know beside the numbers.
    """

    id: str
    title: str
    protocol: str
    config: str
    command: Literal["train", "compare-3d", "study"] = "train"
    plots: tuple[str | Plot, ...] = ()
    unknowns: tuple[Axis, ...] = ()
    claims: tuple[Claim, ...]
    remark: str = ""

    @property
    def sweep(self) -> str:
        """Name of the runs of the sweep over what is left open."""
        return f"{self.config}{UNKNOWNS}"

    @property
    def anchor(self) -> str:
        """The figure's place in the page."""
        kept = "".join(c if c.isalnum() else "-" for c in self.id.replace("–", "-to-"))
        return "fig-" + "-".join(part for part in kept.split("-") if part)


class Thesis(Model):
    """Everything that the thesis printed and a run can be held against."""

    title: str
    author: str
    reasons: dict[str, Because] = Field(default_factory=dict)
    figures: tuple[ThesisFigure, ...]

    @model_validator(mode="after")
    def _every_reason_is_one(self) -> Thesis:
        given = {name for figure in self.figures for claim in figure.claims for name in claim.because}
        if strange := sorted(given ^ {name for name, why in self.reasons.items() if not why.common}):
            raise ValueError(f"because: {strange[0]}: not among the reasons, or a reason of no claim")
        return self

    @model_validator(mode="after")
    def _no_two_places_alike(self) -> Thesis:
        anchors = [figure.anchor for figure in self.figures]
        for anchor in anchors:
            if anchors.count(anchor) > 1:
                raise ValueError(f"two figures are called {anchor}")
        return self

    @property
    def configs(self) -> frozenset[str]:
        """Names of the runs that the page is about."""
        swept = {figure.sweep for figure in self.figures if figure.unknowns}
        return frozenset(figure.config for figure in self.figures) | swept


@cache
def thesis() -> Thesis:
    """Return what the thesis printed, from `thesis.yaml` beside this file."""
    text = resources.files(__package__).joinpath("thesis.yaml").read_text(encoding="utf-8")
    return Thesis.model_validate(yaml.safe_load(text))
