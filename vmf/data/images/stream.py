"""Stereo image pairs out of a recording, one after the other, with never more than a few in memory.

The file is read twice: first for the time stamps, which say which images belong together, however the file
orders them, then for the pixels, by one reader for each camera.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vmf.data.images.decode import ImageReader
from vmf.data.images.raw import Image
from vmf.data.images.topics import stereo_topics
from vmf.data.recording import schemas
from vmf.data.recording.container import Contents, RawMessage, Topic, messages, visit
from vmf.data.recording.damage import DamagedError, reason
from vmf.data.recording.synchronise import in_order
from vmf.errors import InputError, Loss
from vmf.spec.images import ImageSource

Ints = NDArray[np.int64]

# Undecoded images of one camera that wait because the file holds them out of time order.
_HELD = 8


@dataclass(frozen=True)
class ImagePair:
    """What both cameras saw at one time.

    Attributes
    ----------
    time_ns : midway between the two time stamps.
    log_time_ns : when the recorder had both.
    left, right : (height, width) in grey or (height, width, 3) in RGB.
    """

    time_ns: int
    log_time_ns: int
    left: Image = field(repr=False)
    right: Image = field(repr=False)


@dataclass
class _Seen:
    """Time stamps of one topic, in file order, with the number of the message each belongs to."""

    count: int = 0
    times_ns: list[int] = field(default_factory=list)
    index: list[int] = field(default_factory=list)
    malformed: int = 0
    why: str = ""


class StereoImages:
    """The stereo pairs of a recording; `losses` is complete once `pairs` has come to its end.

    Attributes
    ----------
    contents : what the recording holds, its own damage included.
    left, right : the topics.
    stamps_ns : (n, 2) times of the left and the right images.
    times_ns : (n,) times of the pairs, each midway between those of its images.
    repairs : which images were put in order without loss.
    """

    def __init__(self, path: Path, source: ImageSource) -> None:
        """Find the pairs.

        Raises
        ------
        InputError : the file or a topic is wrong, or no image of one camera goes with one of the other.
        """
        self._reader = ImageReader()
        self._seen: dict[str, _Seen] = {}
        self.contents: Contents = visit(path, _shows_images, self._note)
        self.left, self.right = stereo_topics(self.contents, source.left, source.right)
        self._losses: list[Loss] = []
        self.repairs: tuple[Loss, ...] = ()
        left, right = self._in_order(self.left), self._in_order(self.right)
        tolerance_ns = round(source.pair_tolerance_s * 1e9)
        pairs = paired(left.times_ns, right.times_ns, tolerance_ns)
        for topic, other, n, kept in (
            (self.left, self.right, len(left.times_ns), pairs[0]),
            (self.right, self.left, len(right.times_ns), pairs[1]),
        ):
            if n > len(kept):
                what = f"images without a partner on {other} within {source.pair_tolerance_s:g} s dropped"
                self._losses.append(Loss(topic, what, n - len(kept)))
        if not len(pairs[0]):
            raise InputError(
                f"{path}: no image on {self.left} has a partner on {self.right} within "
                f"{source.pair_tolerance_s:g} s; the closest two are {_closest_s(left, right):.6g} s apart"
            )
        self._index = left.index[pairs[0]], right.index[pairs[1]]
        self.stamps_ns: Ints = np.stack([left.times_ns[pairs[0]], right.times_ns[pairs[1]]], axis=1)
        self.times_ns: Ints = self.stamps_ns.sum(axis=1) // 2

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.times_ns)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Which images could not be used so far; what is damaged in the file stands in `contents`."""
        return tuple(self._losses)

    def pairs(self, grey: bool) -> Iterator[ImagePair | None]:
        """Yield the pairs in order of time, None for one that is damaged; the next is decoded meanwhile."""
        cameras = _Decoder(self._reader, self.left, grey), _Decoder(self._reader, self.right, grey)
        with ThreadPoolExecutor(2) as pool:
            waiting: _Submitted | None = None
            for time, *both in zip(self.times_ns.tolist(), *self._messages(), strict=True):
                log_time = max((m.log_time_ns for m in both if m is not None), default=time)
                images = tuple(c.submit(pool, m) for c, m in zip(cameras, both, strict=True))
                due, waiting = waiting, _Submitted(time, log_time, images)
                if due is not None:
                    yield due.result(cameras)
            if waiting is not None:
                yield waiting.result(cameras)
        for camera in cameras:
            self._losses += camera.losses()

    def _note(self, message: RawMessage) -> None:
        seen = self._seen.setdefault(message.topic.name, _Seen())
        seen.count += 1
        try:
            time = self._reader.stamp(message)
        except (DamagedError, InputError) as error:
            seen.malformed, seen.why = seen.malformed + 1, seen.why or reason(error)
            return
        seen.times_ns.append(time)
        seen.index.append(seen.count - 1)

    def _in_order(self, topic: str) -> _Stamps:
        seen = self._seen[topic]
        if seen.malformed:
            what = f"malformed image messages dropped; first: {seen.why}"
            self._losses.append(Loss(topic, what, seen.malformed))
        if not seen.times_ns:
            raise InputError(f"{self.contents.path}: {topic} holds no usable image", *map(str, self._losses))
        times = np.array(seen.times_ns, np.int64)
        order = in_order(times, topic)
        self._losses += order.losses
        self.repairs += order.repairs
        return _Stamps(times[order.keep], np.array(seen.index, np.int64)[order.keep])

    def _messages(self) -> tuple[Iterator[RawMessage | None], Iterator[RawMessage | None]]:
        return (
            _in_turn(self.contents.path, self.left, self._index[0]),
            _in_turn(self.contents.path, self.right, self._index[1]),
        )


class _Decoder:
    """Decodes the images of one topic and counts those that cannot be used."""

    def __init__(self, reader: ImageReader, topic: str, grey: bool) -> None:
        self._reader, self._topic, self._grey = reader, topic, grey
        self._size: tuple[int, ...] | None = None
        self._lost: Counter[str] = Counter()
        self._why = ""

    def submit(self, pool: ThreadPoolExecutor, message: RawMessage | None) -> Future[Image] | None:
        return None if message is None else pool.submit(self._reader.image, message, self._grey)

    def result(self, future: Future[Image] | None) -> Image | None:
        if future is None:
            self._lost["images too far out of time order dropped"] += 1
            return None
        try:
            image = future.result()
        except DamagedError as error:
            self._why = self._why or reason(error)
            self._lost[f"damaged images dropped; first: {self._why}"] += 1
            return None
        size = self._size = self._size or image.shape[1::-1]
        if image.shape[1::-1] != size:
            self._lost[f"images of another size than {size[0]}x{size[1]} dropped"] += 1
            return None
        return image

    def losses(self) -> list[Loss]:
        return [Loss(self._topic, what, n) for what, n in self._lost.items()]


@dataclass(frozen=True)
class _Submitted:
    """A pair that is being decoded."""

    time_ns: int
    log_time_ns: int
    images: tuple[Future[Image] | None, ...]

    def result(self, cameras: tuple[_Decoder, _Decoder]) -> ImagePair | None:
        left, right = (camera.result(image) for camera, image in zip(cameras, self.images, strict=True))
        if left is None or right is None:
            return None
        return ImagePair(self.time_ns, self.log_time_ns, left, right)


@dataclass(frozen=True)
class _Stamps:
    """Time stamps (n,) in order, and the numbers of their messages."""

    times_ns: Ints
    index: Ints


def paired(left_ns: Ints, right_ns: Ints, tolerance_ns: int) -> tuple[Ints, Ints]:
    """Return the indices (n,) of images that are each other's nearest in time, within the tolerance.

    Both lists of times are strictly increasing; of two equally near images the earlier one is taken.
    """
    to_right, to_left = _nearest(left_ns, right_ns), _nearest(right_ns, left_ns)
    mutual = to_left[to_right] == np.arange(len(left_ns))
    close = np.abs(right_ns[to_right] - left_ns) <= tolerance_ns
    first = np.flatnonzero(mutual & close)
    return first, to_right[first]


def _nearest(times: Ints, among: Ints) -> Ints:
    after = np.clip(np.searchsorted(among, times), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    earlier = np.abs(times - among[before]) <= np.abs(among[after] - times)
    return np.where(earlier, before, after)


def _closest_s(left: _Stamps, right: _Stamps) -> float:
    nearest = right.times_ns[_nearest(left.times_ns, right.times_ns)]
    return float(np.abs(nearest - left.times_ns).min()) / 1e9


def _shows_images(topic: Topic) -> bool:
    return topic.schema in schemas.IMAGE_SCHEMAS


def _in_turn(path: Path, topic: str, index: Ints) -> Iterator[RawMessage | None]:
    """Yield the messages of a topic by their numbers `index`, None for one that lies too far out of order."""
    turn = {number: rank for rank, number in enumerate(index.tolist())}
    held: dict[int, RawMessage] = {}
    due = 0
    for number, message in enumerate(messages(path, lambda t: t.name == topic and _shows_images(t))):
        rank = turn.get(number)
        if rank is None or rank < due:
            continue
        held[rank] = message
        if len(held) > _HELD:
            # The one awaited comes too late to be worth more memory.
            while due not in held:
                yield None
                due += 1
        while due in held:
            yield held.pop(due)
            due += 1
    while due < len(index):
        yield held.pop(due, None)
        due += 1
