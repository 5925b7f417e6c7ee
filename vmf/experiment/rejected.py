"""Which targets were left out of answers as wrong correspondences."""

from __future__ import annotations

import pandas as pd

from vmf.experiment.errors_table import BETWEEN

COLUMNS = ("trial", "frame", "protocol", "case", "method", "target")


def rejected_targets(errors: pd.DataFrame) -> pd.DataFrame:
    """Return one row per target that a method left out of an answer, from the tidy table in memory."""
    asked = _answers(errors)
    some = asked[_went_without(asked)]
    if some.empty:
        return pd.DataFrame(columns=list(COLUMNS))
    rows = some.assign(target=some["rejected"].str.split(BETWEEN)).explode("target")
    return rows[list(COLUMNS)].reset_index(drop=True)


def rejected_notes(errors: pd.DataFrame) -> tuple[str, ...]:
    """Return how many targets the learned function left out, in words, protocol by protocol."""
    said = []
    asked = _answers(errors)
    for protocol, group in asked[asked["method"] == "vmf"].groupby("protocol", sort=False):
        some = group.loc[_went_without(group), "rejected"]
        if len(some):
            n = sum(len(names.split(BETWEEN)) for names in some)
            said.append(
                f"{protocol}: {n} targets in {len(some)} of {len(group)} questions contradict the others and "
                "were rejected (rejected.csv)"
            )
    return tuple(said)


def _answers(errors: pd.DataFrame) -> pd.DataFrame:
    """Return one row per answer of a method that can reject."""
    if "rejected" not in errors.columns:
        errors = errors.assign(rejected="")
    return errors[(errors["component"] == "angle") & errors["rejected"].notna()]


def _went_without(asked: pd.DataFrame) -> pd.Series[bool]:
    """Whether an answer was given without some of the targets; where there is none, nothing was left out."""
    return (asked["rejected"] != "") & (asked["status"] == "ok")
