"""Recordings that explain themselves: what `simulate`, `track` and `evaluate --mcap` write for Foxglove."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory
from vmf_command import CONFIGS, QUICK, Said, errors, record, train, vmf

from vmf.data.recording import describe
from vmf.data.recording.container import RawMessage, Topic
from vmf.data.recording.output import output
from vmf.spec import load, spec_hash

ROOT = CONFIGS.parent
NODE = ROOT / ".venv" / "node"
IMAGES = ("/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed")
DRAWN = ("/stereo/left/annotations", "/stereo/right/annotations")
GAP = 3
EVALUATE = {"protocol": ["held_out"], "gaps": [GAP, 2], "bootstrap": 20, "train_fraction": 0.7}
SIMULATE = {"frames": 24, "targets": 4, "motion": "hand_guided", "rate_hz": 10.0, "seed": 4}


@dataclass(frozen=True)
class Files:
    """One chain: a film, its tracks, a model of them, its evaluation; and the same without images.

    Attributes
    ----------
    evaluation, simulated_evaluation : run directories of the evaluations.
    """

    spec: Path
    film: Path
    tracks: Path
    run: Path
    evaluated: Path
    evaluation: Path
    plain: Path
    simulated_run: Path
    simulated: Path
    simulated_evaluation: Path
    said: Said
    said_of_evaluation: Said

    @property
    def written(self) -> tuple[Path, ...]:
        return self.film, self.tracks, self.evaluated, self.plain, self.simulated


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Files:
    folder = tmp_path_factory.mktemp("foxglove")

    def spec(name: str, data: dict[str, object]) -> Path:
        path = folder / f"{name}.yaml"
        path.write_text(yaml.safe_dump({"task": "six_dof", "data": data, "evaluate": EVALUATE}))
        return path

    def done(*arguments: object) -> Said:
        said = vmf(*arguments)
        assert said.code == 0, said
        return said

    film, tracks, evaluated = (folder / f"{name}.mcap" for name in ("film", "tracks", "evaluated"))
    of_film = spec("film", {"simulate": {**SIMULATE, "images": {"targets": "tag"}}})
    done("simulate", of_film, "-o", film, "--images", "--quiet")
    done("track", film, "-o", tracks, "--tracker", "aruco", "--quiet")
    source = {"path": "tracks.mcap", "pose": {"topic": "/robot/pose"}, "tracks": {"topic": "/stereo/tracks"}}
    run = train(spec("tracked", {"recording": source}), folder)
    evaluation = done("evaluate", run, "--mcap", evaluated, "--json")
    plain, simulated = folder / "plain.mcap", folder / "simulated.mcap"
    done("simulate", CONFIGS / "quickstart.yaml", "-o", plain, "data.simulate.frames=20", "noise.pixel_px=0")
    simulated_run = train(CONFIGS / "quickstart.yaml", folder, *QUICK)
    said = done("evaluate", simulated_run, "--mcap", simulated, "--json")
    return Files(
        of_film,
        film,
        tracks,
        run,
        evaluated,
        evaluation.run,
        plain,
        simulated_run,
        simulated,
        said.run,
        said,
        evaluation,
    )


def raw(path: Path, *topics: str) -> Iterator[tuple[str, int, bytes]]:
    """Topic, log time and bytes of messages."""
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(topics=topics or None):
            yield channel.topic, message.log_time, message.data


def decoded(path: Path, *topics: str) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time and content of messages in ROS 2 or protobuf."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Ros2Factory(), ProtobufFactory()])
        for _, channel, message, content in reader.iter_decoded_messages(topics=topics):
            yield channel.topic, message.log_time, content


def told(path: Path, topic: str) -> list[dict[str, Any]]:
    """Messages in JSON."""
    return [json.loads(data) for _, _, data in raw(path, topic)]


def stamped_ns(message: Any) -> int:
    """When a message in ROS 2 was stamped."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def xy(points: Any) -> np.ndarray:
    return np.array([(p.x, p.y) for p in points]).reshape(-1, 2)


def pixels(message: dict[str, Any], side: str) -> dict[str, list[float]]:
    return {t["id"]: t[side] for t in message["tracks"] if t[side] is not None}


def layers(message: Any) -> dict[str, np.ndarray]:
    """The points of each layer, by name; four ends of lines make a target."""
    names = [t.text.split()[0] for t in message.texts if t.font_size > 14]
    found = {}
    for name, drawn in zip(names, message.points, strict=True):
        points = xy(drawn.points)
        found[name] = points if drawn.type == drawn.POINTS else points.reshape(-1, 4, 2).mean(axis=1)
    return found


def same_points(drawn: np.ndarray, seen: list[list[float]]) -> None:
    """What is drawn is what was seen, in any order, half a pixel further; crosses have rounded middles."""
    expected = np.array(sorted(seen)) + 0.5
    np.testing.assert_allclose(drawn[np.lexsort(drawn.T[::-1])], expected, rtol=0, atol=1e-9)


def independent(*paths: Path) -> list[dict[str, Any]]:
    """What an independent reader finds."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("there is no node to run the independent reader @mcap/core with")
    if not (NODE / "node_modules" / "@mcap" / "core").is_dir():
        pytest.skip("the independent reader @mcap/core is not installed: `make test` does it where npm can")
    script = Path(__file__).with_name("read_mcap.mjs")
    said = subprocess.run([node, script, NODE, *paths], capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr
    return list(json.loads(said.stdout))


def test_an_independent_reader_finds_no_error(files: Files) -> None:
    for path, found in zip(files.written, independent(*files.written), strict=True):
        assert "error" not in found, (path.name, found)
        counts = {t.name: t.count for t in describe(path).topics}
        assert found["topics"] == counts
        assert found["counted"] == found["streamed"] == sum(counts.values())
        assert found["attachments"] == [found["metadata"]["vmf"]["attachment"]]


def test_the_independent_reader_would_find_one(files: Files, tmp_path: Path) -> None:
    data = bytearray(files.plain.read_bytes())
    data[len(data) // 3] ^= 1
    (tmp_path / "flipped.mcap").write_bytes(data)
    (tmp_path / "cut.mcap").write_bytes(files.plain.read_bytes()[:-100])
    found = independent(tmp_path / "flipped.mcap", tmp_path / "cut.mcap", files.plain)
    assert ["error" in one for one in found] == [True, True, False]


def test_chunks_are_small_and_everything_is_indexed(files: Files) -> None:
    for path in files.written:
        with path.open("rb") as file:
            summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        largest = max(len(data) for _, _, data in raw(path))
        # A chunk is closed by the message that makes it too large; a record has a head of 31 bytes.
        assert max(c.uncompressed_size for c in summary.chunk_indexes) < 64 * 1024 + largest + 64 * 1024
        assert len(summary.metadata_indexes) == len(summary.attachment_indexes) == 1
        assert all(c.message_index_offsets for c in summary.chunk_indexes)


def test_the_spec_goes_along_with_its_hash(files: Files) -> None:
    expected = {
        files.film: spec_hash(load(files.spec).spec),
        files.evaluated: record(files.evaluation)["spec_hash"],
        files.simulated: record(files.simulated_evaluation)["spec_hash"],
        files.tracks: None,
    }
    for path, wanted in expected.items():
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            (attached,), (said,) = reader.iter_attachments(), reader.iter_metadata()
        assert said.metadata["sha256"] == hashlib.sha256(attached.data).hexdigest()
        assert said.metadata.get("spec_hash") == wanted
    assert expected[files.evaluated] == record(files.run)["spec_hash"]


@pytest.mark.parametrize("name", ["film", "tracks", "evaluated"])
def test_every_image_has_its_annotations_at_its_own_time(files: Files, name: str) -> None:
    for image, drawn in zip(IMAGES, DRAWN, strict=True):
        path = getattr(files, name)
        taken = [stamped_ns(m) for *_, m in decoded(path, image)]
        shown = [m.timestamp.ToNanoseconds() for *_, m in decoded(path, drawn)]
        assert len(taken) == SIMULATE["frames"]
        assert shown == taken


def test_what_is_not_drawn_is_said(files: Files) -> None:
    told = f"of questions at one frame (held_out gap={GAP}, held_out gap=2) the first answered is drawn"
    assert told in files.said_of_evaluation.err
    assert f"/stereo/left/questions/held_out_gap_{GAP}" in files.said_of_evaluation.err


@pytest.mark.parametrize("gap", [GAP, 2])
def test_every_question_can_be_looked_at(gap: int, files: Files) -> None:
    """Each kind has topics of its own, with an empty message where nothing is asked."""
    frames, kind = SIMULATE["frames"], f"held_out_gap_{gap}"
    assert isinstance(frames, int)
    messages = told(files.evaluated, "/stereo/tracks")
    first = round(EVALUATE["train_fraction"] * frames)  # type: ignore[operator]
    asked = range(first, frames - gap)
    legends = set()
    for side, image, drawn in zip(("left", "right"), IMAGES, DRAWN, strict=True):
        topic = f"/stereo/{side}/questions/{kind}"
        taken = [stamped_ns(m) for *_, m in decoded(files.evaluated, image)]
        shown = [m for *_, m in decoded(files.evaluated, topic)]
        assert [m.timestamp.ToNanoseconds() for m in shown] == taken
        for i, (message, beside) in enumerate(
            zip(shown, (m for *_, m in decoded(files.evaluated, drawn)), strict=True)
        ):
            found = layers(message)
            assert list(found) == (["desired", "predicted"] if i in asked else [])
            if i not in asked:
                continue
            assert f"desired held_out gap={gap}" in [t.text for t in message.texts]
            later = pixels(messages[i + gap], side)
            askable = pixels(messages[i], "left").keys() & pixels(messages[i], "right").keys()
            same_points(found["desired"], [later[name] for name in later if name in askable])
            rows = {t.position.y for t in message.texts}
            assert not rows & {t.position.y for t in beside.texts if t.font_size > 14}
            legends |= rows
    assert len(legends) == 2
    for pose in ("desired_pose", "predicted_pose"):
        counted = {t.name: t.count for t in describe(files.evaluated).topics}
        assert counted[f"/robot/{pose}/{kind}"] == len(asked)
    now = {stamped_ns(m): m for *_, m in decoded(files.evaluated, "/robot/pose")}
    times = sorted(now)
    for *_, goal in decoded(files.evaluated, f"/robot/desired_pose/{kind}"):
        later_pose = now[times[times.index(goal.timestamp.ToNanoseconds()) + gap]].pose
        for axis in "xyz":
            assert abs(getattr(goal.pose.position, axis) - getattr(later_pose.position, axis)) < 1e-9
    said = [m for m in told(files.evaluated, "/errors/vmf") if m["case"] == f"gap={gap}"]
    assert len(said) == len(asked)
    assert all(isinstance(m["distance"]["abs_error"], float) for m in said if m["status"] == "ok")


def test_images_poses_and_calibrations_are_copied_as_they_are(files: Files) -> None:
    same = [*IMAGES, "/robot/pose", "/robot/transform", "/stereo/left/calibration", "/stereo/left/transform"]
    for topic in same:
        first, *others = (list(raw(path, topic)) for path in (files.film, files.tracks, files.evaluated))
        assert first
        assert all(other == first for other in others)
    assert list(raw(files.evaluated, "/stereo/tracks")) == list(raw(files.tracks, "/stereo/tracks"))


@pytest.mark.parametrize(("name", "topic"), [("film", "/stereo/true_tracks"), ("tracks", "/stereo/tracks")])
def test_tracks_are_drawn_half_a_pixel_further(files: Files, name: str, topic: str) -> None:
    path = getattr(files, name)
    for side, drawn in zip(("left", "right"), DRAWN, strict=True):
        for message, (_, _, shown) in zip(told(path, topic), decoded(path, drawn), strict=True):
            seen = pixels(message, side)
            np.testing.assert_array_equal(layers(shown)["observed"], np.array(list(seen.values())) + 0.5)
            assert [t.text for t in shown.texts] == ["observed", *seen]


def test_questions_are_drawn_at_their_first_view(files: Files) -> None:
    messages = told(files.evaluated, "/stereo/tracks")
    first = round(EVALUATE["train_fraction"] * SIMULATE["frames"])  # type: ignore[operator]
    for side, topic in zip(("left", "right"), DRAWN, strict=True):
        closer = []
        for i, (_, _, shown) in enumerate(decoded(files.evaluated, topic)):
            found = layers(shown)
            asked = first <= i < SIMULATE["frames"] - 2  # type: ignore[operator]
            assert list(found) == (["observed", "desired", "predicted"] if asked else ["observed"])
            now = pixels(messages[i], side)
            same_points(found["observed"], list(now.values()))
            if not asked:
                continue
            gap = GAP if i + GAP < SIMULATE["frames"] else 2  # type: ignore[operator]
            assert f"desired held_out gap={gap}" in [t.text for t in shown.texts]
            later = pixels(messages[i + gap], side)
            # A target is asked about if both cameras see it now; where it should be is where it will be.
            askable = pixels(messages[i], "left").keys() & pixels(messages[i], "right").keys()
            both = [name for name in later if name in askable]
            same_points(found["desired"], [later[name] for name in both])
            # The nearest prediction to each target's goal is much nearer than where the target is now.
            off = np.linalg.norm(found["desired"][:, None] - found["predicted"][None], axis=-1).min(axis=1)
            moved = [np.linalg.norm(np.subtract(later[name], now[name])) for name in both]
            closer.append(np.median(off) < 0.2 * np.median(moved))
        assert len(closer) > 2
        assert all(closer)


def test_errors_are_the_numbers_of_the_table(files: Files) -> None:
    for path, run in ((files.evaluated, files.evaluation), (files.simulated, files.simulated_evaluation)):
        table = errors(run)
        for method in ("vmf", "no_motion"):
            rows = table[(table["method"] == method) & (table["status"] == "ok")]
            said = told(path, f"/errors/{method}")
            assert len(said) == (table["method"] == method).sum() / table["component"].nunique()
            for field in ("truth", "estimate", "abs_error"):
                numbers = [
                    (m["protocol"], m["trial"], m["frame"], component, m[component][field])
                    for m in said
                    for component in table["component"].unique()
                    if m["status"] == "ok"
                ]
                columns = ["protocol", "trial", "frame", "component", field]
                assert sorted(numbers) == sorted(rows[columns].itertuples(index=False, name=None))


def test_simulated_questions_are_written_without_images_and_it_is_said(files: Files) -> None:
    topics = {t.name: t.count for t in describe(files.simulated).topics}
    questions = len(errors(files.simulated_evaluation).query("method == 'vmf' and component == 'angle'"))
    assert questions > 20
    assert not topics.keys() & set(IMAGES)
    assert topics["/errors/vmf"] == topics["/robot/desired_pose"] == topics["/robot/transform"] == questions
    assert topics[DRAWN[0]] == topics[DRAWN[1]] == questions
    assert topics["/stereo/left/calibration"] == topics["/stereo/right/calibration"] == 1
    assert f"note: {questions} simulated questions written without images" in files.said.err


def layout_topics(value: Any) -> Iterator[str]:
    """Every topic that a layout names, as a key, or in front of the fields of a message."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from layout_topics(key)
            yield from layout_topics(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from layout_topics(inner)
    elif isinstance(value, str) and value.startswith("/"):
        yield value.split(".")[0]


def test_the_layout_names_what_is_written(files: Files) -> None:
    layout = json.loads((ROOT / "docs" / "foxglove-layout.json").read_text())
    named = set(layout_topics(layout["configById"]))
    assert {*IMAGES, *DRAWN, "/errors/vmf"} <= named
    assert named <= {t.name for t in describe(files.evaluated).topics}
    panels = {name.split("!")[0] for name in layout["configById"]}
    assert panels == {"Image", "3D", "Plot"}
    text = json.dumps(layout["layout"])
    assert all(name in text for name in layout["configById"])
    # What is plotted is a number in the messages.
    message = told(files.evaluated, "/errors/vmf")[0]
    for name, panel in layout["configById"].items():
        for path in panel["paths"] if name.startswith("Plot") else ():
            _, component, field = path["value"].split(".")
            assert isinstance(message[component][field], float)
    scene = layout["configById"]["3D!scene"]
    transforms = (m for *_, m in decoded(files.evaluated, *[t for t in named if t.endswith("transform")]))
    of_bodies = (m for *_, m in decoded(files.evaluated, "/robot/transform", "/stereo/left/transform"))
    frames = {f for m in (*transforms, *of_bodies) for f in (m.parent_frame_id, m.child_frame_id)}
    assert scene["followTf"] in frames


def test_an_evaluation_can_be_evaluated_again(files: Files, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    said = vmf("evaluate", files.run, "--data", files.evaluated, "--mcap", again, "--json", "--quiet")
    assert said.code == 0, said
    counts = {t.name: t.count for t in describe(again).topics}
    # A file of its own is asked about as a whole, and its annotations and errors are not copied.
    assert counts[DRAWN[0]] == SIMULATE["frames"]
    assert counts["/robot/desired_pose/held_out_gap_2"] == 24 - 2
    assert counts["/errors/vmf"] == 24 - GAP + 24 - 2


def test_the_original_is_never_written_over(files: Files, tmp_path: Path) -> None:
    before = files.tracks.read_bytes()
    (tmp_path / "link.mcap").symlink_to(files.tracks)
    for target in (files.tracks, tmp_path / "link.mcap"):
        vmf("evaluate", files.run, "--mcap", target).refused(f"--mcap {target}", "is the recording itself")
    vmf("track", files.film, "-o", files.film).refused(f"-o {files.film}", "is the recording itself")
    assert files.tracks.read_bytes() == before


def test_what_cannot_be_written_to_is_said_before_the_work(files: Files, tmp_path: Path) -> None:
    (tmp_path / "dir.mcap").mkdir()
    evaluations = sorted((files.run / "evaluations").iterdir())
    for name, why in {
        "dir.mcap": "is a directory",
        "e.bag": "found a name without .mcap",
        "none/e.mcap": "there is no directory",
    }.items():
        for command in (
            ("evaluate", files.run, "--mcap"),
            ("simulate", files.spec, "-o"),
            ("track", files.film, "-o"),
        ):
            vmf(*command, tmp_path / name).refused(f"{command[-1]} {tmp_path / name}: ", why)
    assert sorted((files.run / "evaluations").iterdir()) == evaluations


def test_a_recording_without_images_is_evaluated_without(files: Files, tmp_path: Path) -> None:
    source = {
        "path": str(files.plain),
        "pose": {"topic": "/robot/pose"},
        "tracks": {"topic": "/stereo/tracks"},
    }
    spec = tmp_path / "plain.yaml"
    spec.write_text(
        yaml.safe_dump({"task": "translation", "data": {"recording": source}, "evaluate": EVALUATE})
    )
    run = train(spec, tmp_path)
    said = vmf("evaluate", run, "--mcap", tmp_path / "e.mcap", "--json")
    assert said.code == 0, said
    assert "note: the recording has no images" in said.err
    counts = {t.name: t.count for t in describe(tmp_path / "e.mcap").topics}
    assert counts[DRAWN[0]] == counts[DRAWN[1]] == counts["/robot/transform"] == 20
    assert counts["/errors/vmf"] > 0


def test_a_published_calibration_is_shown_to_those_who_look(files: Files, tmp_path: Path) -> None:
    """The calibration in a spec becomes cameras in the frame S; the learner knows nothing of it."""
    R = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    intrinsics = {"fx_px": 469.0, "fy_px": 472.0, "cx_px": 344.0, "cy_px": 255.0}
    calibration = {"left": intrinsics, "baseline_m": 0.2, "L_R_S": R, "S_p_L_m": [0.1, 0.2, 0.3]}
    # Without the simulation's own cameras, and without a word on the size of images.
    bare = tmp_path / "bare.mcap"
    with files.plain.open("rb") as file, output(bare) as out:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages(topics=["/robot/pose", "/stereo/tracks"]):
            assert schema is not None
            data = message.data
            if channel.message_encoding == "json":
                content = {k: v for k, v in json.loads(data).items() if not k.endswith("_size")}
                data = json.dumps(content).encode()
            topic = Topic(channel.topic, channel.message_encoding, schema.name, schema.encoding, schema.data)
            out.copy(RawMessage(topic, 0, message.log_time, data))
    source = {"path": "bare.mcap", "pose": {"topic": "/robot/pose"}, "calibration": calibration}
    data = {"recording": {**source, "tracks": {"topic": "/stereo/tracks"}}}
    spec = tmp_path / "bare.yaml"
    spec.write_text(yaml.safe_dump({"task": "translation", "data": data, "evaluate": EVALUATE}))
    run = train(spec, tmp_path)
    assert vmf("evaluate", run, "--mcap", tmp_path / "e.mcap", "--json", "--quiet").code == 0
    seen = [t for m in told(bare, "/stereo/tracks") for t in m["tracks"]]
    largest = np.max([p for t in seen for p in (t["left"], t["right"])], axis=0)
    for i, side in enumerate(("left", "right")):
        ((_, _, known),) = decoded(tmp_path / "e.mcap", f"/stereo/{side}/calibration")
        ((_, _, at),) = decoded(tmp_path / "e.mcap", f"/stereo/{side}/transform")
        assert list(known.K) == [469.0, 0.0, 344.0, 0.0, 472.0, 255.0, 0.0, 0.0, 1.0]
        np.testing.assert_allclose(known.P[3], -469.0 * 0.2 * i, atol=1e-12)
        assert (known.width, known.height) == tuple(np.ceil(largest + 0.5).astype(int))
        # The right camera is 0.2 m along the camera's x axis, −y of S.
        t = at.translation
        np.testing.assert_allclose((t.x, t.y, t.z), (0.1, 0.2 - 0.2 * i, 0.3), atol=1e-12)
        assert (at.parent_frame_id, at.child_frame_id) == ("body", side)


def test_tracks_of_poses_that_name_no_body_get_one(shared_data: Path, tmp_path: Path) -> None:
    said = vmf("track", shared_data / "franka_images.mcap", "-o", tmp_path / "t.mcap", "--tracker", "aruco")
    assert said.code == 0, said
    bodies = [m for *_, m in decoded(tmp_path / "t.mcap", "/robot/transform")]
    poses = [m.pose for *_, m in decoded(tmp_path / "t.mcap", "/franka/tool_pose")]
    assert len(bodies) == len(poses) == 20
    assert {(b.parent_frame_id, b.child_frame_id) for b in bodies} == {("panda_link0", "body")}
    for body, pose in zip(bodies, poses, strict=True):
        assert (body.translation.x, body.translation.z) == (pose.position.x, pose.position.z)
        q, p = body.rotation, pose.orientation
        assert abs(q.x * p.x + q.y * p.y + q.z * p.z + q.w * p.w) == pytest.approx(1.0)
