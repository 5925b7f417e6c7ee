"""Trained models for `vmf solve`, and views with a known motion between them to ask them about."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from vmf_command import Said, train, vmf

from vmf.data import BodyPoses, PanTiltJoints
from vmf.data.simulate import Simulation, simulate, trial_streams
from vmf.geometry import from_quaternion
from vmf.spec import load


@dataclass(frozen=True)
class Scene:
    """A run trained on a simulation, and the simulation itself.

    Questions go from frame `START` of the training to frame `GOAL`: their codes are inside by construction.
    """

    run: Path
    spec_file: Path

    START = 3
    GOAL = 17

    @cached_property
    def simulation(self) -> Simulation:
        spec = load(self.spec_file).spec
        return simulate(spec, trial_streams(spec, 0)[0])

    @property
    def dense(self) -> np.ndarray:
        """Pixels (N, K, 4) as they were seen."""
        tracks = self.simulation.tracks
        pixels = np.full((tracks.n_frames, tracks.n_targets, 4), np.nan)
        pixels[tracks.frame, tracks.target] = tracks.pixels
        return pixels

    @property
    def truth(self) -> np.ndarray:
        """E' from the start to the goal."""
        E = self.simulation.E_true
        return np.asarray(E[self.GOAL] @ np.linalg.inv(E[self.START]))

    def pose(self, frame: int) -> np.ndarray:
        """The reported pose of a frame, 4×4."""
        poses = self.simulation.poses
        assert isinstance(poses, BodyPoses)
        return from_quaternion(poses.position_m[frame], poses.quaternion_xyzw[frame])

    def pose_argument(self, frame: int = START) -> str:
        poses = self.simulation.poses
        assert isinstance(poses, BodyPoses)
        return commas([*poses.position_m[frame], *poses.quaternion_xyzw[frame]])

    def joints_argument(self, frame: int = START) -> str:
        poses = self.simulation.poses
        assert isinstance(poses, PanTiltJoints)
        return commas([poses.pan_rad[frame], poses.tilt_rad[frame]])

    @property
    def here(self) -> tuple[str, str]:
        """The option that says where the robot is."""
        if isinstance(self.simulation.poses, PanTiltJoints):
            return "--joints", self.joints_argument()
        return "--pose", self.pose_argument()

    @property
    def targets(self) -> list[str]:
        """The question as arguments."""
        return as_targets(*self.dense[[self.START, self.GOAL]])

    @property
    def views(self) -> dict[str, Any]:
        """The question as a file with two `vmf.StereoTracks` messages."""
        return {
            "initial": stereo_tracks(self.dense[self.START]),
            "desired": stereo_tracks(self.dense[self.GOAL]),
        }

    def solve(self, *arguments: object) -> dict[str, Any]:
        """Ask, and read the answer."""
        said = vmf("solve", self.run, *arguments, "--format", "json")
        assert said.code == 0, said
        return dict(json.loads(said.out))


def commas(values: Any) -> str:
    return ",".join(repr(float(v)) for v in values)


def as_targets(initial: np.ndarray, desired: np.ndarray) -> list[str]:
    """Two views (n, 4) as arguments; NaN is not seen."""
    said = []
    for codes in zip(initial, desired, strict=True):
        said += ["--target", ":".join(commas(code).replace("nan", "-") for code in codes)]
    return said


def stereo_tracks(pixels: np.ndarray, ids: tuple[str, ...] | None = None) -> dict[str, Any]:
    """One view as a message; NaN is null."""
    names = ids or tuple(str(i + 1) for i in range(len(pixels)))
    tracks = []
    for name, code in zip(names, pixels, strict=True):
        left, right = ([float(v) for v in half] for half in (code[:2], code[2:]))
        tracks.append(
            {
                "id": name,
                "left": None if np.isnan(left).any() else left,
                "right": None if np.isnan(right).any() else right,
            }
        )
    return {"timestamp": {"sec": 0, "nsec": 0}, "tracks": tracks}


def trained(
    folder: Path,
    task: str,
    mounting: str = "eye_in_hand",
    noise_px: float = 0.0,
    code: int = 0,
    **more: object,
) -> Scene:
    """Train on 60 frames of 4 targets, which ends with `code`; `more` are sections of the spec."""
    spec = {
        "task": task,
        "mounting": mounting,
        "data": {"simulate": {"frames": 60, "targets": 4}},
        "noise": {"pixel_px": noise_px},
        "evaluate": {"protocol": ["held_out"], "queries": 1, "bootstrap": 10},
        **more,
    }
    path = folder / "solve.yaml"
    path.write_text(yaml.safe_dump(spec))
    return Scene(train(path, folder, code=code), path)


def no_command(said: Said, code: int, *parts: str) -> None:
    """Nothing on stdout that a robot could take for a command, and the reason on stderr."""
    assert said.code == code, said
    assert "Traceback" not in said.err
    for part in parts:
        assert part in said.err, (part, said.err)
    assert "position" not in said.out
    assert "orientation" not in said.out
    if said.out:
        answer = yaml.safe_load(said.out)
        assert answer["motion"] is answer["command"] is None
        assert answer["status"] in ("refused", "diverged")
