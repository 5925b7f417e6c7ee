"""Wrong correspondences that answers went without are shown."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import yaml
from vmf_command import vmf


def test_wrong_correspondences_are_shown_by_train_and_evaluate(tmp_path: Path) -> None:
    spec = tmp_path / "wrong.yaml"
    spec.write_text(
        yaml.safe_dump(
            {
                "task": "translation",
                "data": {"simulate": {"frames": 80, "targets": 8, "seed": 2}},
                "noise": {"pixel_px": 0.5, "outlier_ratio": 0.15},
                "evaluate": {"protocol": ["held_out"], "queries": 30, "trials": 1},
            }
        )
    )
    said = vmf("train", spec, "--out", tmp_path / "runs")
    assert "contradict the others and were rejected (rejected.csv)" in said.err
    run = tmp_path / "runs" / "wrong" / "latest"
    rejected = pd.read_csv(run / "rejected.csv")
    assert set(rejected["method"]) == {"vmf"}
    assert rejected["target"].isin(range(8)).all()
    # About 15 % of 8 targets in 30 questions are wrong; a few wrong ones are not far off.
    assert 10 < len(rejected) < 80
    said = vmf("evaluate", run, "--out", tmp_path / "again")
    assert "rejected.csv" in said.err
