"""`vmf track`, and training on images without it: the whole chain from pixels to motions."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_edits import at, copy
from vmf_command import errors, record, same_results, summary, train, vmf

from vmf.data.images import StereoImages
from vmf.data.recording import describe, read
from vmf.data.tracks import Tracks
from vmf.spec import ImageSource, PoseSource, Recording, TrackSource

LEFT, RIGHT = "/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed"
# Slowly filmed, so that few frames show much motion.
SIMULATE = {"frames": 24, "targets": 4, "motion": "hand_guided", "rate_hz": 10.0, "seed": 4}
EVALUATE = {"protocol": ["held_out"], "gaps": [3], "bootstrap": 20, "train_fraction": 0.7}


def spec_file(folder: Path, name: str, data: dict[str, object], **more: object) -> Path:
    path = folder / f"{name}.yaml"
    document = {"task": "six_dof", "data": data, "evaluate": EVALUATE, **more}
    path.write_text(yaml.safe_dump(document))
    return path


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of images of tags, with the true pixels of their corners."""
    folder = tmp_path_factory.mktemp("film")
    spec = spec_file(folder, "film", {"simulate": {**SIMULATE, "images": {"targets": "tag"}}})
    said = vmf("simulate", spec, "-o", folder / "film.mcap", "--images", "--quiet")
    assert (said.code, said.err) == (0, "")
    return folder / "film.mcap"


def track(source: Path, output: Path, *arguments: object, code: int = 0) -> dict[str, object]:
    said = vmf("track", source, "-o", output, "--json", "--quiet", *arguments)
    assert said.code == code, said
    return dict(json.loads(said.out))


def source(path: Path, **more: object) -> dict[str, object]:
    return {"path": str(path), "pose": {"topic": "/robot/pose"}, **more}


def test_a_film_holds_images_poses_and_the_truth(filmed: Path) -> None:
    info = describe(filmed)
    topics = {t.name: (t.schema, t.count) for t in info.topics}
    image = "sensor_msgs/msg/CompressedImage"
    assert topics == {
        "/stereo/left/transform": ("foxglove.FrameTransform", 1),
        "/stereo/right/transform": ("foxglove.FrameTransform", 1),
        "/stereo/left/calibration": ("foxglove.CameraCalibration", 1),
        "/stereo/right/calibration": ("foxglove.CameraCalibration", 1),
        "/robot/transform": ("foxglove.FrameTransform", 24),
        "/stereo/left/annotations": ("foxglove.ImageAnnotations", 24),
        "/stereo/right/annotations": ("foxglove.ImageAnnotations", 24),
        "/robot/pose": ("geometry_msgs/msg/PoseStamped", 24),
        "/stereo/true_tracks": ("vmf.StereoTracks", 24),
        LEFT: (image, 24),
        RIGHT: (image, 24),
    }
    assert info.attachments == ("spec.yaml",)
    assert info.losses == ()
    pairs = list(StereoImages(filmed, ImageSource()).pairs(grey=False))
    assert {p.left.shape for p in pairs if p is not None} == {(480, 640, 3)}


def test_the_tracks_of_a_film_are_near_the_truth(filmed: Path, tmp_path: Path) -> None:
    told = track(filmed, tmp_path / "t.mcap", "--tracker", "aruco")
    assert (told["pairs"], told["frames"], told["losses"]) == (24, 24, [])
    assert told["copied"] == ["/robot/pose"]
    tracks, true = (
        read(
            Recording(path=str(p), pose=PoseSource(topic="/robot/pose"), tracks=TrackSource(topic=topic)),
            "eye_in_hand",
            tmp_path,
        ).tracks
        for p, topic in ((tmp_path / "t.mcap", "/stereo/tracks"), (filmed, "/stereo/true_tracks"))
    )
    np.testing.assert_array_equal(tracks.E_S_from_W, true.E_S_from_W)
    number = [true.ids.index(name) for name in tracks.ids]
    dense = np.full((true.n_frames, true.n_targets, 4), np.nan)
    dense[true.frame, true.target] = true.pixels
    off = np.abs(tracks.pixels - dense[tracks.frame, np.array(number)[tracks.target]])
    assert np.nanmedian(off) < 0.3
    assert told["seen_both"] == np.isfinite(tracks.pixels).all(axis=1).sum()
    assert len(tracks.pixels) > 200


def test_the_output_says_how_it_was_made_and_carries_quality(filmed: Path, tmp_path: Path) -> None:
    track(filmed, tmp_path / "t.mcap", "ids=[0, 2]", "--tracker", "aruco")
    with (tmp_path / "t.mcap").open("rb") as file:
        reader = make_reader(file)
        (attached,) = reader.iter_attachments()
        made = yaml.safe_load(attached.data)
        messages = [json.loads(m.data) for _, c, m in reader.iter_messages() if c.topic == "/stereo/tracks"]
    assert attached.name == "track.yaml"
    assert made["source"]["sha256"] == describe(filmed).sha256
    assert made["images"]["left"] == LEFT
    assert made["images"]["tracker"]["ids"] == [0, 2]
    ImageSource.model_validate(made["images"])
    seen = [t for m in messages for t in m["tracks"]]
    assert {t["id"] for t in seen} <= {f"{k}/{c}" for k in (0, 2) for c in range(4)}
    assert all(0.5 <= t["quality"] <= 1.0 for t in seen)
    assert all(m["left_size"] == m["right_size"] == [640, 480] for m in messages)


def test_training_from_images_is_training_from_their_tracks_bit_for_bit(filmed: Path, tmp_path: Path) -> None:
    track(filmed, tmp_path / "t.mcap", "--tracker", "aruco")
    tracked = spec_file(
        tmp_path, "tracked", {"recording": source(tmp_path / "t.mcap", tracks={"topic": "/stereo/tracks"})}
    )
    images = spec_file(
        tmp_path, "images", {"recording": source(filmed, images={"tracker": {"kind": "aruco"}})}
    )
    a, b = (train(spec, tmp_path) for spec in (tracked, images))
    assert (errors(a)["status"] == "ok").sum() > 0
    assert same_results(a, b)
    # What was learned is right: the motions it answers are much smaller than the robot's.
    mine = summary(b).set_index(["method", "component"])["median"]
    assert mine["vmf", "distance"] < 0.1 * mine["no_motion", "distance"]
    assert mine["vmf", "angle"] < 0.1 * mine["no_motion", "angle"]
    assert list(record(b)["inputs"]) == [str(filmed)]
    said = vmf("evaluate", b, "--json", "--quiet", "evaluate.gaps=[2]", "evaluate.bootstrap=20")
    assert said.code == 0
    assert (errors(said.run)["status"] == "ok").any()


def test_a_sweep_takes_images_as_train_does(filmed: Path, tmp_path: Path) -> None:
    images = spec_file(
        tmp_path, "images", {"recording": source(filmed, images={"tracker": {"kind": "aruco"}})}
    )
    texts = ("data.recording.images.tracker.ids=[0,1],[0,1,2]", "evaluate.gaps=[2],[3]")
    said = vmf("sweep", images, *texts, "--out", tmp_path, "--jobs", 2, "--json", "--quiet")
    assert said.code == 0, said
    assert [point["status"] for point in json.loads(said.out)["points"]] == ["done"] * 4
    run = train(images, tmp_path, "data.recording.images.tracker.ids=[0,1]", "evaluate.gaps=[2]")
    point = tmp_path / "images-sweep" / run.name.split("-")[0]
    assert same_results(run, point)
    assert (run / "model.npz").read_bytes() == (point / "model.npz").read_bytes()
    ours, theirs = record(point), record(run)
    assert [ours[key] for key in ("inputs", "losses")] == [theirs[key] for key in ("inputs", "losses")]


def test_cameras_named_in_a_spec_may_be_left_out_or_wrong(filmed: Path, tmp_path: Path) -> None:
    images = {"left": "/stereo/lft", "tracker": {"kind": "aruco"}}
    spec = spec_file(tmp_path, "wrong", {"recording": source(filmed, images=images)})
    said = vmf("train", spec, "--out", tmp_path)
    said.refused(str(filmed), "no topic /stereo/lft", LEFT)


def test_damaged_images_are_lost_and_counted(filmed: Path, tmp_path: Path) -> None:
    broken = copy(
        filmed,
        tmp_path / "broken.mcap",
        edits={LEFT: at(3, lambda data: data[: len(data) // 2]), RIGHT: lambda i, d: [] if i == 9 else [d]},
    )
    told = track(broken, tmp_path / "t.mcap", "--tracker", "aruco", code=3)
    assert (told["pairs"], told["frames"]) == (23, 22)
    said = vmf("track", broken, "-o", tmp_path / "t.mcap", "--tracker", "aruco", "--quiet")
    assert said.code == 3
    lost = [line for line in said.err.splitlines() if line.startswith("lost: ")]
    assert len(lost) == len(told["losses"]) == 2
    assert f"lost: {LEFT}: images without a partner on {RIGHT} within 0.01 s dropped (1)" in lost
    assert any("damaged images dropped; first: image file is truncated" in line for line in lost)
    assert "22 frames of /stereo/tracks" in said.out


def test_a_cut_recording_gives_what_is_left_of_it(filmed: Path, tmp_path: Path) -> None:
    data = filmed.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    told = track(tmp_path / "cut.mcap", tmp_path / "t.mcap", "--tracker", "aruco", code=3)
    assert 8 <= told["frames"] < 20
    assert any("file ends" in loss for loss in told["losses"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--tracker", "arucco"], ["--tracker: found 'arucco', accepted: meanshift, camshift, klt"]),
        (["--tracker", "aruco", "idz=[9]"], ["idz", "did you mean ids?"]),
        (["--tracker", "aruco", "dictionary=4x4"], ["dictionary", "4x4_50"]),
        (["corners=0"], ["corners", "found 0"]),
        (["corners=99999999999999999999"], ["corners", "10000"]),
        (["spacing_px=1e12"], ["spacing_px", "16384"]),
        (["--tracker", "sift", "features=3000000000"], ["features", "10000"]),
        (["--tracker", "meanshift", "--region", "100,100,1e9,20"], ["region", "16384"]),
        (
            ["--tracker", "aruco", "--region", "1,2,3,4"],
            ["--region", "is for meanshift, camshift, klt, sift"],
        ),
        *(
            (
                ["--tracker", kind, "--region", "640,10,20,30"],
                ["region 640,10,20,30: lies outside of the 640x480 image"],
            )
            for kind in ("klt", "sift", "meanshift", "camshift")
        ),
        (["--region=-30,10,20,30"], ["region -30,10,20,30: lies outside"]),
        (["--region", "1,2,3"], ["--region: found '1,2,3', x,y,width,height"]),
        (["--region", "1,2,3,nan"], ["--region"]),
        (["--region", "1,2,3,-4"], ["regions.0.3"]),
        (["epipolar_px=0.001"], ["epipolar_px", "0.01"]),
        (["--pair-tolerance-s", "inf"], ["--pair-tolerance-s: found inf", "finite"]),
        (["--pair-tolerance-s", "1e18"], ["--pair-tolerance-s: found 1e+18", "3600"]),
        (["--left", "/nowhere"], ["no topic /nowhere"]),
        (["--tracker", "chessboard"], ["chessboard found no target in any of 24 stereo pairs"]),
    ],
)
def test_wrong_input_is_one_line(
    filmed: Path, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    vmf("track", filmed, "-o", tmp_path / "t.mcap", "--quiet", *arguments).refused(*words)
    assert list(tmp_path.iterdir()) == []


def test_the_output_must_be_another_recording(filmed: Path, tmp_path: Path) -> None:
    vmf("track", filmed, "-o", tmp_path / "t.bag").refused("found a name without .mcap")
    vmf("track", filmed, "-o", filmed).refused("is the recording itself")
    vmf("track", tmp_path / "none.mcap", "-o", tmp_path / "t.mcap").refused("no such file")
    vmf("track", filmed, "-o", tmp_path / "no" / "t.mcap", "--quiet").refused("cannot be written")


def test_a_recording_without_images_says_what_it_has(tmp_path: Path) -> None:
    spec = spec_file(tmp_path, "a", {"simulate": {"frames": 5}})
    vmf("simulate", spec, "-o", tmp_path / "a.mcap")
    vmf("track", tmp_path / "a.mcap", "-o", tmp_path / "t.mcap").refused(
        "no two image topics", "/stereo/tracks (vmf.StereoTracks)"
    )


def test_a_region_on_the_command_line_is_the_target(tmp_path: Path) -> None:
    simulated = {**SIMULATE, "frames": 8, "images": {"targets": "blob"}}
    spec = spec_file(tmp_path, "blobs", {"simulate": simulated})
    vmf("simulate", spec, "-o", tmp_path / "blobs.mcap", "--images", "--quiet")
    where = Recording(
        path=str(tmp_path / "blobs.mcap"),
        pose=PoseSource(topic="/robot/pose"),
        tracks=TrackSource(topic="/stereo/true_tracks"),
    )
    true = read(where, "eye_in_hand", tmp_path).tracks
    regions = []
    for target in (2, 1):
        x, y = true.pixels[(true.target == target) & (true.frame == 0)][0, :2] - 15
        regions += ["--region", f"{x},{y},30,30"]
    told = track(tmp_path / "blobs.mcap", tmp_path / "t.mcap", "--tracker", "meanshift", *regions)
    assert told["targets"] == 2
    tracked = where.model_copy(
        update={"path": str(tmp_path / "t.mcap"), "tracks": TrackSource(topic="/stereo/tracks")}
    )
    seen = read(tracked, "eye_in_hand", tmp_path).tracks
    assert seen.ids == ("0", "1")
    for number, target in enumerate((2, 1)):
        first, expected = (
            t.pixels[(t.target == k) & (t.frame == 0)][0] for t, k in ((seen, number), (true, target))
        )
        assert np.abs(first - expected).max() < 3.0


@pytest.mark.long
def test_sift_may_forget_by_the_way_instead_of_by_time(tmp_path: Path) -> None:
    simulated = {**SIMULATE, "frames": 8, "images": {"targets": "texture"}}
    spec = spec_file(tmp_path, "film", {"simulate": simulated})
    film = tmp_path / "film.mcap"
    vmf("simulate", spec, "-o", film, "--images", "--quiet")
    hidden = copy(film, tmp_path / "hidden.mcap", edits={LEFT: lambda i, data: [] if i % 3 == 1 else [data]})
    few = ("features=150",)

    def seen(void_after_m: float) -> Tracks:
        name = tmp_path / f"{void_after_m}.mcap"
        track(hidden, name, "--tracker", "sift", *few, f"void_after_m={void_after_m}", code=3)
        tracked = Recording.model_validate({**source(name), "tracks": {"topic": "/stereo/tracks"}})
        return read(tracked, "eye_in_hand", tmp_path).tracks

    def steps(tracks: Tracks) -> np.ndarray:
        """Straight ways (m) from frame to frame."""
        return np.linalg.norm(np.diff(np.linalg.inv(tracks.E_S_from_W)[:, :3, 3], axis=0), axis=1)

    far = seen(3.0)
    limit = float((steps(far).min() + steps(far).max()) / 2)
    near = seen(limit)
    for tracks, void_after_m in ((far, 3.0), (near, limit)):
        way = np.append(0.0, np.cumsum(steps(tracks)))
        gone = np.diff(way[tracks.frame])[np.diff(tracks.target) == 0]
        # The way over the hidden frames' poses, which is what counts, is no shorter than this one.
        assert 0 < gone.max() <= void_after_m
    assert near.n_targets > far.n_targets
    sift = {"kind": "sift", "features": 150, "void_after_m": limit}
    images = Recording.model_validate({**source(hidden), "images": {"tracker": sift}})
    direct = read(images, "eye_in_hand", tmp_path).tracks
    assert direct.ids == near.ids
    np.testing.assert_array_equal(direct.pixels, near.pixels)

    arguments = ("--tracker", "sift", "void_after_m=1", "-o", tmp_path / "t.mcap", "--quiet")
    vmf("track", film, *arguments, "--pose", "/nowhere").refused("no topic /nowhere")
    klt = ("-o", tmp_path / "klt.mcap", "--tracker", "klt", "--quiet")
    vmf("track", film, *klt, "--pose", "/nope").refused("no topic /nope", "topics present: ", "/robot/pose (")
    vmf("track", film, *klt, "--pose", "/robot/pose").refused("--pose: klt needs none", "void_after_m")
    vmf("track", film, *arguments, "--pose", LEFT).refused(LEFT, "geometry_msgs/msg/PoseStamped")
    still = copy(film, tmp_path / "still.mcap", edits={"/robot/pose": lambda i, data: []})
    vmf("track", still, *arguments).refused("void_after_m needs one topic with poses (--pose); found: none")
    vmf("track", film, *arguments[:2], "void_after_m=0", *arguments[3:]).refused("void_after_m", "found 0")


def test_the_same_spec_films_the_same_bytes(tmp_path: Path) -> None:
    spec = spec_file(tmp_path, "a", {"simulate": {**SIMULATE, "frames": 3, "images": {"targets": "texture"}}})
    for name in ("a", "b"):
        vmf("simulate", spec, "-o", tmp_path / f"{name}.mcap", "--images", "--quiet")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    vmf("simulate", spec, "-o", tmp_path / "c.mcap", "--images", "--quiet", "data.simulate.images.format=png")
    images = StereoImages(tmp_path / "c.mcap", ImageSource()).pairs(grey=False)
    lossless = next(images)
    assert lossless is not None
    lossy = next(StereoImages(tmp_path / "a.mcap", ImageSource()).pairs(grey=False))
    assert lossy is not None
    difference = lossless.left.astype(int) - lossy.left
    assert 0 < np.abs(difference).mean() < 3


@pytest.fixture(scope="module")
def franka(shared_data: Path) -> Path:
    path = shared_data / "franka_images.mcap"
    if not path.exists():
        pytest.skip(f"no recording at {path}")
    return path


def test_every_tag_that_opencv_finds_in_the_still_images_is_tracked(franka: Path, tmp_path: Path) -> None:
    track(franka, tmp_path / "t.mcap", "--tracker", "aruco")
    with (tmp_path / "t.mcap").open("rb") as file:
        frames = [json.loads(m.data) for _, c, m in make_reader(file).iter_messages(["/stereo/tracks"])]
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    images = StereoImages(franka, ImageSource()).pairs(grey=False)
    found = 0
    for frame, pair in zip(frames, images, strict=True):
        assert pair is not None
        for side, image in (("left", pair.left), ("right", pair.right)):
            squares, ids, _ = detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
            tracked = {t["id"]: t[side] for t in frame["tracks"]}
            for square, number in zip(squares, ids.ravel().tolist(), strict=True):
                for corner in range(4):
                    pixel = tracked[f"{number}/{corner}"]
                    assert pixel is not None, (frame["timestamp"], side, number)
                    # Refined, but the same corner: OpenCV's own are whole pixels.
                    assert np.linalg.norm(np.array(pixel) - square[0, corner]) < 3.0
                    found += 1
    assert found > 600


def test_a_real_arm_is_learned_from_its_images(franka: Path, tmp_path: Path) -> None:
    """Twenty poses, in twelve of which both cameras see the tool's tag: its position, the rotation given."""
    config = Path(__file__).resolve().parents[2] / "configs" / "real" / "franka_images.yaml"
    said = vmf("train", config, "--out", tmp_path, "--json", "--quiet", "evaluate.bootstrap=50")
    assert said.code == 0, said
    table = summary(said.run)
    mine = table[(table.protocol == "held_out") & (table.component == "distance")]
    median = mine.set_index(["method", "case"])["median"]
    for case in ("gap=1", "gap=2", "gap=3"):
        assert median["vmf", case] < 0.02 * median["no_motion", case]
    repairs = [note for note in record(said.run)["notes"] if "stand still" in note]
    assert len(repairs) == 1
    assert repairs[0].endswith("(12)"), "the three tags on the table have four corners each"
    again = vmf("evaluate", said.run, "--json", "--quiet", "evaluate.bootstrap=50")
    assert again.code == 0, again
