"""The thesis's keypoint database (§5.5) at the command line: a learner pairs what the tracker matched."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from mcap_edits import copy
from vmf_command import CONFIGS, SMALL_FILM, train, vmf

from vmf.data.recording import read
from vmf.data.tracks import Tracks
from vmf.learn import sequential
from vmf.learn.pairs import pair_rows
from vmf.spec.model import Recording
from vmf.tasks import Task
from vmf.track.keypoint_database import KeypointDatabase

CONFIG = CONFIGS / "matched.yaml"
LEFT = "/stereo/left/image_raw/compressed"
FRAMES, FEATURES = 16, 120
# The frames that the left camera misses: the way of the robot from the one before to the one after is long.
MISSED = range(6, 10)
# The robot goes further meanwhile, and less far from frame to frame elsewhere.
SHORT_M = 0.3
# Two codes that are paired, each as bytes.
Pair = frozenset[bytes]


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    whole = folder / "whole.mcap"
    said = vmf("simulate", CONFIGS / "quickstart.yaml", "--images", "-o", whole, *SMALL_FILM, "--quiet")
    assert said.code == 0, said
    missed = {LEFT: lambda i, data: [] if i in MISSED else [data]}
    return copy(whole, folder / "film.mcap", edits=missed)


@pytest.fixture
def matched() -> Iterator[set[Pair]]:
    """What the databases of all trackers match meanwhile."""
    found: set[Pair] = set()
    again = KeypointDatabase.again

    def listen(self: KeypointDatabase, number: int, descriptors: np.ndarray, code: np.ndarray) -> None:
        found.add(frozenset((self.keypoints[number].code.tobytes(), code.tobytes())))
        again(self, number, descriptors, code)

    with patch.object(KeypointDatabase, "again", listen):
        yield found


def learned(out: Path, *overrides: str, code: int) -> set[Pair]:
    """Learn as the config says, and return which different observations were paired."""
    found: set[Pair] = set()

    def listen(task: Task, E_i: np.ndarray, u_i: np.ndarray, E_c: np.ndarray, u_c: np.ndarray) -> np.ndarray:
        for i, c in zip(u_i.reshape(-1, 4), u_c.reshape(-1, 4), strict=True):
            found.add(frozenset((i.tobytes(), c.tobytes())))
        return pair_rows(task, E_i, u_i, E_c, u_c)

    # Pair by pair, which has the same factors as the config's.
    asked = ("learner.engine=sequential", "evaluate.gaps=[1]", "evaluate.bootstrap=20")
    with patch.object(sequential, "pair_rows", listen):
        train(CONFIG, out, *asked, *overrides, code=code)
    return {pair for pair in found if len(pair) == 2}


def frames_of(tracks: Tracks) -> dict[bytes, int]:
    """Return the frame of each code."""
    found = {
        pixels.tobytes(): frame for pixels, frame in zip(tracks.pixels, tracks.frame.tolist(), strict=True)
    }
    assert len(found) == len(tracks.frame)
    return found


@pytest.mark.parametrize(("void_after_m", "found_again"), [(3.0, True), (SHORT_M, False)])
def test_the_pairs_learned_from_are_the_database_s_matches_until_they_are_void(
    void_after_m: float, found_again: bool, film: Path, matched: set[Pair], tmp_path: Path
) -> None:
    path = tmp_path / "tracks.mcap"
    sift = ("--tracker", "sift", f"features={FEATURES}", f"void_after_m={void_after_m}")
    assert vmf("track", film, "-o", path, *sift, "--quiet").code == 3  # images without a partner
    document = {"path": str(path), "pose": {"topic": "/robot/pose"}, "tracks": {"topic": "/stereo/tracks"}}
    tracks = read(Recording.model_validate(document), "eye_in_hand", tmp_path).tracks
    frame = frames_of(tracks)
    assert tracks.n_frames == FRAMES - len(MISSED)
    steps_m = np.linalg.norm(np.diff(np.linalg.inv(tracks.E_S_from_W)[:, :3, 3], axis=0), axis=1)
    before = MISSED.start - 1
    assert steps_m[before] > SHORT_M > np.delete(steps_m, before).max()

    # What is learned from is the first part of the recording.
    cut = round(0.8 * tracks.n_frames)
    expected = {pair for pair in matched if max(frame[code] for code in pair) < cut}
    overrides = (f"data.recording.path={path}", "data.recording.images=null")
    pairs = learned(tmp_path, *overrides, "data.recording.tracks.topic=/stereo/tracks", code=0)
    assert pairs == expected
    assert len(pairs) > 100
    over_the_gap = {pair for pair in pairs if len({frame[code] <= before for code in pair}) == 2}
    assert bool(over_the_gap) == found_again
    # Each observation has a pair with one earlier one, and with no other.
    later = [max(pair, key=frame.__getitem__) for pair in pairs]
    assert len(set(later)) == len(later)


def test_images_tracked_on_the_way_are_paired_alike(film: Path, matched: set[Pair], tmp_path: Path) -> None:
    overrides = (f"data.recording.path={film}", f"data.recording.images.tracker.features={FEATURES}")
    pairs = learned(tmp_path, *overrides, code=3)
    assert len(pairs) > 100
    assert pairs <= matched
