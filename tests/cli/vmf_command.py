"""The command line called within the test's own process, and what it left behind."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pandas as pd

from vmf.cli import main

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
COLUMNS = ["trial", "frame", "protocol", "method", "component", "unit", "truth", "estimate"]
COLUMNS += ["abs_error", "status"]
SUMMARY = ["protocol", "method", "component", "unit", "case", "n", "n_refused", "n_diverged"]
SUMMARY += ["mean", "std", "median", "p95", "ci_low", "ci_high"]
# A miniature of any simulated experiment.
FEW = ("evaluate.queries=4", "evaluate.curve_points=3", "evaluate.bootstrap=20")
NO_SWEEP = "calibration_sweep=null"
MINI = ("data.simulate.frames=30", "evaluate.trials=2", "evaluate.checkpoints=null", NO_SWEEP, *FEW)
# One with a learner that is quick to train, where it does not matter which.
QUICK = (*MINI, "learner.kind=transport", "approximator.kind=polynomial")
# A film that is soon rendered and tracked.
SMALL_FILM = (
    "data.simulate.motion=hand_guided",
    "data.simulate.rate_hz=10",
    "data.simulate.frames=16",
    "data.simulate.targets=6",
    "data.simulate.rig={width_px: 320, height_px: 240, fx_px: 234.5, fy_px: 236, cx_px: 172, cy_px: 127.5}",
)


@dataclass(frozen=True)
class Said:
    """How a command ended, and what it said."""

    code: int
    out: str
    err: str

    def __repr__(self) -> str:
        return f"exit code {self.code}, said {self.out[:200]!r}, on stderr {self.err[:400]!r}"

    @property
    def run(self) -> Path:
        """The run directory that `--json` names."""
        return Path(json.loads(self.out)["run_dir"])

    def refused(self, *parts: str) -> str:
        """One clear line on stderr holding all `parts`, exit code 2, and nothing on stdout."""
        assert (self.code, self.out) == (2, ""), self
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        assert "Traceback" not in self.err
        for part in parts:
            assert part in lines[0], (part, lines[0])
        return lines[0]


def vmf(*arguments: object, plots: bool = False) -> Said:
    """Run `vmf` with these arguments; figures, the slowest part, are drawn only if asked for.

    An exception that the program lets through is a traceback to its user, and fails the test.
    """
    out, err = io.StringIO(), io.StringIO()
    code = 0
    with ExitStack() as stack:
        stack.enter_context(patch("sys.argv", ["vmf", *map(str, arguments)]))
        stack.enter_context(redirect_stdout(out))
        stack.enter_context(redirect_stderr(err))
        if not plots:
            stack.enter_context(without_plots())
        try:
            main()
        except SystemExit as end:
            code = 0 if end.code is None else int(end.code)
    return Said(code, out.getvalue(), err.getvalue())


@contextmanager
def without_plots() -> Iterator[None]:
    """Leave the figures out."""
    with (
        patch("vmf.report.write_plots", lambda *_, **__: ()),
        patch("vmf.report.plots.rendered", lambda *_, **__: {}),
    ):
        yield


def train(spec: Path, out: Path, *overrides: str, command: str = "train", code: int = 0) -> Path:
    """Train in this process and return the run directory."""
    said = vmf(command, spec, *overrides, "--out", out, "--jobs", 1, "--json", "--quiet")
    assert said.code == code, said.err
    return said.run


def errors(run: Path) -> pd.DataFrame:
    return pd.read_parquet(run / "errors.parquet")


def summary(run: Path) -> pd.DataFrame:
    return pd.read_csv(run / "summary.csv")


def record(run: Path) -> dict[str, Any]:
    return dict(json.loads((run / "run.json").read_text()))


def same_results(a: Path, b: Path) -> bool:
    """Whether tables of two runs are equal byte for byte."""
    return all((a / f).read_bytes() == (b / f).read_bytes() for f in ("errors.parquet", "summary.csv"))
