"""Every bad recording ends in one clear line and the right exit code, and costs only what is lost."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mcap_edits import at, copy, flipped, in_json, stamp_of, stretched_quaternion, with_stamp
from vmf_command import Said, errors, record, vmf

FRAMES = 80
TRACKS, POSE = "/stereo/tracks", "/robot/pose"
SPEC = f"""\
task: translation
data:
  recording: {{path: a.mcap, pose: {{topic: {POSE}}}, tracks: {{topic: {TRACKS}}}}}
learner: {{kind: transport}}
evaluate: {{curve_points: 3, bootstrap: 20}}
"""


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good recording, in chunks of a few kilobytes."""
    folder = tmp_path_factory.mktemp("sound")
    spec = folder / "spec.yaml"
    spec.write_text(f"task: translation\ndata: {{simulate: {{frames: {FRAMES}, targets: 4}}}}\n")
    assert vmf("simulate", spec, "-o", folder / "whole.mcap").code == 0
    return copy(folder / "whole.mcap", folder / "sound.mcap")


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "spec.yaml"
    path.write_text(SPEC)
    return path


def train(spec: Path, *more: str) -> Said:
    return vmf("train", spec, *more, "--out", spec.parent / "runs", "--json", "--quiet")


def lost(said: Said, spec: Path, *parts: str) -> str:
    """Results are written, and the loss is named with the file or topic on one line (exit code 3)."""
    assert said.code == 3, said
    lines = said.err.splitlines()
    assert lines
    assert all(line.startswith("lost: ") for line in lines), said.err
    assert len(errors(said.run)) > 0
    assert record(said.run)["status"] == "done"
    assert record(said.run)["losses"] == [line.removeprefix("lost: ") for line in lines]
    (line,) = (line for line in lines if all(part in line for part in parts))
    return line


def refused(spec: Path, *parts: str) -> None:
    """The file is refused by name in one line, and no run directory is left."""
    line = train(spec).refused(*parts)
    assert line.startswith(f"{spec.parent / 'a.mcap'}: ")
    assert not (spec.parent / "runs").exists()


def test_a_good_recording_loses_nothing(spec: Path, sound: Path) -> None:
    copy(sound, spec.parent / "a.mcap")
    said = train(spec)
    assert (said.code, said.err) == (0, "")
    info = vmf("info", spec.parent / "a.mcap")
    assert (info.code, info.err) == (0, "")
    for part in (f"{TRACKS}: vmf.StereoTracks, json, {FRAMES}", f"{FRAMES} frames", "4 targets", POSE):
        assert part in info.out


def test_a_truncated_file_is_used_as_far_as_it_goes(spec: Path, sound: Path) -> None:
    path = spec.parent / "a.mcap"
    data = sound.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    lost(train(spec), spec, str(path), f"file ends at byte {len(data) // 2}")
    info = vmf("info", path)
    assert info.code == 3
    assert "lost: " in info.err
    assert f"file ends at byte {len(data) // 2}" in info.out
    assert "Traceback" not in info.err


def test_a_flipped_bit_costs_its_chunk(spec: Path, sound: Path) -> None:
    path = spec.parent / "a.mcap"
    data = sound.read_bytes()
    path.write_bytes(flipped(data, len(data) // 3))
    said = train(spec)
    lost(said, spec, str(path), "damaged")
    assert vmf("info", path).code == 3


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"", "is empty (0 bytes)"),
        (b"\x89MC", "only 3 bytes long"),
        (b"PK\x03\x04 zip archive", "is not an MCAP file"),
    ],
    ids=["empty", "3 bytes", "not MCAP"],
)
def test_what_is_no_recording_is_refused(spec: Path, content: bytes, part: str) -> None:
    path = spec.parent / "a.mcap"
    path.write_bytes(content)
    refused(spec, part)
    vmf("info", path).refused(str(path), part)


def test_a_missing_file_or_a_directory_is_refused(spec: Path) -> None:
    refused(spec, "no such file")
    (spec.parent / "a.mcap").mkdir()
    refused(spec, "is a directory")


@pytest.mark.parametrize("which", ["pose", "tracks"])
def test_a_missing_topic_is_refused_with_those_present(spec: Path, sound: Path, which: str) -> None:
    copy(sound, spec.parent / "a.mcap")
    wrong = {"pose": "/robot/poses", "tracks": "/stereo/track"}[which]
    right = {"pose": POSE, "tracks": TRACKS}[which]
    spec.write_text(SPEC.replace(f"{{topic: {right}}}", f"{{topic: {wrong}}}"))
    refused(spec, f"no topic {wrong}", f"did you mean {right}?", f"{POSE} (", f"{TRACKS} (vmf.StereoTracks)")


@pytest.mark.parametrize(("topic", "accepted"), [(TRACKS, "vmf.StereoTracks"), (POSE, "PoseStamped")])
def test_a_wrong_schema_is_refused_with_those_accepted(
    spec: Path, sound: Path, topic: str, accepted: str
) -> None:
    copy(sound, spec.parent / "a.mcap", schemas={topic: "my_msgs/msg/Mine"})
    refused(spec, f"topic {topic} has schema my_msgs/msg/Mine", accepted)


def test_topics_exchanged_are_refused(spec: Path, sound: Path) -> None:
    copy(sound, spec.parent / "a.mcap")
    spec.write_text(SPEC.replace(POSE, "X").replace(TRACKS, POSE).replace("X", TRACKS))
    refused(spec, f"topic {TRACKS} has schema vmf.StereoTracks")


def _nan_left(message: dict[str, Any]) -> None:
    message["tracks"][0]["left"][0] = float("nan")


def test_a_pixel_that_is_nan_is_lost_by_name(spec: Path, sound: Path) -> None:
    copy(sound, spec.parent / "a.mcap", edits={TRACKS: at(5, in_json(_nan_left))})
    line = lost(train(spec), spec, TRACKS)
    assert "NaN" in line or "finite" in line


@pytest.mark.parametrize("factor", [0.0, 0.9, 1.5])
def test_a_quaternion_that_is_not_of_unit_length_is_refused_by_name(
    spec: Path, sound: Path, factor: float
) -> None:
    copy(sound, spec.parent / "a.mcap", edits={POSE: at(7, stretched_quaternion(factor))})
    refused(spec, f"{POSE}: message 7 has a quaternion of norm {factor:g}")


def test_a_pose_that_is_nan_is_lost_by_name_and_all_of_them_are_refused(spec: Path, sound: Path) -> None:
    nan = stretched_quaternion(float("nan"))
    copy(sound, spec.parent / "a.mcap", edits={POSE: at(7, nan)})
    assert lost(train(spec), spec, f"{POSE}: ").endswith("(1)")
    copy(sound, spec.parent / "a.mcap", edits={POSE: lambda i, data: [nan(data)]})
    said = train(spec)
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith(f"{spec.parent / 'a.mcap'}: {POSE} holds no usable pose")
    assert "Traceback" not in said.err


def test_unsorted_times_are_put_in_order_and_change_nothing(spec: Path, sound: Path) -> None:
    held: list[bytes] = []

    def exchanged(i: int, data: bytes) -> list[bytes]:
        """Messages 10 and 11 change places."""
        if i == 10:
            held.append(data)
            return []
        return [data, held.pop()] if i == 11 else [data]

    copy(sound, spec.parent / "a.mcap")
    straight = train(spec)
    copy(sound, spec.parent / "a.mcap", edits={POSE: exchanged})
    mixed = vmf("train", spec, "--out", spec.parent / "mixed", "--json")
    assert mixed.code == 0
    assert "repaired: " in mixed.err
    assert "out of time order" in mixed.err
    assert errors(mixed.run).equals(errors(straight.run))


def test_a_time_said_twice_is_lost_by_name(spec: Path, sound: Path) -> None:
    stamps: list[tuple[int, int]] = []

    def repeated(i: int, data: bytes) -> list[bytes]:
        stamps.append(stamp_of(data))
        return [with_stamp(data, stamps[19]) if i == 20 else data]

    copy(sound, spec.parent / "a.mcap", edits={POSE: repeated})
    line = lost(train(spec), spec, POSE, "stamp of an earlier one dropped")
    assert line.endswith("(1)")


def test_a_robot_and_a_camera_at_different_times_have_nothing_in_common(spec: Path, sound: Path) -> None:
    def later(i: int, data: bytes) -> list[bytes]:
        sec, nanosec = stamp_of(data)
        return [with_stamp(data, (sec + 1000, nanosec))]

    copy(sound, spec.parent / "a.mcap", edits={POSE: later})
    said = train(spec)
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith(f"{spec.parent / 'a.mcap'}: no frame remains")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("evaluate.trials=3", "evaluate.trials: found 3"),
        ("evaluate.checkpoints=[9999]", "evaluate.checkpoints: found 9999"),
        ("evaluate.min_targets=9", "share 9 targets"),
    ],
)
def test_what_a_recording_cannot_answer_is_refused(spec: Path, sound: Path, override: str, said: str) -> None:
    copy(sound, spec.parent / "a.mcap")
    train(spec, override).refused(said)


@pytest.mark.parametrize("fraction", [0.001, 0.0125])
def test_too_few_frames_to_learn_from_are_refused(spec: Path, sound: Path, fraction: float) -> None:
    copy(sound, spec.parent / "a.mcap")
    train(spec, f"evaluate.train_fraction={fraction}").refused("frame")


@pytest.mark.parametrize("override", ["evaluate.gaps=[5, 500]", "evaluate.gaps=[500]"])
def test_a_gap_that_no_pair_of_frames_has_is_told(spec: Path, sound: Path, override: str) -> None:
    copy(sound, spec.parent / "a.mcap")
    assert "500" in vmf("train", spec, override, "--out", spec.parent).err
