"""`vmf info`: what a recording, a run or a model holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vmf.data.recording import describe
from vmf.data.recording.container import is_rosbag2
from vmf.errors import InputError, Loss
from vmf.experiment import model_file
from vmf.experiment.run import read_record, read_summary
from vmf.experiment.study import QUANTITIES_FILE, read_quantities, worth_printing
from vmf.spec import Spec, StructuredLearner

_SHOWN = (
    "command",
    "status",
    "started",
    "finished",
    "version",
    "git_commit",
    "git_dirty",
    "wall_s",
    "cpu_s",
    "peak_memory_mib",
)


def inspect(path: Path) -> tuple[list[str], tuple[Loss, ...]]:
    """Return lines that describe a recording, a run directory or a model, and what of it is damaged.

    Raises
    ------
    InputError : there is nothing of these kinds.
    """
    if path.is_dir() and not is_rosbag2(path):
        return _run(path), ()
    if not path.exists():
        raise InputError(f"{path}: no such file or directory; a recording, a run or a model.npz is accepted")
    if path.suffix == ".npz":
        return _model(path), ()
    info = describe(path)
    return list(info.lines()), tuple(info.losses)


def _learner(spec: Spec) -> str:
    if isinstance(spec.learner, StructuredLearner):
        return spec.learner.kind
    return f"{spec.learner.kind}, estimator: {spec.learner.estimator}; approximator: {spec.approximator.kind}"


def _run(path: Path) -> list[str]:
    record = read_record(path)
    lines = [f"run {path}"]
    lines += [f"  {key}: {record[key]}" for key in _SHOWN if key in record]
    inputs = record.get("inputs")
    if isinstance(inputs, dict):
        lines += [f"  input: {name} (SHA-256 {digest})" for name, digest in inputs.items()]
    for key in ("losses", "notes"):
        values = record.get(key)
        if isinstance(values, list):
            lines += [f"  {key}: {value}" for value in values]
    summary = path / "summary.csv"
    if summary.exists():
        table = read_summary(path)
        mine = table[(table["method"] == "vmf") & table["component"].isin(["angle", "distance"])]
        lines.append("  errors of vmf (mean, median, n, refused, diverged):")
        for row in mine.itertuples():
            lines.append(
                f"    {row.protocol} {row.case} {row.component}: {row.mean:.4g} {row.unit}, "
                f"{row.median:.4g} {row.unit}, {row.n}, {row.n_refused}, {row.n_diverged}"
            )
    if (path / QUANTITIES_FILE).exists():
        quantities = read_quantities(path)
        shown = worth_printing(quantities)
        lines.append(f"  quantities: {len(quantities)}")
        for row in shown.itertuples():
            what = " ".join(str(word) for word in (row.quantity, row.case, row.component) if word)
            unit = "" if row.unit == "1" else f" {row.unit}"
            lines.append(f"    {what}: {row.value:.6g}{unit}")
    if (path / "model.npz").exists():
        lines += _model(path / "model.npz")
    return lines


def _model(path: Path) -> list[str]:
    model = model_file.load(path)
    spec, tracks = model.spec, model.learner.tracks
    lines = [
        f"model {path} (format {model_file.FORMAT})",
        f"  task: {spec.task}, {spec.mounting}; learner: {_learner(spec)}",
    ]
    if tracks is not None:
        both = tracks.pixels[np.isfinite(tracks.pixels).all(axis=1)]
        lines.append(
            f"  learned from {tracks.n_frames} frames, {tracks.n_targets} targets, "
            f"{len(both)} stereo observations"
        )
        if len(both):
            low, high = both.min(axis=0), both.max(axis=0)
            names = ("x_L", "y_L", "x_R", "y_R")
            ranges = (f"{n} {a:.0f}…{b:.0f}" for n, a, b in zip(names, low, high, strict=True))
            lines.append(f"  codes cover {', '.join(ranges)} px")
    noise = model.learner.noise
    if noise is not None:
        lines.append(f"  noise found: {noise.scale_px:.3g} px, {noise.freedom:g} degrees of freedom")
    lines += [f"  {loss}" for loss in model.learner.losses]
    return lines
