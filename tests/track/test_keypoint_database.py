"""The thesis's keypoint database (§5.5): what is found again keeps its name unless the robot went too far."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from films import Shot, Truth, blank, compared, shot, tracker
from hypothesis import given
from hypothesis import strategies as st

from vmf.approximate import Lookup
from vmf.data.recording.transforms import Stream
from vmf.learn.compressed import CompressedPipeline
from vmf.learn.pairs import pair_rows
from vmf.learn.pipeline import PipelineLearner
from vmf.learn.sequential import SequentialPipeline
from vmf.tasks import make_task
from vmf.track import Sightings
from vmf.track.base import Odometry
from vmf.track.keypoint_database import Keypoint, KeypointDatabase, Look
from vmf.track.odometry import Trajectory
from vmf.track.patch import Patch

MEMORY = 3
LOOK = Look(Patch(np.zeros((21, 21), np.uint8)), 4.0, 0.0, 0)
CODE = np.arange(4.0)


def descriptor(number: int) -> np.ndarray:
    """Descriptors (2, 128) of length 512, as SIFT's, at right angles for different numbers."""
    both = np.zeros((2, 128), np.float32)
    both[:, number] = 512.0
    return both


def odometry(travelled_m: float) -> Odometry:
    return Odometry(np.eye(4), travelled_m)


def database(void_after_m: float | None = 3.0) -> KeypointDatabase:
    return KeypointDatabase(MEMORY, void_after_m)


def only(keypoints: KeypointDatabase) -> Keypoint:
    (keypoint,) = keypoints.keypoints
    return keypoint


def test_what_was_not_seen_for_longest_is_forgotten_where_nothing_is_void(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("vmf.track.keypoint_database.MOST_KEYPOINTS", 5)
    keypoints = database()
    for frame in range(4):
        keypoints.begin(odometry(0.0))
        if frame == 3:
            break
        if frame:
            keypoints.again(0, descriptor(0), CODE)
        for number in range(3):
            keypoints.add(LOOK, descriptor(3 * frame + number + 1), CODE)
    # The first is seen again and again; the other two of its frame are the oldest, then those of the next.
    assert [k.name for k in keypoints.keypoints] == ["0", "3", "6", "7", "8"]


@given(
    st.lists(st.tuples(st.floats(0, 2), st.booleans()), min_size=1, max_size=30),
    st.floats(0.1, 3),
)
def test_a_keypoint_is_void_once_the_robot_went_too_far_since_it_was_seen(
    way: list[tuple[float, bool]], void_after_m: float
) -> None:
    keypoints = database(void_after_m)
    keypoints.begin(odometry(0.0))
    keypoints.add(LOOK, descriptor(0), CODE)
    travelled = last = 0.0
    for step, seen in way:
        travelled += step
        keypoints.begin(odometry(travelled))
        assert bool(keypoints.keypoints) == (travelled - last <= void_after_m)
        if not keypoints.keypoints:
            return
        if seen:
            keypoints.again(0, descriptor(0), CODE)
            last = travelled
        assert keypoints.recent(0) == (keypoints._frame - only(keypoints).seen <= MEMORY + 1)


def test_without_a_distance_age_decides() -> None:
    keypoints = database(None)
    keypoints.begin(None)
    keypoints.add(LOOK, descriptor(0), CODE)
    for _ in range(MEMORY + 1):
        keypoints.begin(None)
        assert len(keypoints.keypoints) == 1
    keypoints.begin(None)
    assert keypoints.keypoints == []


def test_a_distance_needs_odometry() -> None:
    with pytest.raises(ValueError, match="needs odometry"):
        database().begin(None)
    of = shot("sift", frames=6)
    with pytest.raises(ValueError, match="needs odometry"):
        tracker("sift", "void_after_m=3").step(*of.frame(0, False))


def test_an_entry_holds_what_was_newest() -> None:
    keypoints = database()
    keypoints.begin(odometry(1.0))
    assert keypoints.add(LOOK, descriptor(0), CODE) == "0"
    first = only(keypoints)
    now = Odometry(np.diag([1.0, -1.0, -1.0, 1.0]), 2.5)
    keypoints.begin(now)
    assert not keypoints.in_sight().any()
    keypoints.again(0, descriptor(1), CODE + 7)
    entry = only(keypoints)
    assert (entry.name, entry.stamp, entry.look) == ("0", now, LOOK)
    np.testing.assert_array_equal(entry.code, CODE + 7)
    np.testing.assert_array_equal(entry.expected, CODE[:2] + 7)
    np.testing.assert_array_equal(keypoints.descriptors(1), descriptor(1)[1:])
    (match,) = keypoints.matches
    assert (match.before, match.stamp) == (first, now)
    keypoints.begin(odometry(2.5))
    assert keypoints.matches == []


def test_only_what_is_unlike_all_others_is_distinctive() -> None:
    keypoints = database()
    keypoints.begin(odometry(0.0))
    asked = np.stack([descriptor(5)[0], descriptor(9)[0]])
    assert keypoints.distinctive(asked).all()
    keypoints.add(LOOK, descriptor(5), CODE)
    assert keypoints.distinctive(asked).tolist() == [False, True]
    # Nearer than 220 to the known one, and farther.
    near, far = (descriptor(5)[0] + descriptor(9)[0] * share for share in (0.4, 0.5))
    assert keypoints.distinctive(np.stack([near, far])).tolist() == [False, True]
    assert keypoints.distinctive(asked[:0]).shape == (0,)


def away_and_back(of: Shot, gap: int, travelled_m: float) -> tuple[list[Sightings], list[Sightings]]:
    """What is seen before and after the robot looked elsewhere for some frames, on a way of that length."""
    one = tracker("sift", "void_after_m=3", "memory_frames=2")
    before, after = [], []
    for n in range(6):
        one.moved_to(odometry(0.0))
        before.append(one.step(*of.frame(n, False)))
    for n in range(gap):
        one.moved_to(odometry(travelled_m * (n + 1) / gap))
        assert one.step(*blank(of, False)).ids == ()
    for n in range(12, 18):
        one.moved_to(odometry(travelled_m))
        after.append(one.step(*of.frame(n, False)))
    return before, after


def names(seen: list[Sightings]) -> set[str]:
    return {name for sightings in seen for name in sightings.ids}


def test_what_is_seen_again_from_elsewhere_is_the_same_until_it_is_void() -> None:
    of = shot("sift")
    before, after = away_and_back(of, 10, 2.9)
    again = names(before) & set(after[0].ids)
    assert len(again) > len(after[0].ids) / 2
    before, after = away_and_back(of, 10, 3.1)
    assert names(after)
    assert not names(before) & names(after)


def test_a_name_found_again_is_the_point_it_was() -> None:
    of = shot("sift")
    before, after = away_and_back(of, 10, 1.0)
    truth = Truth(of)
    off = []
    for frame, sightings in zip([*range(6), *range(12, 18)], [*before, *after], strict=True):
        for name, pixel in zip(sightings.ids, sightings.pixels, strict=True):
            wrong = np.linalg.norm((truth.of_point(name, frame, pixel) - pixel).reshape(2, 2), axis=1).max()
            if frame >= 12 and name in names(before):
                off.append(wrong)
    assert len(off) > 50
    # Wrong matches lie anywhere; right ones within the reach of the alignment.
    assert np.mean(np.array(off) > 2.5) < 0.02


@pytest.mark.parametrize("engine", [SequentialPipeline, CompressedPipeline])
def test_matches_are_the_pairs_that_a_learner_of_length_one_takes(engine: type[PipelineLearner]) -> None:
    """The thesis: "Algorithm 1 was not used and updates were performed only between the matched features"."""
    of = shot("sift", frames=16)
    E = of.film.tracks.E_S_from_W
    one = tracker("sift", "void_after_m=0.05", "features=60")
    travelled = np.cumsum(np.append(0.0, np.linalg.norm(np.diff(E[:, :3, 3], axis=0), axis=1)))
    seen, matches = [], []
    for n in range(len(E)):
        one.moved_to(Odometry(E[n], float(travelled[n])))
        # Every third frame shows nothing, so that some are void and some are not.
        images = blank(of, False) if n % 3 == 2 else of.frame(n, False)
        seen.append(one.step(*images))
        matches += one.database.matches  # type: ignore[attr-defined]
    tracks = compared("sift", of, seen).tracks
    assert 20 < len(matches) < len(tracks.frame)

    def rows(i: tuple[np.ndarray, np.ndarray], c: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return pair_rows(task, i[0][None], i[1].reshape(1, 2, 2), c[0][None], c[1].reshape(1, 2, 2))[0]

    task = make_task("six_dof")
    gram: dict[bytes, np.ndarray] = defaultdict(lambda: np.zeros((2, 39, 39)))
    for k, frame in enumerate(tracks.frame):
        view = E[frame], tracks.pixels[k]
        A = rows(view, view)
        gram[tracks.pixels[k].tobytes()] += np.swapaxes(A, 1, 2) @ A
    for match in matches:
        assert match.stamp is not None
        assert match.before.stamp is not None
        before, now = (match.before.stamp.T, match.before.code), (match.stamp.T, match.code)
        for centre, other in ((before, now), (now, before)):
            A = rows(other, centre)
            gram[centre[1].tobytes()] += np.swapaxes(A, 1, 2) @ A
    learner = engine(task, None, Lookup, length=1)
    learner.partial_fit(tracks)
    tiles = learner.tiles(tracks.pixels)
    R = learner._factors(tiles)
    assert len(R) == len(tracks.frame)
    for k, code in enumerate(tiles.code):
        expected = gram[code.tobytes()]
        # A few products of numbers up to a column's length, summed in another order.
        size = np.sqrt(np.maximum(np.einsum("cii->ci", expected), 1.0))
        off = np.abs(np.swapaxes(R[k], 1, 2) @ R[k] - expected) / (size[:, :, None] * size[:, None, :])
        assert off.max() < 1e-12


def test_a_trajectory_counts_the_way_and_takes_the_nearest_pose() -> None:
    q = [0.0, 0.0, 0.0, 1.0]
    stream = Stream(np.array([10, 30, 20]), np.array([[0, 0, 0, *q], [3, 4, 0, *q], [3, 0, 0, *q]], float))
    way = Trajectory.of(stream)
    assert [way.at(t).travelled_m for t in (-5, 14, 15, 16, 25, 26, 99)] == [0, 0, 0, 3, 3, 7, 7]
    np.testing.assert_array_equal(way.at(99).T[:3, 3], [3.0, 4.0, 0.0])
    joints = Trajectory.of(Stream(np.array([10, 20]), np.array([[0.1, 0.2], [0.3, 0.4]])))
    assert joints.at(20).travelled_m == 0.0
