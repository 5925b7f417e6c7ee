"""Damaged recordings: no traceback, no hang, no more memory than 2 GiB, and every loss is said.

`make fuzz` does the same with ten times as many.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from confined import Confined
from mutations import MUTATIONS, case, forms
from vmf_command import Said, vmf

CASES = int(os.environ.get("VMF_FUZZ_CASES", "1000"))
BATCHES = 8
# Every case is looked at; learning from it, or tracking in it, takes longer and is for some.
TRAIN_EVERY, TRACK_EVERY = 7, 9

SIMULATED = {"task": "translation", "data": {"simulate": {"frames": 24, "targets": 4, "seed": 3}}}
FILMED = {"frames": 4, "targets": 3, "motion": "hand_guided", "seed": 3, "images": {"targets": "tag"}}


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("bases")
    small = {"width_px": 160, "height_px": 120, "fx_px": 117.0, "fy_px": 118.0, "cx_px": 86.0, "cy_px": 64.0}
    documents = {
        "tracks": SIMULATED,
        "images": {"task": "translation", "data": {"simulate": {**FILMED, "rig": small}}},
    }
    found: dict[str, bytes] = {}
    for name, document in documents.items():
        spec = folder / f"{name}.yaml"
        spec.write_text(yaml.safe_dump(document))
        images = ["--images"] if name == "images" else []
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


def objection(said: Said) -> str | None:
    """Return what is wrong with how a command ended, None if nothing is."""
    if said.code not in (0, 2, 3):
        return f"exit code {said.code}"
    if "Traceback" in said.err:
        return "a traceback"
    if said.code == 2 and not said.err.strip():
        return "refused without a word"
    if said.code == 3 and "lost: " not in said.err and "lost" not in said.out:
        return "losses that are not named"
    return None


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
            if damaged.base.startswith("tracks") and number // len(bases) % TRAIN_EVERY == 0:
                commands.append(
                    ("train", spec, f"data.recording.path={path}", "--out", tmp_path / "runs", "--quiet")
                )
            if damaged.base.startswith("images") and number // len(bases) % TRACK_EVERY == 0:
                tracked = tmp_path / "tracked.mcap"
                tracked.unlink(missing_ok=True)
                commands.append(("track", path, "-o", tracked, "--tracker", "klt", "--quiet"))
            for command in commands:
                said = run(*command)
                objected = objection(said)
                if objected is not None:
                    what = f"case {number} ({damaged.base}: {damaged.how}), {command[0]}: {objected}"
                    wrong.append(f"{what}\n{said.err[-1500:]}")
    assert not wrong, "\n".join(wrong[:5])


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
