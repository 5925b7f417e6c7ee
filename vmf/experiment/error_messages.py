"""Errors of motions as messages whose numbers can be plotted."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd

Parts = dict[str, object]

SCHEMA = "vmf.MotionError"
_NUMBERS = ("truth", "estimate", "abs_error")


def error_topic(method: str) -> str:
    """Return the topic of a method's errors."""
    return f"/errors/{method}"


def errors_by_question(errors: pd.DataFrame) -> dict[tuple[str, int, int], list[tuple[str, Parts]]]:
    """Return the components of every method's answer to each question, by protocol, trial and number."""
    found: dict[tuple[str, int, int], dict[str, Parts]] = {}
    columns = [
        "protocol",
        "trial",
        "query",
        "method",
        "component",
        "status",
        "truth",
        "estimate",
        "abs_error",
    ]
    for protocol, trial, query, method, component, status, *values in zip(
        *(errors[column].tolist() for column in columns), strict=True
    ):
        parts = found.setdefault((protocol, trial, query), {}).setdefault(method, {"status": status})
        # What a refused question has no number for is left out: Foxglove's schemas know no null.
        parts[component] = {
            name: value for name, value in zip(_NUMBERS, values, strict=True) if np.isfinite(value)
        }
    return {key: list(methods.items()) for key, methods in found.items()}


def error_schema(errors: pd.DataFrame) -> str:
    """Return the JSON schema of the messages about the errors in a table, with its units."""
    units = dict(zip(errors["component"].tolist(), errors["unit"].tolist(), strict=True))

    def numbers(unit: str) -> dict[str, object]:
        return {
            "type": "object",
            "properties": {f: {"type": "number", "description": unit} for f in _NUMBERS},
        }

    integers = {name: {"type": "integer"} for name in ("trial", "query", "frame")}
    texts = {name: {"type": "string"} for name in ("protocol", "case", "method", "status")}
    stamp = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
    components = {name: numbers(unit) for name, unit in units.items()}
    return json.dumps(
        {
            "title": SCHEMA,
            "description": "A question's true motion, a method's answer, and the error of each component.",
            "type": "object",
            "properties": {"timestamp": stamp, **texts, **integers, **components},
            "required": ["timestamp", *texts, *integers],
        }
    )
