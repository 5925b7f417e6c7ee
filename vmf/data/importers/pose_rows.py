"""Poses from the rows of a table or from arrays, checked as those of a recording are."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vmf.data.importers.tables import Row
from vmf.data.poses import NORM_TOLERANCE
from vmf.data.recording.messages import usable
from vmf.data.recording.synchronise import in_order
from vmf.data.recording.transforms import Stream
from vmf.errors import InputError, Loss

Floats = NDArray[np.float64]
# Where a table has position (m) and quaternion x y z w behind the time.
TUM_ORDER = (1, 2, 3, 4, 5, 6, 7)


@dataclass
class PoseRows:
    """Poses as they are read; those with NaN, infinite or absurd values are counted and left out."""

    place: Path
    _times_ns: list[int] = field(default_factory=list)
    _values: list[tuple[float, ...]] = field(default_factory=list)
    _invalid: int = 0

    def add(self, where: str, time_ns: int, values: tuple[float, ...]) -> None:
        """Take a pose: position x y z (m), quaternion x y z w.

        Raises
        ------
        InputError : the norm of the quaternion is off 1 by more than `NORM_TOLERANCE`.
        """
        if not usable(*values):
            self._invalid += 1
            return
        norm = math.hypot(*values[3:])
        if abs(norm - 1.0) > NORM_TOLERANCE:
            raise InputError(
                f"{where}: found a quaternion of norm {norm:.6g}, 1 within {NORM_TOLERANCE:g} is accepted"
            )
        self._times_ns.append(time_ns)
        self._values.append(values)

    def add_row(self, row: Row, time_ns: int, order: tuple[int, ...] = TUM_ORDER) -> None:
        """Take a pose from the columns (from 0) in which position and quaternion x y z w stand.

        Raises
        ------
        InputError : a column is missing or holds no number, or the quaternion is off.
        """
        row.need(max(order) + 1)
        self.add(row.where, time_ns, tuple(row.number(column) for column in order))

    def add_matrix(self, where: str, time_ns: int, T: Floats) -> None:
        """Take a pose from a motion (3, 4) or (4, 4).

        Raises
        ------
        InputError : it is no rigid motion to within `NORM_TOLERANCE`.
        """
        if not usable(*T.ravel().tolist()):
            self._invalid += 1
            return
        R = T[:3, :3]
        off = float(np.abs(R.T @ R - np.eye(3)).max())
        if off > NORM_TOLERANCE or np.linalg.det(R) < 0.0:
            raise InputError(
                f"{where}: found no rotation (off by {off:.3g}, determinant {np.linalg.det(R):.3g}), "
                f"a rotation within {NORM_TOLERANCE:g} is accepted"
            )
        if len(T) == 4 and np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > NORM_TOLERANCE:
            raise InputError(f"{where}: found the last row {T[3].tolist()}, [0, 0, 0, 1] is accepted")
        quaternion = Rotation.from_matrix(R).as_quat()
        self.add(where, time_ns, (*T[:3, 3].tolist(), *quaternion.tolist()))

    def stream(self) -> tuple[Stream, tuple[Loss, ...], tuple[Loss, ...]]:
        """Return the poses in order of time, what was lost, and what was repaired.

        Raises
        ------
        InputError : there is no pose.
        """
        if not self._times_ns:
            found = f"{self._invalid} with NaN, infinite or absurd values" if self._invalid else "none"
            raise InputError(f"{self.place}: found no usable pose ({found}), at least one is accepted")
        times = np.array(self._times_ns, np.int64)
        order = in_order(times, str(self.place))
        losses = list(order.losses)
        if self._invalid:
            what = "poses with NaN, infinite or absurd values dropped"
            losses.append(Loss(str(self.place), what, self._invalid))
        stream = Stream(times[order.keep], np.array(self._values, float)[order.keep])
        return stream, tuple(losses), order.repairs
