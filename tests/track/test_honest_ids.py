"""A name is the same target or none: what is lost and found again, what drifts, what only looks alike."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from films import Shot, blank, followed, followed_anew, grey, shot, tracker
from hypothesis import given
from hypothesis import strategies as st

from vmf.data.render import texture
from vmf.track import Sightings
from vmf.track.epipolar import EpipolarGate, distance_px
from vmf.track.neighbours import along
from vmf.track.patch import align, take
from vmf.track.region import of_rectangle


def with_a_gap(kind: str, of: Shot, *options: str, gap: int = 3) -> tuple[list[Sightings], list[Sightings]]:
    """What is seen before and after both cameras were covered."""
    one = tracker(kind, *options)
    before = [one.step(*of.frame(n, one.colour)) for n in range(6)]
    for _ in range(gap):
        assert one.step(*blank(of, one.colour)).ids == ()
    return before, [one.step(*of.frame(n, one.colour)) for n in range(6, 12)]


def names(seen: list[Sightings]) -> set[str]:
    return {name for sightings in seen for name in sightings.ids}


def test_a_tag_is_the_same_after_it_was_covered() -> None:
    before, after = with_a_gap("aruco", shot("aruco"))
    assert names(before) == names(after)


@pytest.mark.parametrize("kind", ["klt", "meanshift", "camshift"])
def test_a_corner_or_colour_found_again_is_a_new_target(kind: str) -> None:
    before, after = with_a_gap(kind, shot(kind))
    assert names(after)
    assert not names(before) & names(after)


@pytest.mark.parametrize("kind", ["meanshift", "camshift"])
def test_a_colour_may_be_vouched_for(kind: str) -> None:
    before, after = with_a_gap(kind, shot(kind), "refound=same_id", "targets=2")
    assert names(before) == names(after) == {"0", "1"}


def test_a_feature_found_again_is_the_same_as_long_as_it_is_remembered() -> None:
    before, after = with_a_gap("sift", shot("sift"))
    assert len(names(before) & set(after[0].ids)) > len(after[0].ids) / 2
    before, after = with_a_gap("sift", shot("sift"), "memory_frames=2")
    assert names(after)
    assert not names(before) & names(after)


def test_two_tags_of_one_number_are_no_target() -> None:
    picture, _ = texture.tag(7)
    tile = cv2.resize(picture[..., 0], (90, 90))
    one, two = np.full((240, 320), 200, np.uint8), np.full((240, 320), 200, np.uint8)
    one[50:140, 40:130] = two[50:140, 40:130] = two[80:170, 180:270] = tile
    seen = tracker("aruco").step(one, two)
    assert len(seen.ids) == 4
    assert np.isnan(seen.pixels[:, 2:]).all()


def test_only_the_tags_asked_for_are_seen() -> None:
    of = shot("aruco")
    assert {n.split("/")[0] for n in names(followed("aruco", of))} > {"1"}
    assert {n.split("/")[0] for n in names(followed("aruco", of, "ids=[1]"))} == {"1"}
    assert names(followed_anew("aruco", of, "dictionary=6x6_250", frames=range(5))) == set()


@pytest.mark.parametrize(("family", "number"), [("36h11", 3), ("25h9", 11), ("16h5", 5), ("36h10", 40)])
def test_apriltags_of_every_family_are_found_to_the_sixteenth_of_a_pixel(family: str, number: int) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))
    # A whole number of pixels for each cell: in others OpenCV draws the cells up to a pixel off their place.
    side = 50 * (dictionary.markerSize + 2)
    marker = cv2.aruco.generateImageMarker(dictionary, number, side)
    scale = np.diag([400 / side, 400 / side, 1.0])
    H = np.array([[0.21, 0.02, 100.3], [-0.015, 0.2, 60.7], [1e-5, 2e-5, 1.0]]) @ scale
    marker = cv2.copyMakeBorder(marker, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=(255,))
    # Eight times too large, then averaged as a camera averages: edges are off by half an eighth at most.
    fine = np.diag([8.0, 8.0, 1.0]) @ H
    fine[:2] += 3.5 * fine[2]
    large = cv2.warpPerspective(marker, fine, (8 * 320, 8 * 240), borderValue=(255,))
    image = cv2.resize(large, (320, 240), interpolation=cv2.INTER_AREA)
    seen = tracker("apriltag", f"family={family}").step(image, image)
    assert seen.ids == tuple(f"{number}/{corner}" for corner in range(4))
    low, high = 59.5, 59.5 + side
    corners = np.array([[low, low, 1], [high, low, 1], [high, high, 1], [low, high, 1.0]]) @ H.T
    np.testing.assert_allclose(seen.pixels[:, :2], corners[:, :2] / corners[:, 2:], atol=1 / 16)
    np.testing.assert_array_equal(seen.pixels[:, :2], seen.pixels[:, 2:])


def board(columns: int, rows: int, turn: int = 0) -> np.ndarray:
    """A chessboard of so many inner corners in the middle of an image, turned by quarters."""
    squares = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    picture = np.kron(np.where(squares == 0, 20, 230), np.ones((20, 20))).astype(np.uint8)
    picture = np.rot90(picture, turn)
    image = np.full((300, 300), 230, np.uint8)
    top, left = (300 - picture.shape[0]) // 2, (300 - picture.shape[1]) // 2
    image[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    return image


def places(seen: Sightings) -> dict[str, np.ndarray]:
    return dict(zip(seen.ids, seen.pixels, strict=True))


def test_a_board_that_can_be_told_the_right_way_round_always_is() -> None:
    """The first corner lies beside the dark corner square, however the board is turned."""
    upright, over = board(6, 5), board(6, 5, turn=2)
    a, b = (places(tracker("chessboard", "columns=6", "rows=5").step(i, i)) for i in (upright, over))
    assert a.keys() == b.keys()
    # A twentieth of a square: which corner it is, not how well the detector knows its place.
    for name, pixels in a.items():
        np.testing.assert_allclose(b[name], 299 - pixels, atol=1.0)
    one = tracker("chessboard", "columns=6", "rows=5")
    one.step(upright, upright)
    again = places(one.step(over, over))
    assert again.keys() == b.keys()
    for name, pixels in again.items():
        np.testing.assert_array_equal(pixels, b[name])


@pytest.mark.parametrize(("columns", "rows"), [(7, 5), (6, 6), (5, 5)])
def test_a_board_that_cannot_be_told_is_another_one_after_it_was_lost(columns: int, rows: int) -> None:
    one = tracker("chessboard", f"columns={columns}", f"rows={rows}")
    image, nothing = board(columns, rows), np.full((300, 300), 230, np.uint8)
    first = one.step(image, image)
    assert len(first.ids) == columns * rows
    assert one.step(nothing, nothing).ids == ()
    second = one.step(image, image)
    assert {f"{name}#1" for name in first.ids} == set(second.ids)


@pytest.mark.parametrize(("columns", "rows"), [(7, 5), (6, 6), (5, 5)])
def test_a_board_in_sight_keeps_its_names_while_it_turns(columns: int, rows: int) -> None:
    """Through half a turn in steps of fifteen degrees, after which it looks the same as at first."""
    one = tracker("chessboard", f"columns={columns}", f"rows={rows}")
    still = board(columns, rows)
    middle = (299 / 2, 299 / 2)
    start = one.step(still, still)
    for degrees in range(0, 181, 15):
        M = cv2.getRotationMatrix2D(middle, degrees, 1.0)
        turned = cv2.warpAffine(still, M, (300, 300), borderValue=(230,))
        seen = one.step(turned, turned)
        expected = start.pixels[:, :2] @ M[:, :2].T + M[:, 2]
        order = [seen.ids.index(name) for name in start.ids]
        assert np.abs(seen.pixels[order, :2] - expected).max() < 1.0, degrees


def test_a_region_names_the_target() -> None:
    of = shot("meanshift")
    truth = {name: p for f, name, p in _true(of) if f == 0}
    for name, pixel in truth.items():
        region = f"regions=[[{pixel[0] - 12}, {pixel[1] - 12}, 24, 24]]"
        seen = followed_anew("meanshift", of, region, frames=range(3))
        assert seen[0].ids == ("0",), name
        assert np.linalg.norm(seen[0].pixels[0, :2] - pixel[:2]) < 3.0


@pytest.mark.parametrize("kind", ["klt", "sift"])
def test_a_region_moves_along_with_its_target(kind: str) -> None:
    of = shot(kind)
    truth = {(f, name): p for f, name, p in _true(of)}
    reach = 30.0
    start = truth[0, "0"]
    seen = followed(kind, of, f"regions=[[{start[0] - reach}, {start[1] - reach}, {2 * reach}, {2 * reach}]]")
    assert len(seen[0].ids) >= 3
    for frame, sightings in enumerate(seen):
        if (frame, "0") in truth and len(sightings.ids):
            left = sightings.pixels[:, :2]
            off = np.linalg.norm(left[np.isfinite(left[:, 0])] - truth[frame, "0"][:2], axis=1)
            assert np.median(off) < 2 * reach, frame


def _true(of: Shot) -> list[tuple[int, str, np.ndarray]]:
    t = of.film.tracks
    return [
        (f, t.ids[k], p)
        for f, k, p in zip(t.frame.tolist(), t.target.tolist(), t.pixels, strict=True)
        if np.isfinite(p).all()
    ]


def test_a_corner_that_no_longer_looks_the_same_is_lost() -> None:
    """The picture changes under the tracker without moving: nothing may be followed through that."""
    of = shot("klt")
    one = tracker("klt")
    first = one.step(*of.frame(0, False))
    assert len(first.ids) > 20
    rng = np.random.default_rng(0)
    other = texture.random_texture(rng, 640, 0, 255)[:480, :, 0]
    seen = one.step(other, np.roll(other, -30, axis=1))
    assert not set(first.ids) & set(seen.ids)


def test_a_corner_that_slides_along_is_caught_by_its_first_look() -> None:
    """A still background with a picture that slides over it: corners of both, none in between."""
    rng = np.random.default_rng(0)
    back = texture.random_texture(rng, 640, 60, 180)[:480, :, 0]
    front = texture.random_texture(rng, 160, 0, 255)[..., 0]
    one = tracker("klt", "corners=200")
    births: dict[str, tuple[np.ndarray, bool]] = {}
    for step in range(12):
        x = 100 + 9 * step
        left, right = back.copy(), np.roll(back, -20, axis=1)
        left[100:260, x : x + 160] = front
        right[100:260, x - 40 : x + 120] = front
        seen = one.step(left, right)
        for name, pixel in zip(seen.ids, seen.pixels, strict=True):
            if not np.isfinite(pixel).all():
                continue
            inside = bool(x + 12 <= pixel[0] < x + 148 and 112 <= pixel[1] < 248)
            outside = not (x - 12 <= pixel[0] < x + 172 and 88 <= pixel[1] < 272)
            if not (inside or outside):
                continue
            place = pixel[0] - 9 * step if inside else pixel[0]
            was = births.setdefault(name, (place, inside))
            if was[1] == inside:
                assert abs(place - was[0]) < 1.0, (step, name)
    assert sum(inside for _, inside in births.values()) > 10
    assert sum(not inside for _, inside in births.values()) > 10


def rig(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Matches (n, 4) of a converging, rolled rig, and its fundamental matrix."""
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    R = cv2.Rodrigues(np.array([0.1, -0.3, 0.4]))[0]
    t = np.array([-0.3, 0.1, 0.05])
    P = rng.uniform([-1, -1, 2], [1, 1, 5], (n, 3))
    left, right = P @ K.T, (P @ R.T + t) @ K.T
    skew = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    F = np.linalg.inv(K).T @ skew @ R @ np.linalg.inv(K)
    return np.hstack([left[:, :2] / left[:, 2:], right[:, :2] / right[:, 2:]]), F


def test_epipolar_distances_are_those_of_points_from_lines() -> None:
    rng = np.random.default_rng(0)
    matches, F = rig(rng, 50)
    assert distance_px(F, matches).max() < 1e-9
    moved = matches + rng.normal(0, 5, matches.shape)
    for match, distance in zip(moved, distance_px(F, moved), strict=True):
        a, b = np.append(match[:2], 1.0), np.append(match[2:], 1.0)
        right, left = F @ a, F.T @ b
        expected = max(abs(right @ b) / np.hypot(*right[:2]), abs(left @ a) / np.hypot(*left[:2]))
        assert distance == pytest.approx(expected, rel=1e-9)


def test_the_gate_learns_a_rig_whose_rows_do_not_correspond() -> None:
    rng = np.random.default_rng(1)
    matches, F = rig(rng, 200)
    noisy = matches + rng.normal(0, 0.3, matches.shape)
    wrong = rng.random(200) < 0.25
    noisy[wrong, 2:] = rng.uniform(0, [640, 480], (int(wrong.sum()), 2))
    gate = EpipolarGate(1.5)
    assert gate.agree(noisy[:10]).all(), "nothing is known yet"
    for start in range(0, 200, 10):
        gate.learn(noisy[start : start + 10])
    assert gate.known
    agree = gate.agree(noisy)
    assert agree[~wrong].mean() > 0.95
    far = distance_px(F, noisy) > 10.0
    assert not agree[far].any()
    assert far[wrong].mean() > 0.7


def test_the_gate_is_not_sure_of_anything_in_wild_matches() -> None:
    rng = np.random.default_rng(2)
    gate = EpipolarGate(1.0)
    gate.learn(rng.uniform(0, 480, (300, 4)))
    assert not gate.known
    assert gate.agree(rng.uniform(0, 480, (20, 4))).all()


def test_the_gate_learns_nothing_from_matches_that_are_all_worse_than_its_tolerance() -> None:
    rng = np.random.default_rng(0)
    matches, _ = rig(rng, 30)
    noisy = matches + 0.1 * rng.normal(0, 1, matches.shape)
    for tolerance_px in (1e-6, 1e-3, 0.01):
        gate = EpipolarGate(tolerance_px)
        gate.learn(noisy)
        assert not gate.known


@given(
    seed=st.integers(0, 50),
    angle=st.floats(-0.4, 0.4),
    scale=st.floats(0.8, 1.25),
    gain=st.floats(0.6, 1.2),
)
def test_a_patch_is_found_to_a_small_fraction_of_a_pixel(
    seed: int, angle: float, scale: float, gain: float
) -> None:
    """Turned, scaled, moved and darkened, it is where the map says; the guess is a pixel and a half off."""
    rng = np.random.default_rng(seed)
    image = cv2.GaussianBlur(texture.random_texture(rng, 160, 20, 200)[..., 0], (0, 0), 1.5)
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    A = np.array([[c, -s], [s, c]])
    at, to = np.array([80.3, 79.6]), np.array([82.7, 77.9])
    M = np.column_stack([A, to - A @ at])
    moved = np.clip(gain * cv2.warpAffine(image, M, (160, 160), flags=cv2.INTER_CUBIC) + 5, 0, 255)
    found = align(take(image, at), moved.astype(np.uint8), A, to + np.array([1.2, -0.9]), 3.0)
    assert found is not None
    assert found.similarity > 0.97
    assert np.linalg.norm(found.pixel - to) < 0.1


def test_a_patch_is_not_found_where_it_is_not() -> None:
    rng = np.random.default_rng(0)
    image, other = (texture.random_texture(rng, 160, 0, 255)[..., 0] for _ in range(2))
    patch = take(image, np.array([80.0, 80.0]))
    found = align(patch, other, np.eye(2), np.array([80.0, 80.0]), 3.0)
    assert found is None or found.similarity < 0.8
    assert align(patch, image, np.eye(2), np.array([-50.0, 80.0]), 3.0) is None
    assert align(patch, image, np.eye(2), np.array([np.nan, 80.0]), 3.0) is None


def test_steps_unlike_their_neighbours_are_told() -> None:
    rng = np.random.default_rng(0)
    before = rng.uniform(0, 640, (60, 2))
    now = before + np.array([30.0, -5.0]) + rng.normal(0, 2, (60, 2))
    jumps = rng.choice(60, 6, replace=False)
    now[jumps] += 200.0
    expected = np.ones(60, bool)
    expected[jumps] = False
    np.testing.assert_array_equal(along(before, now), expected)


def test_a_region_turns_and_grows_with_what_is_in_it() -> None:
    rng = np.random.default_rng(0)
    region = of_rectangle((100.0, 50.0, 40.0, 30.0))
    before = rng.uniform([100, 50], [140, 80], (12, 2))
    A, t = 1.3 * np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([20.0, -10.0])
    moved = region.moved(before, before @ A.T + t)
    np.testing.assert_allclose(moved.corners, region.corners @ A.T + t, atol=1e-6)
    few = region.moved(before[:2], before[:2] + np.array([7.0, 3.0]))
    np.testing.assert_allclose(few.corners, region.corners + np.array([7.0, 3.0]))
    assert region.moved(before[:0], before[:0]) is region
    inside = region.contains(np.array([[120.0, 60.0], [99.0, 60.0], [120.0, 81.0]]))
    np.testing.assert_array_equal(inside, [True, False, False])
    mask = region.mask(grey(np.zeros((120, 200, 3), np.uint8)))
    assert mask[60, 120] == 255
    assert mask[60, 90] == 0
