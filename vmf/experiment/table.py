"""`vmf table`: runs side by side, with only what differs in their specs as columns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from vmf.errors import InputError
from vmf.experiment.run import read_record, read_summary


def side_by_side(runs: list[Path]) -> pd.DataFrame:
    """Return one row per run, protocol, case and method: settings that differ, then medians and counts.

    Raises
    ------
    InputError : a path is no finished run.
    """
    records = [read_record(run) for run in runs]
    settings = [_flat(record.get("spec", {})) for record in records]
    keys = list(dict.fromkeys(key for setting in settings for key in setting))
    differing = [k for k in keys if k != "name" and len({repr(setting.get(k)) for setting in settings}) > 1]
    versions = {(record.get("version"), record.get("git_commit")) for record in records}
    rows = []
    for run, record, setting in zip(runs, records, settings, strict=True):
        summary = run / "summary.csv"
        if record.get("status") != "done" or not summary.exists():
            raise InputError(f"{run}: status {record.get('status')}, a finished run is expected")
        head: dict[str, Any] = {key: setting.get(key) for key in differing}
        if len(versions) > 1:
            head["program"] = f"{record.get('version')} {str(record.get('git_commit'))[:8]}"
        table = read_summary(run)
        rows += _rows(head, table[~table["method"].isin(record.get("swept", []))])
    return pd.DataFrame(rows)


def _rows(head: dict[str, Any], summary: pd.DataFrame) -> list[dict[str, Any]]:
    rows = []
    keys = ["protocol", "case", "method"]
    for (protocol, case, method), group in summary.groupby(keys, sort=False):
        row = {**head, "protocol": protocol, "case": case, "method": method}
        for name, unit in (("angle", "rad"), ("distance", "m")):
            entry = group[group["component"] == name].iloc[0]
            row[f"{name} mean ({unit})"] = float(entry["mean"])
            row[f"{name} median ({unit})"] = float(entry["median"])
        first = group.iloc[0]
        rows.append({**row, **{key: int(first[key]) for key in ("n", "n_refused", "n_diverged")}})
    return rows


def _flat(value: Any, prefix: str = "") -> dict[str, Any]:
    if isinstance(value, dict):
        flat: dict[str, Any] = {}
        for key, inner in value.items():
            flat.update(_flat(inner, f"{prefix}.{key}" if prefix else str(key)))
        return flat
    return {prefix: value}


def to_markdown(table: pd.DataFrame) -> str:
    """Return a Markdown table with four significant digits."""
    cells = [[_cell(v) for v in row] for row in table.itertuples(index=False)]
    lines = ["| " + " | ".join(table.columns) + " |", "|" + " --- |" * len(table.columns)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in cells])


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "–" if value != value else f"{value:.4g}"
    return str(value)
