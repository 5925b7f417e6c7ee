"""Tracking stereo images of 640×480, against reading and decoding them alone and against a camera's rate."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from vmf.bench.clock import in_turns, once
from vmf.bench.figure import Effort, Figure, quicker, share
from vmf.data.images import StereoImages
from vmf.experiment import write_simulation
from vmf.spec import ImageSource, load
from vmf.track.recorded import tracked_frames

_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: 4, motion: hand_guided, seed: 1, images: {{targets: {targets}}}}}
"""
# What each tracker is made for.
_TARGETS = {"klt": "texture", "meanshift": "blob", "aruco": "tag"}
_CAMERA_HZ = 30.0


def figure(effort: Effort) -> Figure:
    """Measure each tracker in stereo frames per second by the clock on the wall, on films made for it.

    Both images are worked on at the same time, and the next pair is decoded meanwhile: the processor's time
    would count what happens side by side as if it came one after the other.
    """
    frames = 6 if effort.quick else 60
    rows = []
    with tempfile.TemporaryDirectory() as directory:
        films = {targets: _film(Path(directory), targets, frames) for targets in set(_TARGETS.values())}
        for kind, targets in _TARGETS.items():
            source = ImageSource.model_validate({"tracker": {"kind": kind}})
            path = films[targets]
            candidates: dict[str, Callable[[], Any]] = {
                "tracked": lambda: _tracked(path, source),  # noqa: B023 - called before the next
                "decoded": lambda: _decoded(path, source),  # noqa: B023
            }
            times = in_turns(candidates, effort.repeats, perf_counter)
            tracked, decoded = (frames / times[key].seconds for key in candidates)
            busy_s, observations = once(candidates["tracked"])
            ours = f"{kind}, reading and decoding included"
            case = f"640×480, {targets}s, {frames} stereo frames"
            rows.append(quicker(case, (ours, tracked), ("a camera", np.array([_CAMERA_HZ])), "frames/s"))
            note = (
                f"{observations} observations, {1e3 * busy_s / frames:.3g} ms of the processor a frame; "
                "near 1 reading would be the bottleneck"
            )
            rows.append(
                share(case, (ours, tracked), ("reading and decoding alone", decoded), "frames/s", note)
            )
    return Figure("tracking", "stereo images to tracks", tuple(rows))


def _film(directory: Path, targets: str, frames: int) -> Path:
    spec, path = directory / f"{targets}.yaml", directory / f"{targets}.mcap"
    spec.write_text(_SPEC.format(frames=frames, targets=targets))
    write_simulation(load(spec), path, images=True)
    return path


def _tracked(path: Path, source: ImageSource) -> int:
    return sum(len(f.sightings.ids) for f in tracked_frames(StereoImages(path, source), source.tracker))


def _decoded(path: Path, source: ImageSource) -> int:
    images = StereoImages(path, source)
    return sum(pair is not None for pair in images.pairs(grey=source.tracker.kind != "meanshift"))
