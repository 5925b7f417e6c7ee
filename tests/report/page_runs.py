"""Run directories written by hand, with numbers that are known beforehand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vmf.report.page import Run, Runs
from vmf.report.page.claims import Axis, Claim
from vmf.report.page.evidence import Evidence, evidence, measured

COLUMNS = ["trial", "frame", "protocol", "method", "component", "unit", "truth", "estimate"]
COLUMNS += ["abs_error", "status"]


def write_run(
    path: Path,
    spec: dict[str, Any],
    errors: pd.DataFrame | None = None,
    summary: pd.DataFrame | None = None,
    quantities: pd.DataFrame | None = None,
    **record: Any,
) -> Path:
    """Write a finished run's directory."""
    path.mkdir(parents=True)
    said = {"status": "done", "command": "train", "spec": spec, "overrides": [], "finished": "2026-01-01"}
    said |= {"version": "0", "git_commit": None, "git_dirty": None}
    (path / "run.json").write_text(json.dumps(said | record))
    if errors is not None:
        errors[COLUMNS].to_parquet(path / "errors.parquet")
    if summary is not None:
        summary.to_csv(path / "summary.csv", index=False)
    if quantities is not None:
        quantities.to_csv(path / "quantities.csv", index=False)
    return path


def answers(method: str, component: str, error: np.ndarray[Any, Any], refused: int = 0) -> pd.DataFrame:
    """Rows of a method's answers at the trained code; `error` (trials, frames), the first `refused` lost."""
    trials, frames = error.shape
    rows = pd.DataFrame(
        {
            "trial": np.repeat(np.arange(trials), frames),
            "frame": np.tile(np.arange(1, frames + 1), trials),
            "abs_error": error.ravel(),
        }
    )
    rows = rows.assign(protocol="trained_code", method=method, component=component, unit="rad")
    lost = np.arange(len(rows)) < refused
    rows["status"] = np.where(lost, "refused", "ok")
    rows.loc[lost, "abs_error"] = np.nan
    return rows.assign(truth=0.0, estimate=rows["abs_error"])


def quantities(*rows: tuple[str, str, str, float]) -> pd.DataFrame:
    """Rows of `quantities.csv`: quantity, case, component, value."""
    table = pd.DataFrame(rows, columns=["quantity", "case", "component", "value"])
    return table.assign(unit="1", n=np.nan, ci_low=np.nan, ci_high=np.nan)[
        ["quantity", "case", "component", "unit", "value", "n", "ci_low", "ci_high"]
    ]


def swept_evidence(
    claim: Claim, axes: Sequence[Axis], swept: Sequence[Run], runs: Runs, usual: Run | None = None
) -> Evidence | None:
    """What the points of a sweep say of a claim."""
    return evidence(claim, measured(claim, axes, swept, runs), runs, usual)
