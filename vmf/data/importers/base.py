"""What every importer offers, and what most formats come down to: poses, and images or tracks."""

from __future__ import annotations

import heapq
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vmf.data.importers.image_files import ImageList
from vmf.data.importers.pose_rows import PoseRows
from vmf.data.importers.sightings import Usable
from vmf.data.poses import BodyPoses
from vmf.data.recording import IMAGE_TOPICS, POSE_TOPIC, TRACKS_TOPIC, schemas
from vmf.data.recording.encode import compressed_image, pose_stamped, stereo_tracks
from vmf.data.recording.foxglove import OBSERVED, Camera, Drawn
from vmf.data.recording.observations import TARGETS_KEY, Observations
from vmf.data.recording.output import Output
from vmf.data.recording.shown import CAMERA_FRAMES, Frames, show_body, show_cameras, show_targets
from vmf.data.recording.transforms import Stream
from vmf.errors import Loss
from vmf.spec.base import Model

# A time in ns, and what to write at that time.
_Step = tuple[int, Callable[[], None]]


class Importable(Protocol):
    """A source that has been looked at, ready to be written as a recording."""

    @property
    def total(self) -> int:
        """How many poses, images and frames of tracks there are, with those that turn out damaged."""

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What could not be used; complete once `write` has come to its end."""

    @property
    def repairs(self) -> tuple[Loss, ...]:
        """What was put right without loss."""

    @property
    def left_out(self) -> tuple[str, ...]:
        """Topics of the source that nothing here reads."""

    def write(self, out: Output) -> Iterator[None]:
        """Write one after the other in order of time, stopping after each, lost ones too.

        Raises
        ------
        InputError : nothing of what is needed can be used.
        """


@dataclass(frozen=True)
class Format:
    """A format that can be imported: the settings it takes, and how to look at a source."""

    options: type[Model]
    look: Callable[[Path, Any], Importable]


@dataclass(frozen=True)
class Streams:
    """Poses with stereo images or tracks, each in order of its own times, for the usual topics.

    Attributes
    ----------
    poses : of the moving frame in a fixed one.
    images : of the left and the right camera.
    cameras : the left and the right one, where their calibration is known.
    found : what was lost while the source was looked at.
    """

    poses: Stream
    images: tuple[ImageList, ImageList] | None = None
    tracks: Observations | None = None
    cameras: tuple[Camera, Camera] | None = None
    found: tuple[Loss, ...] = ()
    repairs: tuple[Loss, ...] = ()

    @classmethod
    def of(
        cls,
        poses: PoseRows,
        images: tuple[ImageList, ImageList] | None = None,
        tracks: Usable | None = None,
        cameras: tuple[Camera, Camera] | None = None,
        found: tuple[Loss, ...] = (),
    ) -> Streams:
        """Return what a format has found, `found` being what was lost beside.

        Raises
        ------
        InputError : there is no usable pose.
        """
        stream, losses, repairs = poses.stream()
        if tracks is not None:
            losses, repairs = losses + tracks.losses, repairs + tracks.repairs
        for camera in images or ():
            repairs += camera.repairs
        seen = None if tracks is None else tracks.seen
        return cls(stream, images, seen, cameras, losses + found, repairs)

    @property
    def total(self) -> int:
        images = sum(len(camera.files) for camera in self.images or ())
        return len(self.poses.times_ns) + images + (0 if self.tracks is None else len(self.tracks.times_ns))

    @property
    def _start_ns(self) -> int:
        times = [self.poses.times_ns, *(camera.times_ns for camera in self.images or ())]
        return min(int(each[0]) for each in times)

    @property
    def left_out(self) -> tuple[str, ...]:
        return ()

    @property
    def losses(self) -> tuple[Loss, ...]:
        return self.found + tuple(loss for camera in self.images or () for loss in camera.losses)

    def write(self, out: Output) -> Iterator[None]:
        streams = [_poses(self.poses, out)]
        if self.tracks is not None:
            streams.append(_tracks(self.tracks, out))
        for number, camera in enumerate(self.images or ()):
            streams.append(_images(camera, number, out))
        if self.cameras is not None:
            show_cameras(out, self.cameras, Frames.of("eye_in_hand"), self._start_ns)
        # Every stream is one step ahead: no more than one image of each camera is in memory.
        for _, write in heapq.merge(*streams, key=lambda step: step[0]):
            write()
            yield
        for camera in self.images or ():
            camera.check()


def _poses(stream: Stream, out: Output) -> Iterator[_Step]:
    frames = Frames.of("eye_in_hand")
    E = BodyPoses(stream.values[:, :3], stream.values[:, 3:]).motions(frames.mounting)

    def write(i: int, time: int) -> None:
        row = stream.values[i].tolist()
        message = pose_stamped(time, frames.fixed, row[:3], row[3:])
        out.ros(POSE_TOPIC, schemas.POSE_STAMPED, schemas.POSE_STAMPED_TEXT, message, time)
        show_body(out, E[i], frames, time)

    for i, time in enumerate(stream.times_ns.tolist()):
        yield time, partial(write, i, time)


def _images(camera: ImageList, number: int, out: Output) -> Iterator[_Step]:
    topic, frame_id = IMAGE_TOPICS[number], CAMERA_FRAMES[number]
    schema, text = schemas.COMPRESSED_IMAGE, schemas.COMPRESSED_IMAGE_TEXT
    for time, picture in camera.pictures():
        if picture is None:
            yield time, lambda: None
        else:
            message = compressed_image(time, frame_id, picture.form, picture.data)
            yield time, partial(out.ros, topic, schema, text, message, time)


def _tracks(tracks: Observations, out: Output) -> Iterator[_Step]:
    order = np.lexsort((tracks.target, tracks.frame))
    starts = np.searchsorted(tracks.frame[order], np.arange(len(tracks.times_ns) + 1))
    sizes = None if tracks.image_size is None else (tracks.image_size, tracks.image_size)
    targets = {TARGETS_KEY: json.dumps(tracks.ids)}

    def write(frame: int, time: int) -> None:
        seen = order[starts[frame] : starts[frame + 1]]
        names, pixels = [tracks.ids[k] for k in tracks.target[seen].tolist()], tracks.pixels[seen]
        message = stereo_tracks(time, sizes, names, pixels.tolist())
        out.json(TRACKS_TOPIC, schemas.STEREO_TRACKS, schemas.STEREO_TRACKS_TEXT, message, time, targets)
        for camera in range(2):
            show_targets(out, [Drawn(OBSERVED, names, pixels)], camera, time)

    for frame, time in enumerate(tracks.times_ns.tolist()):
        yield time, partial(write, frame, time)
