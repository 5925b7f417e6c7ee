"""Stereo pairs out of recordings: what goes together, what is lost, and how little of it is in memory."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from image_files import (
    LEFT,
    RIGHT,
    ImageFile,
    all_losses,
    encoded,
    picture,
    ros_raw,
    stereo,
)
from recording_files import PERIOD_NS, START_NS

from vmf.data.images import ImagePair, StereoImages
from vmf.data.images.stream import paired
from vmf.data.recording import schemas
from vmf.errors import InputError

MS = 10**6
TIMES = st.lists(st.integers(0, 60), min_size=1, max_size=20, unique=True).map(
    lambda times: np.array(sorted(times), np.int64)
)


def intact(images: StereoImages) -> list[ImagePair]:
    return [pair for pair in images.pairs(grey=False) if pair is not None]


def seeds(pairs: list[ImagePair]) -> list[int]:
    """Which pictures were paired: those of `ImageFile.pair(…, seed)` in both cameras."""
    found = []
    for pair in pairs:
        matches = [s for s in range(40) if np.array_equal(pair.left, picture(s))]
        assert len(matches) == 1
        np.testing.assert_array_equal(pair.right, picture(matches[0] + 1))
        found.append(matches[0])
    return found


@given(left=TIMES, right=TIMES, tolerance=st.integers(0, 15))
def test_pairs_are_each_others_nearest_within_the_tolerance(
    left: np.ndarray, right: np.ndarray, tolerance: int
) -> None:
    a, b = paired(left, right, tolerance)
    assert (np.diff(a) > 0).all()
    assert (np.diff(b) > 0).all()
    expected = []
    for i, time in enumerate(left):
        k = int(np.argmin(np.abs(right - time)))
        if int(np.argmin(np.abs(left - right[k]))) == i and abs(right[k] - time) <= tolerance:
            expected.append((i, k))
    assert list(zip(a.tolist(), b.tolist(), strict=True)) == expected


def test_all_pairs_come_in_order_with_their_own_pictures(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(12):
            file.pair(START_NS + i * PERIOD_NS, i, START_NS + i * PERIOD_NS + 2 * MS)
    images = stereo(path)
    assert len(images) == 12
    pairs = intact(images)
    assert seeds(pairs) == list(range(12))
    assert [p.time_ns for p in pairs] == [START_NS + i * PERIOD_NS + MS for i in range(12)]
    assert [p.log_time_ns for p in pairs] == [START_NS + i * PERIOD_NS + 2 * MS for i in range(12)]
    assert images.losses == ()
    assert images.repairs == ()


def test_images_without_a_partner_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(6):
            time = START_NS + i * PERIOD_NS
            if i not in (0, 3):
                file.compressed(LEFT, time, encoded(picture(i)))
            if i != 5:
                # The fourth comes a little too late.
                file.compressed(RIGHT, time + (12 * MS if i == 4 else 0), encoded(picture(i + 1)))
    images = stereo(path)
    assert seeds(intact(images)) == [1, 2]
    assert all_losses(images) == {
        f"{LEFT}: images without a partner on {RIGHT} within 0.01 s dropped": 2,
        f"{RIGHT}: images without a partner on {LEFT} within 0.01 s dropped": 3,
    }
    assert seeds(intact(stereo(path, pair_tolerance_s=0.015))) == [1, 2, 4]


def test_cameras_that_never_meet_are_an_error_that_says_how_far_apart_they_are(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(3):
            file.pair(START_NS + i * 10**9, i, START_NS + i * 10**9 + 300 * MS)
    with pytest.raises(
        InputError, match=r"no image on /left/image has a partner .* the closest two are 0\.3 s"
    ):
        stereo(path)


@pytest.mark.parametrize("order", ["left first", "right first", "halves"])
def test_the_order_of_the_file_does_not_matter(tmp_path: Path, order: str) -> None:
    """Tools that merge files write one topic behind the other."""
    path = tmp_path / "a.mcap"
    n = 30
    topics = (RIGHT, LEFT) if order == "right first" else (LEFT, RIGHT)
    images = [(t, i) for t in topics for i in range(n)]
    if order == "halves":
        images = [
            (t, i)
            for half in (0, 1)
            for t in (RIGHT, LEFT)
            for i in range(half * n // 2, (half + 1) * n // 2)
        ]
    with ImageFile(path) as file:
        for topic, i in images:
            data = encoded(picture(i + (topic == RIGHT)))
            file.compressed(topic, START_NS + i * PERIOD_NS, data)
    found = stereo(path)
    assert seeds(intact(found)) == list(range(n))
    assert found.losses == ()


def test_images_a_little_out_of_order_are_put_right(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in (0, 2, 1, 3, 6, 5, 4, 7):
            file.pair(START_NS + i * PERIOD_NS, i)
    images = stereo(path)
    assert seeds(intact(images)) == list(range(8))
    assert images.losses == ()
    assert [(r.place, r.count) for r in images.repairs] == [(LEFT, 3), (RIGHT, 3)]


def test_an_image_that_comes_much_too_late_is_lost_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in (*range(1, 20), 0):
            file.compressed(LEFT, START_NS + i * PERIOD_NS, encoded(picture(i)))
        for i in range(20):
            file.compressed(RIGHT, START_NS + i * PERIOD_NS, encoded(picture(i + 1)))
    images = stereo(path)
    assert len(images) == 20
    assert seeds(intact(images)) == list(range(1, 20))
    assert all_losses(images) == {f"{LEFT}: images too far out of time order dropped": 1}


def test_damaged_images_are_counted_and_the_rest_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(8):
            time = START_NS + i * PERIOD_NS
            data = encoded(picture(i))
            file.compressed(LEFT, time, data[: len(data) // 2] if i in (2, 5) else data)
            image = encoded(picture(i + 1, (20, 10) if i == 6 else (40, 30)))
            file.compressed(RIGHT, time, b"not a picture" if i == 5 else image)
    images = stereo(path)
    pairs = list(images.pairs(grey=False))
    assert [pair is None for pair in pairs] == [i in (2, 5, 6) for i in range(8)]
    assert seeds([p for p in pairs if p is not None]) == [0, 1, 3, 4, 7]
    assert all_losses(images) == {
        f"{LEFT}: damaged images dropped": 2,
        f"{RIGHT}: damaged images dropped": 1,
        f"{RIGHT}: images of another size than 40x30 dropped": 1,
    }
    (not_a_picture,) = (loss for loss in images.losses if "damaged" in loss.what and loss.place == RIGHT)
    assert "b'not '; accepted: JPEG, PNG" in not_a_picture.what


def test_messages_that_are_no_images_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(4):
            file.pair(START_NS + i * PERIOD_NS, i)
        file.raw(LEFT, schemas.COMPRESSED_IMAGE, ("cdr", "ros2msg"), b"", b"\0\1\0\0xx", START_NS)
    images = stereo(path)
    assert len(intact(images)) == 4
    assert all_losses(images) == {f"{LEFT}: malformed image messages dropped": 1}


def test_a_raw_image_that_lies_about_its_size_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(3):
            time = START_NS + i * PERIOD_NS
            lie = {"height": 2**31, "width": 2**31, "step": 2**32 - 1} if i == 1 else {}
            for topic in (LEFT, RIGHT):
                file.ros(topic, schemas.IMAGE, ros_raw(time, picture(i), "rgb8", **lie), time)
    images = stereo(path)
    assert [pair is None for pair in images.pairs(grey=True)] == [False, True, False]
    assert all_losses(images) == {f"{t}: damaged images dropped": 1 for t in (LEFT, RIGHT)}


def test_a_damaged_chunk_costs_its_images_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with ImageFile(path, chunk_size=2000) as file:
        for i in range(10):
            file.pair(START_NS + i * PERIOD_NS, i)
    data = bytearray(path.read_bytes())
    middle = data.find(b"zstd", len(data) // 3) + 200
    data[middle] ^= 16
    path.write_bytes(data)
    images = stereo(path)
    found = seeds(intact(images))
    assert 5 <= len(found) < 10
    assert images.contents.losses
    assert any("damaged" in loss.what for loss in images.contents.losses)


def test_never_more_than_two_pairs_are_decoded_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vmf.data.images.decode import ImageReader

    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(15):
            file.pair(START_NS + i * PERIOD_NS, i)
    alive: list[weakref.ref[np.ndarray]] = []
    read = ImageReader.image

    def counted(self: ImageReader, message: object, grey: bool) -> np.ndarray:
        image = read(self, message, grey)  # type: ignore[arg-type]
        alive.append(weakref.ref(image))
        return image

    monkeypatch.setattr(ImageReader, "image", counted)
    most = 0
    for pair in stereo(path).pairs(grey=False):
        assert pair is not None
        gc.collect()
        most = max(most, sum(ref() is not None for ref in alive))
        del pair
    assert len(alive) == 30
    assert most <= 4


def test_a_reader_that_gives_up_leaves_no_threads_behind(tmp_path: Path) -> None:
    import threading

    path = tmp_path / "a.mcap"
    with ImageFile(path) as file:
        for i in range(5):
            file.pair(START_NS + i * PERIOD_NS, i)
    before = threading.active_count()
    pairs = stereo(path).pairs(grey=True)
    next(pairs)
    assert threading.active_count() > before
    pairs.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before


def topics(tmp_path: Path, *names: str) -> Path:
    path = tmp_path / "topics.mcap"
    with ImageFile(path) as file:
        for name in names:
            file.compressed(name, START_NS, encoded(picture()))
        file.sound(3)
    return path


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (("/right", "/left"), ("/left", "/right")),
        (("/cam/Left/image", "/cam/Right/image", "/wrist/image"), ("/cam/Left/image", "/cam/Right/image")),
        (("/rig_right_cam/image", "/rig_left_cam/image"), ("/rig_left_cam/image", "/rig_right_cam/image")),
    ],
)
def test_topics_are_found_by_their_names(
    tmp_path: Path, names: tuple[str, ...], found: tuple[str, str]
) -> None:
    images = stereo(topics(tmp_path, *names))
    assert (images.left, images.right) == found


@pytest.mark.parametrize(
    ("names", "source", "words"),
    [
        (
            ("/cam0", "/cam1"),
            {},
            ["no two image topics", "--left", "/cam0 (sensor_msgs/msg/CompressedImage)"],
        ),
        (("/left", "/right", "/b/left", "/b/right"), {}, ["several stereo pairs", "/left with /right"]),
        (("/left", "/right"), {"left": "/lef"}, ["no topic /lef; did you mean /left?"]),
        (("/left", "/right"), {"left": "/left", "right": "/left"}, ["given for both cameras"]),
        (
            ("/left", "/right"),
            {"right": "/tracks"},
            ["/tracks has schema vmf.StereoTracks", "foxglove.RawImage"],
        ),
        ((), {}, ["no two image topics"]),
    ],
)
def test_topics_that_leave_a_doubt_are_listed(
    tmp_path: Path, names: tuple[str, ...], source: dict[str, str], words: list[str]
) -> None:
    with pytest.raises(InputError) as caught:
        stereo(topics(tmp_path, *names), **source)
    for part in words:
        assert part in str(caught.value)


def test_a_topic_that_is_given_finds_its_partner(tmp_path: Path) -> None:
    path = topics(tmp_path, "/left", "/right", "/b/left", "/b/right")
    images = stereo(path, right="/b/right")
    assert (images.left, images.right) == ("/b/left", "/b/right")
    images = stereo(path, left="/b/right", right="/left")
    assert (images.left, images.right) == ("/b/right", "/left")
