"""Reading a recording into tracks, against walking through the same file with the plain library."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.decoder import DecoderFactory as PlainDecoderFactory
from mcap.reader import make_reader
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory

from vmf.bench.clock import in_turns
from vmf.bench.figure import Effort, Figure, faster, quicker
from vmf.data.recording import POSE_TOPIC, TRACKS_TOPIC, read, write
from vmf.data.simulate import simulate, trial_streams
from vmf.spec import PoseSource, Recording, TrackSource, loads

_SPEC = """
task: six_dof
data:
  simulate: {{frames: {frames}, targets: {targets}, motion: hand_guided, seed: 1}}
"""


def figure(effort: Effort) -> Figure:
    """Measure reading in frames and bytes per second on a recording simulated for the purpose."""
    frames, targets = (40, 5) if effort.quick else (2000, 40)
    spec = loads(_SPEC.format(frames=frames, targets=targets), "bench").spec
    simulation = simulate(spec, trial_streams(spec, 0)[0])
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "bench.mcap"
        write(path, simulation.tracks, simulation.poses, spec.mounting)
        source = Recording(
            path=path.name, pose=PoseSource(topic=POSE_TOPIC), tracks=TrackSource(topic=TRACKS_TOPIC)
        )
        candidates: dict[str, Callable[[], Any]] = {
            "ours": lambda: read(source, spec.mounting, path.parent),
            "plain": lambda: _walk(path),
            "decoded": lambda: _walk_decoded(path),
        }
        tracks = read(source, spec.mounting, path.parent).tracks
        megabytes = path.stat().st_size / 1e6
        times = in_turns(candidates, effort.repeats)
    ours = "read(): joined, checked tracks"
    note = f"{tracks.n_frames} frames, {len(tracks.frame)} observations, all of those written"
    if len(tracks.frame) != len(simulation.tracks.frame):
        raise RuntimeError("the recording does not give back what was written")
    case = f"{frames} frames, {megabytes:.1f} MB"
    rows = []
    for key, other in (
        ("plain", "mcap iteration with CRC, nothing decoded"),
        ("decoded", "mcap iteration with CRC, ROS 2, protobuf and JSON decoded"),
    ):
        rows.append(faster(case, (ours, times["ours"]), (other, times[key]), note))
        for quantity, unit in ((frames, "frames/s"), (megabytes, "MB/s")):
            rows.append(
                quicker(
                    case,
                    (ours, quantity / times["ours"].seconds),
                    (other, quantity / times[key].seconds),
                    unit,
                )
            )
    return Figure("recordings", "reading an MCAP recording", tuple(rows))


def _walk(path: Path) -> int:
    with open(path, "rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())


def _walk_decoded(path: Path) -> list[Any]:
    factories = [DecoderFactory(), ProtobufFactory(), _Json()]
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=factories)
        return [decoded for *_, decoded in reader.iter_decoded_messages()]


class _Json(PlainDecoderFactory):
    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], Any] | None:
        return json.loads if message_encoding == "json" else None
