"""Recordings written message by message, and what Foxglove is told to draw."""

from __future__ import annotations

import hashlib
import json
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from recording_files import START_NS, File, example, moving_robot

from vmf.data.poses import PanTiltJoints
from vmf.data.recording import Extras, schemas, write
from vmf.data.recording.container import messages, scan
from vmf.data.recording.foxglove import DESIRED, LAYERS, OBSERVED, PREDICTED, Camera, Drawn, image_annotations
from vmf.data.recording.output import CHUNK_BYTES, check_target, output
from vmf.data.tracks import from_dense
from vmf.errors import InputError
from vmf.geometry import from_rotation_translation, inverse
from vmf.geometry.camera import R_CAMERA_FROM_BODY

TEXT = "task: planar\n"


def decoded(path: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time and content of every protobuf message."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        topics = [c.topic for c in reader.get_summary().channels.values() if c.message_encoding == "protobuf"]  # type: ignore[union-attr]
        for _, channel, message, content in reader.iter_decoded_messages(topics=topics):
            yield channel.topic, message.log_time, content


def matrix(T: Any) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    t, q = T.translation, T.rotation
    return from_rotation_translation(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), [t.x, t.y, t.z])


def xy(points: Any) -> np.ndarray:
    return np.array([(p.x, p.y) for p in points]).reshape(-1, 2)


def test_an_attachment_goes_with_its_hash(tmp_path: Path) -> None:
    with output(tmp_path / "a.mcap") as out:
        out.attach("spec.yaml", TEXT, START_NS, spec_hash="0123456789")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        (attached,) = reader.iter_attachments()
        (said,) = reader.iter_metadata()
    assert (attached.name, attached.data, attached.log_time) == ("spec.yaml", TEXT.encode(), START_NS)
    assert said.name == "vmf"
    assert said.metadata["attachment"] == "spec.yaml"
    assert said.metadata["sha256"] == hashlib.sha256(attached.data).hexdigest()
    assert said.metadata["spec_hash"] == "0123456789"


def test_what_is_copied_is_the_same_and_never_in_memory_as_a_whole(tmp_path: Path) -> None:
    random, size, n = np.random.default_rng(0), 100_000, 100
    with File(tmp_path / "a.mcap") as file:
        for i in range(n):
            picture = random.bytes(size)
            file.raw("/image", "an/Image", ("cdr", "ros2msg"), b"uint8[] data", picture, START_NS + i)
            file.raw("/none", "", ("json", ""), b"", b"{}", START_NS + i)
    tracemalloc.start()
    try:
        with output(tmp_path / "b.mcap") as out:
            for message in messages(tmp_path / "a.mcap", lambda topic: True):
                out.copy(message)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A message, its chunk, both compressed, in reading and in writing: some copies each, of 100 in the file.
    assert most < 16 * (size + CHUNK_BYTES) < n * size / 3
    a, b = (scan(tmp_path / name, lambda topic: True) for name in ("a.mcap", "b.mcap"))
    assert a.counts == b.counts
    assert a.messages == b.messages
    assert b.losses == b.repairs == ()


def test_nothing_is_left_of_a_recording_that_failed(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"old")
    with pytest.raises(ValueError, match="JSON"), output(tmp_path / "a.mcap") as out:
        out.json("/a", "a", "{}", float("nan"), 0)
    assert (tmp_path / "a.mcap").read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


def test_targets_that_cannot_be_written_to_are_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "is.mcap").mkdir()
    (tmp_path / "in.mcap").write_bytes(b"x")
    (tmp_path / "link.mcap").symlink_to("in.mcap")
    given = (tmp_path / "in.mcap",)
    for name, why in {
        "a.bag": "found a name without .mcap",
        "is.mcap": "is a directory",
        "in.mcap": "is the recording itself",
        "link.mcap": "is the recording itself",
        "none/a.mcap": "there is no directory",
    }.items():
        with pytest.raises(InputError, match=f"--mcap .*{name}: .*{why}"):
            check_target(tmp_path / name, "--mcap", given)
    check_target(tmp_path / "new.mcap", "--mcap", given)


def test_layers_differ_in_colour_and_shape_and_are_named() -> None:
    pixels = np.array([[10.0, 20.0, 5.0, 20.0], [np.nan, np.nan, 7.0, 8.0]])
    drawn = [Drawn(layer, ("a", "b"), pixels, f"note {i}") for i, layer in enumerate(LAYERS)]
    for camera, seen in enumerate(([[10.0, 20.0]], [[5.0, 20.0], [7.0, 8.0]])):
        found = image_annotations(drawn, camera, START_NS)
        colours = {(p.outline_color.r, p.outline_color.g, p.outline_color.b) for p in found.points}
        assert len(colours) == 3
        assert len({tuple(xy(p.points[:8]).ravel()) for p in found.points}) == 3
        dots, plus, cross = (xy(p.points) for p in found.points)
        np.testing.assert_array_equal(dots, np.array(seen) + 0.5)
        for lines in (plus, cross):
            np.testing.assert_allclose(lines.reshape(-1, 4, 2).mean(axis=1), np.array(seen) + 0.5, atol=1e-12)
        texts = [t.text for t in found.texts]
        legend = [f"{layer.name} note {i}" for i, layer in enumerate((OBSERVED, DESIRED, PREDICTED))]
        assert [t for t in texts if t not in ("a", "b")] == legend
        assert [t for t in texts if t in ("a", "b")] == (["a"] if camera == 0 else ["a", "b"])
        assert found.timestamp.ToNanoseconds() == START_NS
        stamps = {p.timestamp.ToNanoseconds() for p in (*found.points, *found.texts)}
        assert stamps == {START_NS}


@pytest.mark.parametrize("mounting", ["eye_in_hand", "eye_to_hand"])
@pytest.mark.parametrize("joints", [False, True])
def test_every_frame_is_shown_with_its_body_and_half_a_pixel_off(
    tmp_path: Path, mounting: str, joints: bool
) -> None:
    tracks, poses = example(mounting=mounting, joints=joints)
    write(tmp_path / "a.mcap", tracks, poses, mounting)
    found: dict[str, list[tuple[int, Any]]] = {}
    for topic, time, content in decoded(tmp_path / "a.mcap"):
        found.setdefault(topic, []).append((time, content))
    parent, child = ("world", "body") if mounting == "eye_in_hand" else ("base", "tool")
    T = tracks.E_S_from_W if mounting == "eye_to_hand" else inverse(tracks.E_S_from_W)
    bodies = found["/robot/transform"]
    assert [time for time, _ in bodies] == tracks.times_ns.tolist()
    assert {(m.parent_frame_id, m.child_frame_id) for _, m in bodies} == {(parent, child)}
    np.testing.assert_allclose([matrix(m) for _, m in bodies], T, atol=1e-14)
    for camera, side in enumerate(("left", "right")):
        shown = found[f"/stereo/{side}/annotations"]
        assert [m.timestamp.ToNanoseconds() for _, m in shown] == tracks.times_ns.tolist()
        for frame, (_, message) in enumerate(shown):
            pixels = tracks.pixels[tracks.frame == frame][:, 2 * camera : 2 * camera + 2]
            (dots,) = message.points
            np.testing.assert_array_equal(xy(dots.points), pixels[~np.isnan(pixels[:, 0])] + 0.5)


def test_cameras_are_written_so_that_points_project_to_their_pixels(tmp_path: Path) -> None:
    """The chain that a viewer follows: fixed frame, body, camera, K or P, distortion apart."""
    times, poses = moving_robot(3)
    R = R_CAMERA_FROM_BODY
    K = np.array([[400.0, 0.0, 310.0], [0.0, 410.0, 250.0], [0.0, 0.0, 1.0]])
    centres = np.array([0.1, 0.2, 0.3]), np.array([0.1, 0.2, 0.3]) + 0.12 * R[0]
    left, right = (Camera(K, (0.1, -0.02), (640, 480), from_rotation_translation(R.T, c)) for c in centres)
    tracks = from_dense(times, poses.motions("eye_in_hand"), np.full((3, 1, 4), np.nan))
    extras = Extras({}, (left, right))
    write(tmp_path / "a.mcap", tracks, poses, "eye_in_hand", extras=extras)
    last = {topic: content for topic, _, content in decoded(tmp_path / "a.mcap")}
    W_T_S = matrix(last["/robot/transform"])
    P_W = W_T_S @ np.array([3.0, 0.2, -0.1, 1.0])
    for side, centre in zip(("left", "right"), centres, strict=True):
        at = last[f"/stereo/{side}/transform"]
        assert (at.parent_frame_id, at.child_frame_id) == ("body", side)
        in_camera = inverse(W_T_S @ matrix(at)) @ P_W
        p = K @ R @ (np.array([3.0, 0.2, -0.1]) - centre)
        known = last[f"/stereo/{side}/calibration"]
        seen = np.array(known.K).reshape(3, 3) @ in_camera[:3]
        np.testing.assert_allclose(seen[:2] / seen[2], p[:2] / p[2], atol=1e-9)
        # P projects from the left camera's frame.
        in_left = inverse(W_T_S @ matrix(last["/stereo/left/transform"])) @ P_W
        seen = np.array(known.P).reshape(3, 4) @ in_left
        np.testing.assert_allclose(seen[:2] / seen[2], p[:2] / p[2], atol=1e-9)
        assert list(known.D) == [0.1, -0.02, 0.0, 0.0, 0.0]
        assert (known.width, known.height, known.frame_id) == (640, 480, side)


def test_a_pan_tilt_head_is_shown_as_a_body_that_turns(tmp_path: Path) -> None:
    poses = PanTiltJoints(np.array([0.3]), np.array([-0.2]))
    tracks = from_dense(np.array([START_NS]), poses.motions("eye_in_hand"), np.full((1, 1, 4), np.nan))
    write(tmp_path / "a.mcap", tracks, poses, "eye_in_hand")
    (body,) = [content for topic, _, content in decoded(tmp_path / "a.mcap") if topic == "/robot/transform"]
    np.testing.assert_allclose(matrix(body), inverse(tracks.E_S_from_W[0]), atol=1e-15)


def types(schema: Any) -> Iterator[object]:
    if isinstance(schema, dict):
        if "properties" in schema or "items" in schema or "type" in schema:
            yield schema.get("type")
        for value in schema.values():
            yield from types(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from types(value)


def test_json_schemas_give_one_type_each_as_foxglove_wants_them() -> None:
    found = list(types(json.loads(schemas.STEREO_TRACKS_TEXT)))
    assert len(found) > 10
    assert set(found) <= {"object", "array", "string", "number", "integer", "boolean"}
