"""Every registered approximator from `vmf train` to `vmf evaluate`, by its name alone."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from vmf_command import CONFIGS, FEW, errors, record, summary, vmf

from vmf.approximate import APPROXIMATORS

QUICKSTART = CONFIGS / "quickstart.yaml"
# Enough frames for neighbours to be found around new codes.
SMALL = ("data.simulate.frames=60", "data.simulate.targets=6", "evaluate.checkpoints=null", *FEW)
SMALL += ("evaluate.trials=1", "evaluate.queries=12")


def trained(out: Path, *overrides: str) -> Path:
    """Train; coarse parameters may leave a motion or two without a solution, which is told, not hidden."""
    said = vmf("train", QUICKSTART, *SMALL, *overrides, "--out", out, "--jobs", 1, "--json", "--quiet")
    assert said.code == 0 or (said.code == 3 and "did not converge" in said.err), said
    return said.run


def held_out(run: Path) -> pd.DataFrame:
    """What the function answered on new targets."""
    rows = errors(run).query("protocol == 'held_out' and method == 'vmf'")
    return rows[["component", "truth", "estimate", "status"]].reset_index(drop=True)


def asked_again(run: Path) -> pd.DataFrame:
    """The same questions, put to the model file."""
    said = vmf("evaluate", run, "rivals=[]", "--json", "--quiet")
    assert said.code in (0, 3), said.err
    return held_out(said.run)


def answered(run: Path, protocol: str) -> int:
    """How many of the last frame's questions were not refused."""
    rows = summary(run).query(f"protocol == {protocol!r} and method == 'vmf' and component == 'distance'")
    return int(rows["n"].iloc[-1] + rows["n_diverged"].iloc[-1])


@pytest.mark.parametrize("kind", APPROXIMATORS)
def test_transport_with_every_approximator(tmp_path: Path, kind: str) -> None:
    more = ("learner.kind=transport", f"approximator.kind={kind}")
    run = trained(tmp_path, *more)
    assert record(run)["status"] == "done"
    assert answered(run, "trained_code") == 1
    # A table knows visited codes only.
    assert answered(run, "held_out") == (0 if kind == "none" else pytest.approx(12, abs=6))
    said = vmf("info", run / "model.npz")
    assert (said.code, said.err) == (0, "")
    assert f"approximator: {kind}" in said.out
    pd.testing.assert_frame_equal(asked_again(run), held_out(run))


@pytest.mark.long
@pytest.mark.parametrize("kind", [kind for kind in APPROXIMATORS if kind != "cmac"])
def test_the_pipeline_with_every_approximator(tmp_path: Path, kind: str) -> None:
    run = trained(tmp_path, "learner.kind=pipeline", f"approximator.kind={kind}")
    assert answered(run, "trained_code") == 1
    pd.testing.assert_frame_equal(asked_again(run), held_out(run))


@pytest.mark.long
@pytest.mark.parametrize("training", ["partial_gram_schmidt", "randomised"])
def test_trainings_of_the_cmac(tmp_path: Path, training: str) -> None:
    more = ("learner.kind=transport", f"approximator={{kind: cmac, training: {training}}}")
    run = trained(tmp_path, *more)
    assert answered(run, "trained_code") == 1
    assert f"training: {training}" in (run / "spec.yaml").read_text()
    pd.testing.assert_frame_equal(asked_again(run), held_out(run))


def test_a_pipeline_without_tiles_has_nothing_to_pool(tmp_path: Path) -> None:
    more = ("learner={kind: pipeline, readout: pooled}", "approximator.kind=rbf")
    vmf("train", QUICKSTART, *more, "--out", tmp_path).refused("readout: pooled", "cmac", "found rbf")


def test_settings_that_the_pipeline_does_not_use_are_named(tmp_path: Path) -> None:
    more = (*SMALL, "learner.kind=pipeline", "approximator={kind: cmac, epochs: 2}")
    said = vmf("train", QUICKSTART, *more, "--out", tmp_path, "--jobs", 1)
    assert said.code in (0, 3)
    assert "approximator.epochs has no effect with learner.kind: pipeline" in said.out + said.err
