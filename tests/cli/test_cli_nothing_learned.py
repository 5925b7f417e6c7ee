"""What is said of a function that has learned nothing, and of motions that the task has not."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from vmf_command import CONFIGS, record, vmf

SHARED = Path(__file__).resolve().parents[3] / "shared"


def test_nothing_learned_is_a_loss_with_its_reason(tmp_path: Path) -> None:
    spec = tmp_path / "noise.yaml"
    document = {
        "task": "six_dof",
        "data": {"simulate": {"frames": 40, "targets": 4, "seed": 1}},
        "noise": {"pixel_px": 200.0},
        "evaluate": {"queries": 5, "curve_points": 2, "bootstrap": 20},
    }
    spec.write_text(yaml.safe_dump(document))
    said = vmf("train", spec, "--out", tmp_path / "runs", "--quiet")
    assert said.code == 3
    assert "lost: vmf: nothing was learned: " in said.err
    (loss,) = record(tmp_path / "runs" / "noise" / "latest")["losses"]
    assert loss.startswith("vmf: nothing was learned: ")


def test_motions_that_the_task_has_not_are_said(tmp_path: Path) -> None:
    if not (SHARED / "data" / "starry_night.mcap").exists():
        pytest.skip("the recording starry_night.mcap is not beside the project")
    few = ("task=translation", "evaluate.gaps=[20]", "evaluate.bootstrap=20", "evaluate.curve_points=2")
    said = vmf("train", CONFIGS / "real" / "starry_night.yaml", *few, "--out", tmp_path)
    assert "gap=20: the robot's motions are not those of task translation" in said.err
    assert "rad are left out" in said.err
