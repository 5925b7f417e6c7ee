"""What the thesis printed: its figures, their numbers, and where ours is found among the results of runs."""

from __future__ import annotations

import string
from functools import cache
from importlib import resources
from typing import Annotated, Literal

import yaml
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from vmf.spec.base import Model

Statistic = Literal["mean", "std", "median", "p95"]
Reading = Literal["error", "value", "at_most", "at_least"]
# How the name of a sweep over what an experiment leaves open ends; its grid is in `configs/thesis/unknowns/`.
UNKNOWNS = "_unknowns"
# What a sentence may say about the sweep over what the thesis leaves open.
CITING = ("low", "high", "points", "nearest", "at")
PLACEHOLDERS = ("ours", "default", *CITING)


class Answers(Model):
    """Mean, spread, … of |error| over all trials, after a number of frames or over all from one on.

    Attributes
    ----------
    config : whose run; the figure's own where it is left out.
    method : `function` is the learned function, as the thesis has it and as we have it; or a rival's name.
    after : `half` is the last half of the frames of a run, `end` the last frame; or all beyond a frame.
    """

    of: Literal["answers"] = "answers"
    config: str | None = None
    protocol: Literal["trained_code", "held_out"] = "trained_code"
    method: str = "function"
    component: str
    after: Literal["half", "end"] | PositiveInt = "half"
    statistic: Statistic = "mean"


class Stable(Model):
    """The first frame after which the mean |error| stays near its final value."""

    of: Literal["stable"] = "stable"
    config: str | None = None
    method: str = "function"
    component: str


class StableCondition(Model):
    """The first frame after which the median condition number stays near its final value."""

    of: Literal["stable_condition"] = "stable_condition"
    config: str | None = None


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


class Claim(Model):
    """One number of the thesis, or one statement that has none.

    Attributes
    ----------
    what : the quantity in words.
    unit : of both numbers, empty for counts and ratios.
    thesis : its number; None where it says something in words alone.
    says : its words.
    reading : an `error` may be smaller, a `value` is to be met, `at_most` and `at_least` are bounds.
    ours : where our number is found.
    because : why it does not reproduce, if it does not; may cite the sweep over what is left open.
    """

    what: str
    unit: str = ""
    thesis: PositiveFloat | None = None
    says: str = ""
    reading: Reading = "error"
    ours: Ours
    because: str = ""

    @model_validator(mode="after")
    def _says_something(self) -> Claim:
        if self.thesis is None and not self.says:
            raise ValueError(f"{self.what}: neither a number nor words of the thesis")
        for _, name, _, _ in string.Formatter().parse(self.because):
            if name is not None and name not in PLACEHOLDERS:
                raise ValueError(f"{self.what}: because: {{{name}}} is not one of {', '.join(PLACEHOLDERS)}")
        return self


class Axis(Model):
    """A setting that the thesis leaves open: its name, its unit and its key in a spec (`a.b.0`)."""

    name: str
    unit: str = ""
    key: str


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
    figures: tuple[ThesisFigure, ...]

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
