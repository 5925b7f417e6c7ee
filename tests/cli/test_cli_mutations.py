"""Damaged recordings: no traceback, no hang, no more memory than 2 GiB, and every loss is said.

`make fuzz` does the same with ten times as many.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import confined
import pytest
import yaml
from bombs import BOMBS, HUGE, Bomb
from confined import Confined, objection
from mutations import MUTATIONS, case, forms
from vmf_command import Said, vmf

CASES = int(os.environ.get("VMF_FUZZ_CASES", "1000"))
# Short ones, so that workers end together and it is soon seen that one has ended.
BATCHES = max(8, CASES // 125)
# Every case is looked at; learning from it, or tracking in it, takes longer and is for some, but for
# `make fuzz`.
TRAIN_EVERY, TRACK_EVERY = (3, 4) if CASES <= 1000 else (1, 1)
# What is filmed, and who looks at it in turn.
TRACKERS = {
    "tags": ("klt", "sift", "aruco", "apriltag", "chessboard"),
    "blobs": ("meanshift", "camshift"),
}

SIMULATED = {"task": "translation", "data": {"simulate": {"frames": 24, "targets": 4, "seed": 3}}}
FILMED = {"frames": 4, "targets": 2, "motion": "hand_guided", "seed": 3}


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("bases")
    small = {"width_px": 160, "height_px": 120, "fx_px": 117.0, "fy_px": 118.0, "cx_px": 86.0, "cy_px": 64.0}
    films = {"tags": {"targets": "tag", "size_m": 0.4}, "blobs": {"targets": "blob", "size_m": 0.3}}
    documents: dict[str, dict[str, object]] = {"tracks": SIMULATED}
    for name, look in films.items():
        filmed = {**FILMED, "rig": small, "images": look}
        documents[name] = {"task": "translation", "data": {"simulate": filmed}}
    found: dict[str, bytes] = {}
    for name, document in documents.items():
        spec = folder / f"{name}.yaml"
        spec.write_text(yaml.safe_dump(document))
        images = ["--images"] if name in TRACKERS else []
        said = vmf("simulate", spec, "-o", folder / f"{name}.mcap", *images, "--quiet")
        assert said.code == 0, said
        found |= forms(folder / f"{name}.mcap", folder)
    return found


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spec") / "learn.yaml"
    recording = {
        "path": "to-be-given",
        "pose": {"topic": "/robot/pose"},
        "tracks": {"topic": "/stereo/tracks"},
    }
    evaluate = {"bootstrap": 10, "curve_points": 2, "gaps": [2]}
    document = {"task": "translation", "data": {"recording": recording}, "evaluate": evaluate}
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.mark.parametrize("batch", range(BATCHES))
def test_damaged_recordings_end_in_one_of_the_documented_ways(
    batch: int, bases: dict[str, bytes], spec: Path, tmp_path: Path
) -> None:
    wrong = []
    path = tmp_path / "damaged.mcap"
    with Confined() as run:
        for number in range(batch, CASES, BATCHES):
            damaged = case(bases, number)
            path.write_bytes(damaged.data)
            commands: list[tuple[object, ...]] = [("info", path)]
            # Numbers of one base are a residue class, so that both conditions meet all of them.
            turn, name = number // len(bases), damaged.base.split("-")[0]
            if name == "tracks" and turn % TRAIN_EVERY == 0:
                commands.append(
                    ("train", spec, f"data.recording.path={path}", "--out", tmp_path / "runs", "--quiet")
                )
            if name in TRACKERS and turn % TRACK_EVERY == 0:
                tracked = tmp_path / "tracked.mcap"
                tracked.unlink(missing_ok=True)
                kind = TRACKERS[name][turn // TRACK_EVERY % len(TRACKERS[name])]
                commands.append(("track", path, "-o", tracked, "--tracker", kind, "--quiet"))
            for command in commands:
                said = run(*command)
                objected = objection(said)
                if objected is not None:
                    what = f"case {number} ({damaged.base}: {damaged.how}), {command[0]}: {objected}"
                    wrong.append(f"{what}\n{said.err[-1500:]}")
    assert not wrong, "\n".join(wrong[:5])


def test_a_mistake_in_a_decoder_is_seen(
    bases: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What our own code gets wrong is a traceback, and nothing that is lost with the file's damage."""

    def mistaken(*_: object) -> None:
        raise TypeError("a mistake in our own code")

    monkeypatch.setattr("vmf.data.recording.observations._pixel", mistaken)
    (tmp_path / "whole.mcap").write_bytes(bases["tracks"])
    with pytest.raises(TypeError, match="a mistake in our own code"):
        vmf("info", tmp_path / "whole.mcap")


class Looking:
    """Commands that look at a recording in a process of their own, and the memory that they take for it."""

    def __init__(self, run: Confined, spec: Path, folder: Path) -> None:
        self.path, self._run = folder / "recording.mcap", run
        options = "--out", folder / "runs", "--quiet"
        self._commands: tuple[tuple[object, ...], ...] = (
            ("info", self.path),
            ("train", spec, f"data.recording.path={self.path}", *options),
            ("track", self.path, "-o", folder / "tracked.mcap", "--quiet"),
        )

    def __call__(self) -> list[tuple[str, Said, int]]:
        """Return for each command how it ended, and the most memory that it took (bytes)."""
        return [(str(c[0]), self._run(*c), self._run.peak_bytes) for c in self._commands]


@pytest.fixture(scope="module")
def looking(spec: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Looking]:
    with Confined() as run:
        yield Looking(run, spec, tmp_path_factory.mktemp("bombs"))


@pytest.fixture(scope="module")
def peaks_bytes(looking: Looking, bases: dict[str, bytes]) -> dict[str, int]:
    """How much memory each command takes for a recording that is no bomb."""
    looking.path.write_bytes(bases["tracks"])
    return {command: peak for command, _, peak in looking()}


@pytest.mark.parametrize("bomb", BOMBS)
def test_files_that_want_more_memory_than_there_is(
    bomb: Bomb, bases: dict[str, bytes], looking: Looking, peaks_bytes: dict[str, int]
) -> None:
    """What is declared or packed is never taken; the pages of the file itself, looked at, count once."""
    with looking.path.open("wb") as file:
        bomb(file, bases["tracks"])
    for command, said, peak in looking():
        assert objection(said) is None, (command, said)
        assert said.code != 0
        assert peak < peaks_bytes[command] + looking.path.stat().st_size + HUGE / 2, command


def test_too_much_memory_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confined, "MEMORY_BYTES", 2**20)
    with Confined() as run:
        said = run("info", tmp_path / "none.mcap")
    assert (said.code, said.err[:5]) == (-1, "took ")
    assert run.peak_bytes > 2**20


@pytest.mark.parametrize("name", TRACKERS)
def test_what_is_damaged_could_be_tracked(name: str, bases: dict[str, bytes], tmp_path: Path) -> None:
    (tmp_path / "whole.mcap").write_bytes(bases[name])
    for kind in TRACKERS[name]:
        said = vmf(
            "track", tmp_path / "whole.mcap", "-o", tmp_path / f"{kind}.mcap", "--tracker", kind, "--quiet"
        )
        # Neither tags of AprilTag's nor boards are in sight, but they are looked for.
        assert said.code == (2 if kind in ("apriltag", "chessboard") else 0), said


def test_every_kind_of_damage_changes_a_recording(bases: dict[str, bytes]) -> None:
    seen = set()
    for number in range(20 * len(MUTATIONS)):
        damaged = case(bases, number)
        if damaged.data != bases[damaged.base]:
            seen |= set(damaged.how.split(" + "))
    assert seen == {mutation.__name__ for mutation in MUTATIONS}


def test_with_checksums_a_file_that_reads_well_holds_everything(
    bases: dict[str, bytes], tmp_path: Path
) -> None:
    """Where `info` has nothing to say about losses, it counts as many messages as there were."""
    path = tmp_path / "damaged.mcap"

    def counted(data: bytes) -> tuple[int, list[str]]:
        path.write_bytes(data)
        said = vmf("info", path)
        lines = said.out.splitlines()
        return said.code, [line for line in lines if line.startswith("topic ")]

    sound = {"tracks": bases["tracks"]}
    whole = counted(sound["tracks"])
    assert whole[0] == 0
    assert {"/stereo/tracks", "/robot/pose"} <= {line.split()[1].rstrip(":") for line in whole[1]}
    silent = 0
    for number in range(60):
        code, lines = counted(case(sound, number).data)
        if code == 0:
            assert lines == whole[1], case(sound, number).how
            silent += 1
    assert silent < 60
