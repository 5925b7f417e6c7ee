"""The fields of messages, from what is known of one moment."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Size = tuple[int, int]


def header(time_ns: int, frame_id: str) -> dict[str, object]:
    """Return a std_msgs/Header."""
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": frame_id}


def pose_stamped(
    time_ns: int, frame_id: str, position: Iterable[float], quaternion_xyzw: Iterable[float]
) -> dict[str, object]:
    """Return a geometry_msgs/PoseStamped."""
    pose = {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", quaternion_xyzw, strict=True)),
    }
    return {"header": header(time_ns, frame_id), "pose": pose}


def compressed_image(time_ns: int, frame_id: str, form: str, data: bytes) -> dict[str, object]:
    """Return a sensor_msgs/CompressedImage of `jpeg` or `png` data."""
    return {"header": header(time_ns, frame_id), "format": form, "data": data}


def stereo_tracks(
    time_ns: int,
    sizes: tuple[Size, Size] | None,
    names: Sequence[str],
    rows: Sequence[Sequence[float]],
    quality: Sequence[float] | None = None,
) -> dict[str, object]:
    """Return a vmf.StereoTracks of pixels `x_L, y_L, x_R, y_R`, NaN where not seen."""
    message: dict[str, object] = {"timestamp": json_stamp(time_ns)}
    if sizes is not None:
        message |= {"left_size": list(sizes[0]), "right_size": list(sizes[1])}
    tracks: list[dict[str, object]] = [
        {"id": name, "left": _pixel_or_null(xy[:2]), "right": _pixel_or_null(xy[2:])}
        for name, xy in zip(names, rows, strict=True)
    ]
    if quality is not None:
        tracks = [{**track, "quality": q} for track, q in zip(tracks, quality, strict=True)]
    return {**message, "tracks": tracks}


def json_stamp(time_ns: int) -> dict[str, int]:
    """Return a time as JSON messages have it."""
    return {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}


def _pixel_or_null(xy: Sequence[float]) -> list[float] | None:
    return None if xy[0] != xy[0] or xy[1] != xy[1] else list(xy)
