"""Without noise, every task and estimator finds the motions of visited codes exactly."""

from __future__ import annotations

from pathlib import Path

import pytest
from vmf_command import errors, train

TASKS = ("pan_tilt", "translation", "planar", "six_dof")


@pytest.mark.parametrize("estimator", ["qr", "tls", "ml"])
@pytest.mark.parametrize("task", TASKS)
def test_noise_free_motions_are_exact(tmp_path: Path, task: str, estimator: str) -> None:
    spec = tmp_path / "exact.yaml"
    spec.write_text(
        f"task: {task}\n"
        "data: {simulate: {frames: 80}}\n"
        "noise: {pixel_px: 0}\n"
        f"learner: {{kind: transport, estimator: {estimator}}}\n"
        "approximator: {kind: none}\n"
        "evaluate: {protocol: [trained_code], trials: 2, checkpoints: [60, 80],"
        " curve_points: 0, bootstrap: 10}\n"
    )
    mine = errors(train(spec, tmp_path)).query("method == 'vmf' and frame >= 60")
    assert set(mine["frame"]) == {60, 80}
    assert (mine["status"] == "ok").all()
    assert mine["abs_error"].max() < 1e-6
