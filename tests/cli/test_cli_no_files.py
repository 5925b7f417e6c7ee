"""Pipes and devices in the place of files end in one line, at once: nobody would ever write to them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from confined import Confined
from vmf_command import MINI

SPEC = {"task": "translation", "data": {"simulate": {"frames": 5, "seed": 1}}}


@pytest.fixture(scope="module")
def run() -> Iterator[Confined]:
    """A hang ends in a failure, not in a stop of everything."""
    with Confined() as confined:
        yield confined


def pipe(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.unlink(missing_ok=True)
    os.mkfifo(path)
    return path


def test_a_pipe_is_no_file(run: Confined, tmp_path: Path) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text(yaml.safe_dump(SPEC))
    out = tmp_path / "out.mcap"
    mcap, npz = pipe(tmp_path / "a.mcap"), pipe(tmp_path / "model.npz")
    recorded = {
        "recording": {"path": str(mcap), "pose": {"topic": "/p"}, "tracks": {"topic": "/t"}},
    }
    (tmp_path / "recorded.yaml").write_text(yaml.safe_dump({"task": "translation", "data": recorded}))
    record = pipe(tmp_path / "run" / "run.json").parent
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("")
    pipe(tmp_path / "bag" / "bag.db3")
    (tmp_path / "csv").mkdir()
    pipe(tmp_path / "csv" / "pose.csv")
    commands: list[tuple[object, ...]] = [
        ("info", mcap),
        ("info", npz),
        ("info", record),
        ("track", mcap, "-o", out),
        ("train", pipe(tmp_path / "pipe.yaml"), *MINI),
        ("train", tmp_path / "recorded.yaml", "--out", tmp_path / "runs", "--quiet"),
        ("sweep", spec, "--grid", tmp_path / "pipe.yaml", "--out", tmp_path / "runs"),
        ("solve", npz, "--file", tmp_path / "pipe.yaml"),
        ("simulate", spec, "-o", mcap),
        ("import", "npz", npz, "-o", out),
        ("import", "csv", tmp_path / "csv", "-o", out),
        ("import", "csv", npz, "-o", out),
        ("import", "rosbag2", tmp_path / "bag", "-o", out),
        ("import", "rosbag2", npz, "-o", out),
    ]
    for command in commands:
        said = run(*command)
        line = said.refused()
        assert "regular file" in line, (command, line)
    assert "device" in run("info", "/dev/zero").refused()
    assert not out.exists()


def test_a_pipe_among_images_is_lost_alone(run: Confined, tmp_path: Path) -> None:
    source, n = tmp_path / "07", 3
    picture = cv2.imencode(".png", np.full((8, 8), 100, np.uint8))[1].tobytes()
    for camera in ("image_0", "image_1"):
        (source / camera).mkdir(parents=True)
        for i in range(n):
            (source / camera / f"{i:06d}.png").write_bytes(picture)
    (source / "times.txt").write_text("".join(f"{i / 10}\n" for i in range(n)))
    (source / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * n)
    pipe(source / "image_0" / "000001.png")
    said = run("import", "kitti", source, "-o", tmp_path / "a.mcap", "--quiet")
    assert said.code == 3, said
    (line,) = said.err.splitlines()
    assert "images that cannot be read dropped" in line
    assert "000001.png: it is a named pipe, a regular file is accepted (1)" in line
