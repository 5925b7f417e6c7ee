"""The two joints of a pan-tilt unit out of JointState messages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vmf.data.recording.container import RawMessage
from vmf.data.recording.damage import DamagedError, fields, reason
from vmf.data.recording.messages import decoder, listed, number, stamp_ns, text, usable
from vmf.data.recording.transforms import Stream
from vmf.errors import InputError, Loss

_MESSAGE = fields("header.stamp", "name", "position")


def read_joints(
    messages: Sequence[RawMessage], pan: str, tilt: str, place: str
) -> tuple[Stream, tuple[Loss, ...]]:
    """Return the angles (N, 2) in rad of the joints named `pan` and `tilt`.

    Messages about other joints are passed over: drivers share `/joint_states`.

    Raises
    ------
    InputError : no message has both joints; the names present are listed.
    """
    times: list[int] = []
    angles: list[tuple[float, float]] = []
    names: dict[str, None] = {}
    malformed, why, invalid = 0, "", 0
    decode = decoder(messages[0].topic) if messages else None
    for message in messages:
        assert decode is not None
        try:
            stamp, joints, positions = _MESSAGE(decode(message.data))
            if len(listed(joints)) != len(listed(positions)):
                raise DamagedError(f"{len(joints)} joints have {len(positions)} positions")
            position = dict(zip(map(text, joints), positions, strict=True))
            names.update(dict.fromkeys(position))
            if pan not in position or tilt not in position:
                continue
            time, pair = stamp_ns(stamp, message.log_time_ns), (number(position[pan]), number(position[tilt]))
        except DamagedError as error:
            malformed, why = malformed + 1, why or reason(error)
            continue
        if not usable(*pair):
            invalid += 1
            continue
        times.append(time)
        angles.append(pair)
    losses = []
    if malformed:
        losses.append(Loss(place, f"malformed joint messages dropped; first: {why}", malformed))
    if invalid:
        losses.append(Loss(place, "joint angles with NaN, infinite or absurd values dropped", invalid))
    if not times:
        present = ", ".join(sorted(names)) or "none"
        raise InputError(
            f"{place}: no message with both joints {pan!r} and {tilt!r}; names present: {present}",
            *map(str, losses),
        )
    return Stream(np.array(times, np.int64), np.array(angles, float).reshape(-1, 2)), tuple(losses)
