"""Which targets were left out of answers as wrong correspondences."""

from __future__ import annotations

import pandas as pd

COLUMNS = ("trial", "frame", "protocol", "case", "method", "target")


def rejected_targets(errors: pd.DataFrame) -> pd.DataFrame:
    """Return one row per target that a method left out of an answer, from the tidy table in memory."""
    asked = _answers(errors)
    some = asked[asked["rejected"] != ""]
    if some.empty:
        return pd.DataFrame(columns=list(COLUMNS))
    rows = some.assign(target=some["rejected"].str.split(" ")).explode("target")
    return rows[list(COLUMNS)].reset_index(drop=True)


def rejected_notes(errors: pd.DataFrame) -> tuple[str, ...]:
    """Return how many targets the learned function left out, in words, protocol by protocol."""
    said = []
    asked = _answers(errors)
    for protocol, group in asked[asked["method"] == "vmf"].groupby("protocol", sort=False):
        some = group.loc[group["rejected"] != "", "rejected"]
        if len(some):
            n = sum(len(names.split(" ")) for names in some)
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
