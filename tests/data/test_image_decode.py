"""Every kind of image message becomes the picture it was made from, or is refused as damaged."""

from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from hypothesis import given
from hypothesis import strategies as st
from image_files import (
    LEFT,
    RIGHT,
    ImageFile,
    encoded,
    json_compressed,
    picture,
    ros_compressed,
    ros_raw,
    stereo,
)
from PIL import Image as Pictures
from recording_files import START_NS

from vmf.data.images.compressed import from_compressed
from vmf.data.images.raw import MAX_PIXELS, from_raw
from vmf.data.recording import schemas
from vmf.data.recording.damage import DamagedError

PICTURE = picture()
HEIGHT, WIDTH = PICTURE.shape[:2]
# ITU-R BT.601, the grey that OpenCV, Pillow and JPEG agree on.
LUMA = PICTURE @ np.array([0.299, 0.587, 0.114])
BAYER = {"rggb": (0, 1, 1, 2), "bggr": (2, 1, 1, 0), "gbrg": (1, 2, 0, 1), "grbg": (1, 0, 2, 1)}


def decoded(data: np.ndarray, encoding: str, grey: bool, big_endian: bool = False) -> np.ndarray:
    size = (data.shape[1], data.shape[0])
    return from_raw(data.tobytes(), encoding, size, data.nbytes // size[1], big_endian, grey)


def with_alpha(image: np.ndarray) -> np.ndarray:
    return np.dstack([image, np.full(image.shape[:2], 7, np.uint8)])


@pytest.mark.parametrize(
    ("encoding", "data"),
    [
        ("rgb8", PICTURE),
        ("bgr8", PICTURE[..., ::-1]),
        ("8UC3", PICTURE[..., ::-1]),
        ("rgba8", with_alpha(PICTURE)),
        ("bgra8", with_alpha(PICTURE[..., ::-1])),
        ("rgb16", PICTURE.astype("<u2") * 256 + 99),
        ("bgr16", PICTURE[..., ::-1].astype("<u2") * 256),
    ],
)
def test_colours_come_back(encoding: str, data: np.ndarray) -> None:
    np.testing.assert_array_equal(decoded(np.ascontiguousarray(data), encoding, grey=False), PICTURE)
    grey = decoded(np.ascontiguousarray(data), encoding, grey=True)
    assert np.abs(grey - LUMA).max() <= 1.0


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_stays_grey(encoding: str) -> None:
    grey = PICTURE[..., 1].copy()
    np.testing.assert_array_equal(decoded(grey, encoding, grey=True), grey)
    np.testing.assert_array_equal(decoded(grey, encoding, grey=False), np.dstack([grey] * 3))


@pytest.mark.parametrize(("order", "big"), [("<u2", False), (">u2", True)])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_the_upper_bits_are_kept_whatever_the_order_of_bytes(encoding: str, order: str, big: bool) -> None:
    deep = np.arange(0, 65536, 13, np.uint16)[:1200].reshape(30, 40)
    seen = decoded(deep.astype(order), encoding, grey=True, big_endian=big)
    np.testing.assert_array_equal(seen, deep >> 8)


@pytest.mark.parametrize("encoding", ["yuv422", "uyvy", "yuv422_yuy2", "yuyv"])
def test_yuv_follows_bt_601(encoding: str) -> None:
    rng = np.random.default_rng(0)
    y, u, v = (
        rng.integers(60, 180, (30, 40)),
        rng.integers(100, 156, (30, 20)),
        rng.integers(100, 156, (30, 20)),
    )
    data = np.empty((30, 40, 2), np.uint8)
    luma, chroma = (1, 0) if encoding in ("yuv422", "uyvy") else (0, 1)
    data[..., luma] = y
    data[:, ::2, chroma], data[:, 1::2, chroma] = u, v
    scaled, blue, red = 1.164 * (y - 16.0), np.repeat(u - 128.0, 2, axis=1), np.repeat(v - 128.0, 2, axis=1)
    expected = np.stack(
        [scaled + 1.596 * red, scaled - 0.813 * red - 0.391 * blue, scaled + 2.018 * blue], axis=-1
    )
    assert np.abs(decoded(data, encoding, grey=False) - np.clip(expected, 0, 255)).max() <= 1.5
    np.testing.assert_array_equal(decoded(data, encoding, grey=True), y)


@pytest.mark.parametrize("pattern", BAYER)
@pytest.mark.parametrize("bits", [8, 16])
def test_a_mosaic_of_one_colour_is_that_colour(pattern: str, bits: int) -> None:
    colour = np.array([200, 100, 30])
    mosaic = np.empty((30, 40), np.uint8)
    for k, channel in enumerate(BAYER[pattern]):
        mosaic[k // 2 :: 2, k % 2 :: 2] = colour[channel]
    data = mosaic if bits == 8 else mosaic.astype("<u2") * 256
    seen = decoded(data, f"bayer_{pattern}{bits}", grey=False)
    np.testing.assert_array_equal(seen[2:-2, 2:-2], np.broadcast_to(colour, (26, 36, 3)))
    grey = decoded(data, f"bayer_{pattern}{bits}", grey=True)
    assert np.abs(grey[2:-2, 2:-2] - colour @ [0.299, 0.587, 0.114]).max() <= 1.0


@pytest.mark.parametrize("encoding", ["rgb8", "mono8", "mono16", "yuyv", "bayer_rggb8"])
def test_padding_at_the_end_of_rows_is_not_shown(encoding: str) -> None:
    n = {"rgb8": 3, "mono8": 1, "mono16": 2, "yuyv": 2, "bayer_rggb8": 1}[encoding]
    rows = np.random.default_rng(0).integers(0, 256, (30, 40 * n), np.uint8)
    padded = np.hstack([rows, np.full((30, 5), 77, np.uint8)])
    for grey in (True, False):
        plain = from_raw(rows.tobytes(), encoding, (40, 30), 40 * n, False, grey)
        np.testing.assert_array_equal(
            from_raw(padded.tobytes(), encoding, (40, 30), 40 * n + 5, False, grey), plain
        )


@pytest.mark.parametrize(
    ("encoding", "size", "step", "words"),
    [
        ("rgb8", (40, 30), 119, "rows of 119 bytes, 40 pixels of rgb8 need 120"),
        ("rgb8", (40, 31), 120, "31 rows of 120 bytes but holds 3600 bytes"),
        ("rgb8", (0, 30), 120, "0x30"),
        ("rgb8", (2**16, 2**16), 2**18, f"more than the {MAX_PIXELS} accepted"),
        ("mono8", (MAX_PIXELS + 1, 1), MAX_PIXELS + 1, "more than"),
        ("32FC1", (40, 30), 120, "encoding '32FC1'; accepted: mono8"),
        ("yuyv", (39, 30), 120, "even number"),
    ],
)
def test_sizes_that_contradict_each_other_are_refused(
    encoding: str, size: tuple[int, int], step: int, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        from_raw(PICTURE.tobytes(), encoding, size, step, False, grey=False)


@pytest.mark.parametrize("form", ["png", "jpeg"])
def test_compressed_pictures_come_back(form: str) -> None:
    # Chroma is kept whole; quantisation at quality 95 leaves a few grey levels.
    data = encoded(PICTURE, form, **({"quality": 95, "subsampling": 0} if form == "jpeg" else {}))
    most = 0 if form == "png" else 8
    assert np.abs(from_compressed(data, grey=False).astype(int) - PICTURE).max() <= most
    assert np.abs(from_compressed(data, grey=True) - LUMA).max() <= most + 1
    grey = encoded(PICTURE[..., 0], form)
    assert np.abs(from_compressed(grey, grey=True).astype(int) - PICTURE[..., 0]).max() <= most
    assert from_compressed(grey, grey=False).shape == PICTURE.shape


def test_deep_and_transparent_pngs_are_read() -> None:
    deep = np.arange(1200, dtype=np.uint16).reshape(30, 40) * 50
    np.testing.assert_array_equal(from_compressed(encoded(deep), grey=True), deep >> 8)
    assert from_compressed(encoded(deep), grey=False).shape == (30, 40, 3)
    np.testing.assert_array_equal(from_compressed(encoded(with_alpha(PICTURE)), grey=False), PICTURE)


def test_a_camera_that_was_held_upright_is_not_turned() -> None:
    exif = Pictures.Exif()
    exif[0x0112] = 6  # orientation: turn by a quarter
    assert from_compressed(encoded(PICTURE, "jpeg", exif=exif), grey=False).shape == PICTURE.shape


@pytest.mark.parametrize("form", ["png", "jpeg"])
@pytest.mark.parametrize("grey", [True, False])
def test_a_picture_cut_short_is_damaged(form: str, grey: bool) -> None:
    data = encoded(PICTURE, form)
    for end in (0, 1, 10, len(data) // 3, len(data) * 2 // 3):
        with pytest.raises(DamagedError):
            from_compressed(data[:end], grey)


def png_that_claims(width: int, height: int) -> bytes:
    head = struct.pack(">II5B", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes(1000))
    parts = [(b"IHDR", head), (b"IDAT", data), (b"IEND", b"")]
    chunks = [struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in parts]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def test_a_small_file_that_declares_a_huge_picture_takes_no_memory() -> None:
    tracemalloc.start()
    with pytest.raises(ValueError, match="60000x60000 pixels, more than"):
        from_compressed(png_that_claims(60000, 60000), grey=False)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20


@given(
    form=st.sampled_from(["png", "jpeg"]),
    grey=st.booleans(),
    flips=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 7)), max_size=8),
    end=st.integers(0, 10**6),
)
def test_damage_is_a_picture_or_damage(form: str, grey: bool, flips: list[tuple[int, int]], end: int) -> None:
    data = bytearray(encoded(PICTURE, form))
    for at, bit in flips:
        data[at % len(data)] ^= 1 << bit
    try:
        seen = from_compressed(bytes(data[: end % (2 * len(data))]), grey)
    except DamagedError:
        return
    assert seen.dtype == np.uint8
    assert seen.ndim == (2 if grey else 3)


@given(
    st.binary(max_size=64),
    st.text(max_size=12),
    st.integers(0, 300),
    st.integers(0, 300),
    st.integers(0, 10**6),
)
def test_any_raw_message_is_a_picture_or_damage(
    data: bytes, encoding: str, w: int, h: int, step: int
) -> None:
    with pytest.raises(DamagedError):
        from_raw(data, encoding, (w + 9, h + 9), step, False, grey=True)


def test_all_four_schemas_in_their_encodings_say_the_same(tmp_path: Path) -> None:
    data = encoded(PICTURE)
    raw = RawImage(
        frame_id="c", width=WIDTH, height=HEIGHT, encoding="rgb8", step=3 * WIDTH, data=PICTURE.tobytes()
    )
    compressed = CompressedImage(frame_id="c", format="png", data=data)
    for message in (raw, compressed):
        message.timestamp.FromNanoseconds(START_NS)
    json_raw = {**json_compressed(START_NS, PICTURE.tobytes()), "width": WIDTH, "height": HEIGHT}
    json_raw |= {"encoding": "rgb8", "step": 3 * WIDTH}
    ways = {
        "ros raw": lambda f, t: f.ros(t, schemas.IMAGE, ros_raw(START_NS, PICTURE, "rgb8")),
        "ros compressed": lambda f, t: f.ros(t, schemas.COMPRESSED_IMAGE, ros_compressed(START_NS, data)),
        "protobuf raw": lambda f, t: f.protobuf(t, raw),
        "protobuf compressed": lambda f, t: f.protobuf(t, compressed),
        "json raw": lambda f, t: f.json(t, schemas.FOXGLOVE_RAW_IMAGE, json_raw),
        "json compressed": lambda f, t: f.json(
            t, schemas.FOXGLOVE_COMPRESSED_IMAGE, json_compressed(START_NS, data)
        ),
    }
    for name, write in ways.items():
        with ImageFile(tmp_path / f"{name}.mcap") as file:
            write(file, LEFT)
            write(file, RIGHT)
        (pair,) = stereo(tmp_path / f"{name}.mcap").pairs(grey=False)
        assert pair is not None, name
        assert pair.time_ns == START_NS
        np.testing.assert_array_equal(pair.left, PICTURE, err_msg=name)
        np.testing.assert_array_equal(pair.right, PICTURE, err_msg=name)
