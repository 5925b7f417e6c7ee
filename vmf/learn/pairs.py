"""The equations that Algorithm 1 forms from pairs of observations of one target (§5.1, Fig. 5.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.estimate import augmented_rows
from vmf.geometry import inverse
from vmf.tasks import Task

Floats = NDArray[np.float64]


def pair_rows(task: Task, E_i: Floats, u_i: Floats, E_c: Floats, u_c: Floats) -> Floats:
    """Return the augmented rows (…, 2, 2, 3k+3) of pairs (i → c), for the left and the right camera.

    Parameters
    ----------
    task : the task space.
    E_i, E_c : (…, 4, 4) poses at the observation and at the centre.
    u_i, u_c : (…, 2, 2) pixels of both cameras.
    """
    x_bar = task.lift(E_i @ inverse(E_c))
    return augmented_rows(x_bar[..., None, :], u_i - u_c)
