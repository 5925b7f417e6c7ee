"""`vmf solve`: two views become one command, in every form, for every task and both mountings."""

from __future__ import annotations

import io
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from solved_scenes import Scene, as_targets, commas, no_command, stereo_tracks, trained
from vmf_command import record, vmf

from vmf.data import PanTiltJoints
from vmf.experiment import model_file
from vmf.geometry import from_quaternion
from vmf.solve import command
from vmf.spec import Data, PoseSource, Recording, TrackSource
from vmf.tasks import make_task

CASES = [
    ("pan_tilt", "eye_in_hand"),
    ("translation", "eye_in_hand"),
    ("planar", "eye_in_hand"),
    ("six_dof", "eye_in_hand"),
    ("translation", "eye_to_hand"),
    ("six_dof", "eye_to_hand"),
]
# Without noise, what is left (px) is where the learner's minimisation stops; a pixel moves no answer here by
# more than a metre or a radian.
EXACT = 1e-4
TRANSPORT = {"kind": "transport", "visited": "own"}


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def exact(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """A model that was trained without noise."""
    return trained(tmp_path_factory.mktemp("exact"), *request.param)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return trained(tmp_path_factory.mktemp("noisy"), "six_dof", noise_px=0.5)


@pytest.fixture(scope="module")
def tool(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Fixed cameras and a tool whose rotation is given."""
    folder = tmp_path_factory.mktemp("tool")
    return trained(folder, "six_dof", "eye_to_hand", solver={"known": "rotation"})


@pytest.fixture(scope="module")
def translating(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return trained(tmp_path_factory.mktemp("translating"), "translation", noise_px=0.5)


def pose_of(answer: dict) -> np.ndarray:
    pose = answer["command"]["pose"]
    return from_quaternion(pose["position_m"], pose["quaternion_xyzw"])


def test_the_true_motion_and_command_come_out(exact: Scene) -> None:
    answer = exact.solve(*exact.targets, *exact.here)
    assert (answer["status"], answer["reason"]) == ("ok", "converged")
    E = np.array(answer["motion"]["E_desired_from_initial"])
    np.testing.assert_allclose(E, exact.truth, atol=EXACT)
    assert answer["residual_px"] < EXACT
    poses = exact.simulation.poses
    if isinstance(poses, PanTiltJoints):
        joints = answer["command"]["joints"]
        expected = [poses.pan_rad[exact.GOAL], poses.tilt_rad[exact.GOAL]]
        np.testing.assert_allclose([joints["pan_rad"], joints["tilt_rad"]], expected, atol=EXACT)
        assert answer["command"]["pose"] is None
    else:
        assert answer["command"]["joints"] is None
        np.testing.assert_allclose(pose_of(answer), exact.pose(exact.GOAL), atol=EXACT)
        T = command(exact.pose(exact.START), E, answer["mounting"])
        np.testing.assert_allclose(pose_of(answer), T, atol=1e-12)


@pytest.mark.parametrize(("task", "mounting"), CASES)
def test_other_learners_find_it_too(tmp_path: Path, task: str, mounting: str) -> None:
    scene = trained(tmp_path, task, mounting, learner=TRANSPORT)
    answer = scene.solve(*scene.targets, *scene.here)
    np.testing.assert_allclose(answer["motion"]["E_desired_from_initial"], scene.truth, atol=EXACT)


def test_the_unknowns_are_the_tasks_own(exact: Scene) -> None:
    answer = exact.solve(*exact.targets, *exact.here)
    task = make_task(answer["task"])
    motion = answer["motion"]
    assert tuple((u["name"], u["unit"]) for u in motion["unknowns"]) == task.components
    p = np.array([u["value"] for u in motion["unknowns"]])
    E_initial = exact.simulation.tracks.E_S_from_W[exact.START]
    np.testing.assert_allclose(task.motion(p, E_initial), motion["E_desired_from_initial"], atol=1e-12)
    assert motion["covariance"]["components"] == [name for name, _ in task.components]
    std = [u["std"] for u in motion["unknowns"]]
    np.testing.assert_allclose(std, np.sqrt(np.diag(motion["covariance"]["matrix"])), rtol=1e-12)
    assert motion["distance_m"] == pytest.approx(np.linalg.norm(exact.truth[:3, 3]), abs=EXACT)


def test_without_a_pose_the_motion_alone_is_given(exact: Scene) -> None:
    if isinstance(exact.simulation.poses, PanTiltJoints):
        said = vmf("solve", exact.run, *exact.targets)
        said.refused("pan_tilt: the present tilt is missing", "--joints PAN,TILT or --pose")
        return
    relative = exact.solve(*exact.targets)
    absolute = exact.solve(*exact.targets, *exact.here)
    assert relative["command"] is None
    assert {**absolute, "command": None} == relative


def test_a_pan_tilt_head_may_report_its_pose(tmp_path: Path) -> None:
    scene = trained(tmp_path, "pan_tilt")
    poses = scene.simulation.poses
    assert isinstance(poses, PanTiltJoints)
    # W_T_S of the head, standing somewhere in the world.
    W_R_S = np.swapaxes(scene.simulation.E_true[:, :3, :3], 1, 2)
    q = Rotation.from_matrix(W_R_S).as_quat()
    by_pose = scene.solve(*scene.targets, "--pose", commas([1.0, 2.0, 3.0, *q[scene.START]]))
    by_joints = scene.solve(*scene.targets, "--joints", scene.joints_argument())
    assert by_pose["motion"]["unknowns"][0]["value"] == pytest.approx(
        by_joints["motion"]["unknowns"][0]["value"], abs=1e-9
    )
    joints = by_pose["command"]["joints"]
    assert joints["tilt_rad"] == pytest.approx(poses.tilt_rad[scene.GOAL], abs=EXACT)
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = W_R_S[scene.GOAL], [1.0, 2.0, 3.0]
    np.testing.assert_allclose(pose_of(by_pose), expected, atol=EXACT)


def test_arguments_files_and_standard_input_say_the_same(
    noisy: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_arguments = vmf("solve", noisy.run, *noisy.targets, *noisy.here)
    assert by_arguments.code == 0
    views, pose = noisy.views, [float(v) for v in noisy.pose_argument().split(",")]
    ros = {
        "position": dict(zip("xyz", pose[:3], strict=True)),
        "orientation": dict(zip("xyzw", pose[3:], strict=True)),
    }
    codes = {name: noisy.dense[i].tolist() for name, i in (("initial", 3), ("desired", 17))}
    files = {
        "whole.json": json.dumps({**views, "pose": pose}),
        "whole.yaml": yaml.safe_dump({**views, "pose": ros}),
        "codes.yaml": yaml.safe_dump({**codes, "pose": pose}),
        "initial.json": json.dumps(views["initial"]),
        "desired.yaml": yaml.safe_dump(codes["desired"]),
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    asked = [
        ["--file", "whole.json"],
        ["--file", "whole.yaml"],
        ["--file", "codes.yaml"],
        ["--file", "codes.yaml", *noisy.here],
        ["--initial", "initial.json", "--desired", "desired.yaml", *noisy.here],
    ]
    for arguments in asked:
        assert vmf("solve", noisy.run, *arguments) == by_arguments, arguments
    piped = [
        (["--file", "-"], "whole.yaml"),
        (["--initial", "-", "--desired", "desired.yaml", *noisy.here], "initial.json"),
    ]
    for arguments, name in piped:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(files[name].encode())))
        assert vmf("solve", noisy.run, *arguments) == by_arguments, arguments


def test_the_command_line_beats_the_file(noisy: Scene, tmp_path: Path) -> None:
    path = tmp_path / "views.yaml"
    path.write_text(yaml.safe_dump({**noisy.views, "pose": [9, 9, 9, 0, 0, 0, 1]}))
    assert noisy.solve("--file", path, *noisy.here) == noisy.solve(*noisy.targets, *noisy.here)


def test_a_run_its_link_and_its_model_are_the_same(noisy: Scene) -> None:
    said = vmf("solve", noisy.run, *noisy.targets)
    for path in (noisy.run.parent / "latest", noisy.run / "model.npz"):
        assert vmf("solve", path, *noisy.targets) == said


def test_targets_are_matched_by_id_in_any_order(noisy: Scene, tmp_path: Path) -> None:
    ids = ("a", "b", "c", "d")
    initial, desired = noisy.dense[noisy.START], noisy.dense[noisy.GOAL]
    order = [2, 0, 3, 1]
    views = {
        "initial": stereo_tracks(np.vstack([initial, initial[:1]]), (*ids, "here only")),
        "desired": stereo_tracks(
            np.vstack([desired[:1], desired[order]]), ("there only", *(ids[i] for i in order))
        ),
    }
    path = tmp_path / "views.yaml"
    path.write_text(yaml.safe_dump(views))
    said = vmf("solve", noisy.run, "--file", path, "--format", "json")
    answer = json.loads(said.out)
    assert answer["motion"] == noisy.solve(*noisy.targets)["motion"]
    assert [target["id"] for target in answer["targets"]] == list(ids)
    assert answer["unused"] == ["here only", "there only"]
    for name in answer["unused"]:
        assert f"note: target {name} is in one view only and was not used" in said.err


def test_a_target_seen_by_one_camera_of_a_view_still_counts(exact: Scene) -> None:
    initial, desired = exact.dense[[exact.START, exact.GOAL]]
    initial[0, 2:] = desired[1, :2] = np.nan
    answer = exact.solve(*as_targets(initial, desired), *exact.here)
    np.testing.assert_allclose(answer["motion"]["E_desired_from_initial"], exact.truth, atol=EXACT)
    # What the other camera would see may be anywhere.
    assert answer["targets"][0]["initial_outside_px"] == pytest.approx(0.0, abs=1e-6)
    assert answer["targets"][0]["desired_outside_px"] == 0.0
    assert answer["targets"][1]["desired_outside_px"] == pytest.approx(0.0, abs=1e-6)


def test_a_pixel_of_one_camera_far_outside_is_refused(noisy: Scene) -> None:
    initial, desired = noisy.dense[[noisy.START, noisy.GOAL]]
    desired[1] = 5000.0, 85.0, np.nan, np.nan
    said = vmf("solve", noisy.run, *as_targets(initial, desired), *noisy.here)
    assert said.code == 2
    assert "outside the region of trained codes in the desired view" in said.err


def test_json_and_yaml_have_the_same_content(noisy: Scene) -> None:
    as_yaml = vmf("solve", noisy.run, *noisy.targets, *noisy.here)
    assert yaml.safe_load(as_yaml.out) == noisy.solve(*noisy.targets, *noisy.here)


def test_pose_stamped_is_what_ros_publishes(noisy: Scene) -> None:
    answer = noisy.solve(*noisy.targets, *noisy.here)["command"]["pose"]
    said = vmf("solve", noisy.run, *noisy.targets, *noisy.here, "--format", "pose_stamped")
    message = yaml.safe_load(said.out)
    assert message.keys() == {"header", "pose"}
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "world"}
    assert list(message["pose"]["position"].values()) == answer["position_m"]
    assert list(message["pose"]["orientation"].values()) == answer["quaternion_xyzw"]
    assert list(message["pose"]["position"]) == ["x", "y", "z"]
    assert list(message["pose"]["orientation"]) == ["x", "y", "z", "w"]
    # ROS refuses a whole number for a float64.
    for part in message["pose"].values():
        assert all(type(value) is float for value in part.values())
    assert np.linalg.norm(answer["quaternion_xyzw"]) == pytest.approx(1.0, abs=1e-12)


def test_pose_with_covariance_stamped_has_36_numbers_in_ros_order(noisy: Scene) -> None:
    answer = noisy.solve(*noisy.targets, *noisy.here)["command"]["pose"]
    style = "pose_with_covariance_stamped"
    said = vmf("solve", noisy.run, *noisy.targets, *noisy.here, "--format", style, "--frame-id", "map")
    message = yaml.safe_load(said.out)
    assert message["header"]["frame_id"] == "map"
    assert message["pose"].keys() == {"pose", "covariance"}
    assert list(message["pose"]["pose"]["position"].values()) == answer["position_m"]
    covariance = np.reshape(message["pose"]["covariance"], (6, 6))
    np.testing.assert_array_equal(covariance, answer["covariance"]["matrix"])
    assert answer["covariance"]["components"] == ["x", "y", "z", "rot_x", "rot_y", "rot_z"]
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_the_frame_of_eye_to_hand_commands_is_the_base(tool: Scene) -> None:
    rotation = ("--orientation", commas(tool.simulation.poses.quaternion_xyzw[tool.GOAL]))
    answer = tool.solve(*tool.targets, *tool.here, *rotation)
    assert answer["command"]["pose"]["frame_id"] == "base"


def test_the_frame_of_a_recordings_poses_is_that_of_the_command(noisy: Scene, tmp_path: Path) -> None:
    model = model_file.load(noisy.run / "model.npz")
    pose, tracks = PoseSource(topic="/pose", parent="/map"), TrackSource(topic="/tracks")
    data = Data(recording=Recording(path="x.mcap", pose=pose, tracks=tracks))
    spec = model.spec.model_copy(update={"data": data})
    model_file.save(tmp_path / "model.npz", model_file.Model(spec, model.learner))
    said = vmf("solve", tmp_path / "model.npz", *noisy.targets, *noisy.here, "--format", "pose_stamped")
    assert yaml.safe_load(said.out)["header"]["frame_id"] == "map"


def test_the_answer_goes_to_a_file(noisy: Scene, tmp_path: Path) -> None:
    path = tmp_path / "motion.yaml"
    said = vmf("solve", noisy.run, *noisy.targets, "-o", path)
    assert (said.code, said.out) == (0, "")
    assert path.read_text() == vmf("solve", noisy.run, *noisy.targets).out
    vmf("solve", noisy.run, *noisy.targets, "-o", tmp_path / "no" / "file").refused("cannot be written")


def test_a_given_rotation_by_motion_or_by_goal_is_the_same(tool: Scene) -> None:
    motion = rotation_of(tool)
    goal = commas(tool.simulation.poses.quaternion_xyzw[tool.GOAL])
    # One target suffices where the rotation is known.
    one = tool.targets[:2]
    by_motion = tool.solve(*one, *tool.here, "--rotation", motion)
    by_goal = tool.solve(*one, *tool.here, "--orientation", goal)
    for answer in (by_motion, by_goal):
        np.testing.assert_allclose(pose_of(answer), tool.pose(tool.GOAL), atol=EXACT)
        unknowns = answer["motion"]["unknowns"]
        assert [u["given"] for u in unknowns] == [True] * 3 + [False] * 3
        assert [u["std"] for u in unknowns[:3]] == [0.0] * 3
    relative = tool.solve(*one, "--rotation", motion)
    assert relative["command"] is None
    np.testing.assert_allclose(relative["motion"]["E_desired_from_initial"], tool.truth, atol=EXACT)


def test_a_given_rotation_is_asked_for_and_refused_where_it_has_no_meaning(
    tool: Scene, noisy: Scene, translating: Scene
) -> None:
    turn = ("--rotation", "0,0,0,1")
    vmf("solve", tool.run, *tool.targets).refused("rotation: missing", "--rotation", "--orientation")
    vmf("solve", tool.run, *tool.targets, "--orientation", "0,0,0,1").refused("without the present pose")
    vmf("solve", tool.run, *tool.targets, *turn, "--orientation", "0,0,0,1").refused("both rotation and")
    vmf("solve", noisy.run, *noisy.targets, *turn).refused("rotation: found", "solver.known=rotation")
    vmf("solve", translating.run, *translating.targets, "solver.known=rotation").refused("no meaning for")
    # An override makes it given.
    answer = noisy.solve("solver.known=rotation", *noisy.targets, "--rotation", rotation_of(noisy))
    assert answer["motion"]["unknowns"][0]["given"] is True


def rotation_of(scene: Scene) -> str:
    return commas(Rotation.from_matrix(scene.truth[:3, :3]).as_quat())


def test_what_the_trained_model_is_cannot_change(noisy: Scene) -> None:
    vmf("solve", noisy.run, "task=planar", *noisy.targets).refused("a trained model cannot change this")
    vmf("solve", noisy.run, "evaluate.queries=3", *noisy.targets).refused("accepted: solver.…")
    left = noisy.solve("solver.cameras=left", *noisy.targets)
    assert left["motion"] != noisy.solve(*noisy.targets)["motion"]


def outside_views(scene: Scene) -> list[str]:
    """The question with target 3 moved up by 1400 px in the initial view."""
    initial, desired = scene.dense[[scene.START, scene.GOAL]]
    initial[2, [1, 3]] -= 1400.0
    return as_targets(initial, desired)


def test_a_code_outside_the_trained_region_is_refused_with_its_distance(noisy: Scene) -> None:
    said = vmf("solve", noisy.run, *outside_views(noisy), *noisy.here)
    line = said.refused("target 3 lies ", " px outside the region of trained codes in the initial view")
    far = float(line.split("lies ")[1].split(" px")[0])
    # Both y move by 1400 px, from somewhere inside an image of 480.
    assert 1400 * np.sqrt(2) - 480 * np.sqrt(2) < far < 1400 * np.sqrt(2)
    for style in ("json", "pose_stamped"):
        no_command(vmf("solve", noisy.run, *outside_views(noisy), *noisy.here, "--format", style), 2)


def test_anyway_asks_all_the_same_and_says_so(noisy: Scene) -> None:
    said = vmf("solve", noisy.run, *outside_views(noisy), "--anyway", "--format", "json")
    assert "note: target 3 lies " in said.err
    answer = json.loads(said.out)
    assert said.code == (3 if answer["motion"] is None else 0)
    assert [t["initial_outside_px"] > 0 for t in answer["targets"]] == [False, False, True, False]
    assert any("target 3 lies" in note for note in answer["notes"])


def test_a_code_an_approximator_never_saw_is_refused(tmp_path: Path) -> None:
    scene = trained(
        tmp_path,
        "translation",
        learner={"kind": "transport", "visited": "own"},
        approximator={"kind": "none"},
    )
    assert scene.solve(*scene.targets)["status"] == "ok"
    initial, desired = scene.dense[[scene.START, scene.GOAL]]
    unseen = as_targets(initial + 0.25, desired)
    said = vmf("solve", scene.run, *unseen)
    assert (said.code, said.out) == (2, "")
    assert said.err.splitlines()[0].startswith("target 1 has a code without learned parameters (support 0)")
    assert len(said.err.splitlines()) == 4
    no_command(
        vmf("solve", scene.run, *unseen, "--anyway"), 3, "refused: no parameters for these stereo codes"
    )


@pytest.mark.parametrize("style", ["yaml", "json", "pose_stamped", "pose_with_covariance_stamped"])
def test_no_motion_is_no_command_and_exit_code_3(noisy: Scene, tmp_path: Path, style: str) -> None:
    path = tmp_path / "command"
    path.write_text("as it was")
    arguments = ["solve", noisy.run, *noisy.targets[:4], *noisy.here, "--format", style]
    said = vmf(*arguments)
    no_command(said, 3, "refused: too few targets or equations for the unknowns; there is no command")
    assert bool(said.out) == (style in ("yaml", "json"))
    to_file = vmf(*arguments, "-o", path)
    assert (to_file.code, to_file.out) == (3, "")
    if style in ("yaml", "json"):
        assert path.read_text() == said.out
    else:
        assert path.read_text() == "as it was"


CODE = "300,200,250,200"
WRONG = [
    ([], "views: found nothing", "--target"),
    (["--target", f"{CODE}:{CODE}", "--file", "x"], "views: found several of these"),
    (["--target", CODE], "found 1 of 2 views"),
    (["--target", f"{CODE}:{CODE}:{CODE}"], "found 3 of 2 views"),
    (["--target", f"300,200,250:{CODE}"], "initial.0: found [300, 200, 250]", "a list of 4"),
    (["--target", f"{CODE}:300,nan,250,200"], "desired.0.1: found 'nan'", "a number"),
    (["--target", f"{CODE}:300,.inf,250,200"], "desired.0.1: found .inf", "a finite number"),
    (["--target", f"{CODE}:300,1e12,250,200"], "found 1e+12", "1e+09"),
    (["--target", f"{CODE}:300,-,250,200"], "half a pixel"),
    (["--target", f"{CODE}:300,,250,200"], "desired.0.1: found ''"),
    (["--target", f"-,-,-,-:{CODE}"], "no target is in both", "initial shows none, desired shows 1"),
    (["--initial", "x"], "--desired: missing"),
    (["--initial", "-", "--desired", "-"], "standard input is one view"),
    (["--file", "none.yaml"], "none.yaml: no such file", "views in YAML or JSON"),
    (["--file", "."], "a directory"),
]


@pytest.mark.parametrize("arguments", WRONG, ids=lambda a: " ".join(a[0])[:40])
def test_wrong_views_are_one_line(noisy: Scene, arguments: tuple[list[str], str]) -> None:
    given, *parts = arguments
    vmf("solve", noisy.run, *given).refused(*parts)


@pytest.mark.parametrize(
    ("option", "parts"),
    [
        (("--pose", "0,0,0"), ("--pose 0,0,0: pose: found [0, 0, 0]", "a list of 7")),
        (("--pose", "0,0,0,0,0,0,2"), ("quaternion of norm 2", "1 within 0.001")),
        (("--pose", "a,0,0,0,0,0,1"), ("pose.0: found 'a'",)),
        (("--pose", "-,0,0,0,0,0,1"), ("pose.0: found -",)),
        (("--joints", "0,0"), ("joints: found", "pan_tilt")),
        (("--format", "xml"), ("--format: found 'xml'", "yaml, json, pose_stamped")),
        (("--format", "pose_stamped"), ("needs the present one, --pose is missing",)),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_options_are_one_line(noisy: Scene, option: tuple[str, ...], parts: tuple[str, ...]) -> None:
    vmf("solve", noisy.run, *noisy.targets, *option).refused(*parts)


TRACKS = "tracks: [{id: 1, left: [1, 2], right: [3, 2]}]"
BROKEN = [
    ("", "empty"),
    ("[1, 2]", "1:1: found no mapping"),
    ("initial: [", "not valid YAML"),
    (f"initial: {{{TRACKS}}}", "desired: missing"),
    (f"initial: {{{TRACKS}}}\ndesird: {{{TRACKS}}}", "2:1: desird: unknown key, did you mean desired?"),
    (f"initial: {{{TRACKS}}}\ndesired: {{trakcs: []}}", "2:11: desired.trakcs", "did you mean tracks?"),
    (f"initial: {{{TRACKS}}}\ndesired: 5", "2:10: desired: found 5"),
    (
        f"initial: {{{TRACKS}}}\ndesired: {{{TRACKS.replace('id: 1', 'id: 2')}}}",
        "initial shows 1, desired shows 2",
    ),
    (f"initial: {{{TRACKS}}}\ndesired: {{{TRACKS.replace('[1, 2]', '[1, NaN]')}}}", "left.1: found 'NaN'"),
    (f"initial: {{{TRACKS}}}\ndesired: {{{TRACKS.replace('[1, 2]', '[1]')}}}", "left: found [1]"),
    (f"initial: {{{TRACKS}}}\ndesired: {{{TRACKS[:-1]}, {{id: '1'}}]}}", "target 1 is given twice"),
    (f"initial: {{{TRACKS}}}\ndesired: {{{TRACKS}}}\npose: [1, 2, 3]", "3:7: pose: found [1, 2, 3]"),
    (
        f"initial: {{{TRACKS}}}\ndesired: {{{TRACKS}}}\npose: [0, 0, 0, 0, 0, 0, 1]\njoints: [0, 0]",
        "both pose and joints",
    ),
]


@pytest.mark.parametrize(("text", "parts"), [(b[0], b[1:]) for b in BROKEN], ids=[b[1] for b in BROKEN])
def test_wrong_files_are_one_line_with_the_place(
    noisy: Scene, tmp_path: Path, text: str, parts: tuple[str, ...]
) -> None:
    path = tmp_path / "views.yaml"
    path.write_text(text)
    vmf("solve", noisy.run, "--file", path).refused(*parts)


def test_several_mistakes_are_told_at_once(noisy: Scene, tmp_path: Path) -> None:
    path = tmp_path / "views.yaml"
    path.write_text(f"initial: {{{TRACKS}}}\ndesired: 5\n")
    said = vmf("solve", noisy.run, "--file", path, "--pose", "1,2")
    assert said.code == 2
    assert [line.split(": ")[0] for line in said.err.splitlines()] == [f"{path}:2:10", "--pose 1,2"]


def test_what_is_no_text_is_refused(noisy: Scene, tmp_path: Path) -> None:
    path = tmp_path / "views.yaml"
    path.write_bytes(b"initial: \xff")
    vmf("solve", noisy.run, "--file", path).refused(f"{path}:1:10: found byte 0xff")
    path.write_bytes(b"#" * 1_000_001)
    vmf("solve", noisy.run, "--file", path).refused(f"{path}: larger than 1000000 bytes")


def test_what_is_no_model_is_refused(noisy: Scene, tmp_path: Path) -> None:
    def ask(path: Path, *parts: str) -> None:
        vmf("solve", path, *noisy.targets).refused(*parts)

    ask(tmp_path / "none", "no such file")
    ask(tmp_path, "no run.json here")
    run = Path(shutil.copytree(noisy.run, tmp_path / "run"))
    (run / "model.npz").write_bytes((run / "model.npz").read_bytes()[:-100])
    ask(run, "not a readable model.npz")
    (run / "model.npz").unlink()
    ask(run, "model.npz: no such file")
    (run / "run.json").write_text(json.dumps({**record(noisy.run), "status": "running"}))
    ask(run, "status running, a finished run is expected")


def test_a_model_that_learned_nothing_says_why(tmp_path: Path) -> None:
    spec = {"simulate": {"frames": 3, "targets": 1}}
    scene = trained(tmp_path, "six_dof", code=3, data=spec)
    line = vmf("solve", scene.run, "--target", f"{CODE}:{CODE}").refused(
        "none of the codes it was trained with"
    )
    assert "too few" in line
