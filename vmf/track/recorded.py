"""A tracker over the stereo images of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from vmf.data.images import StereoImages
from vmf.progress import Report
from vmf.spec.images import Tracker as Options
from vmf.track import make_tracker
from vmf.track.base import Sightings
from vmf.track.odometry import Trajectory

Size = tuple[int, int]


@dataclass(frozen=True)
class TrackedFrame:
    """What a tracker saw in one stereo pair.

    Attributes
    ----------
    time_ns, log_time_ns : when the images were taken, and when the recorder had both.
    sizes : (width, height) of the left and the right image.
    """

    time_ns: int
    log_time_ns: int
    sizes: tuple[Size, Size]
    sightings: Sightings


def tracked_frames(
    images: StereoImages,
    options: Options,
    progress: Report | None = None,
    trajectory: Callable[[], Trajectory] | None = None,
) -> Iterator[TrackedFrame]:
    """Yield what a new tracker sees in each pair that is intact; the losses are those of `images`.

    `trajectory` is asked for the robot's way only if the tracker needs it.

    Raises
    ------
    ValueError : the tracker needs it, and there is none.
    """
    with make_tracker(options) as tracker:
        way = trajectory() if trajectory is not None and tracker.needs_odometry else None
        for done, pair in enumerate(images.pairs(grey=not tracker.colour), start=1):
            if pair is not None:
                if way is not None:
                    tracker.moved_to(way.at(pair.time_ns))
                sizes = (pair.left.shape[1], pair.left.shape[0]), (pair.right.shape[1], pair.right.shape[0])
                seen = tracker.step(pair.left, pair.right)
                yield TrackedFrame(pair.time_ns, pair.log_time_ns, sizes, seen)
            if progress is not None:
                progress(done, len(images), "image pairs")
