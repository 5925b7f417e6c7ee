"""What every way to run Algorithm 1 pair by pair keeps of the one target it is measured with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.approximate import SlotTable, Tiling
from vmf.data.growing import Growing
from vmf.tasks import Task

Floats = NDArray[np.float64]


class OneTarget:
    """Poses, pixels and slots of the observations of one target.

    Parameters
    ----------
    task : the task space.
    tiling : the overlays.
    """

    def __init__(self, task: Task, tiling: Tiling) -> None:
        self.task, self.table = task, SlotTable(tiling)
        self.n = 3 * (task.n_lift + 1)
        self._E: Growing[np.float64] = Growing((4, 4), np.float64)
        self._u: Growing[np.float64] = Growing((2, 2), np.float64)
        self._slots: list[list[int]] = []

    def _keep_observation(self, E: Floats, code: Floats) -> None:
        """Keep a pose (4, 4), a stereo code (4,) as pixels, and the slots of its tiles."""
        self.table.visit(code[None])
        slots, own = self.table.find(code[None])
        self._slots.append(slots[0, own[0]].tolist())
        self._E.append(E[None])
        self._u.append(code.reshape(1, 2, 2))
