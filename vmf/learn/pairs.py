"""The equations that Algorithm 1 forms from pairs of observations of one target (§5.1, Fig. 5.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vmf.estimate import augmented_rows, update_rank_k
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


def observation_rows(x_bar: Floats, u: Floats) -> Floats:
    """Return `w_i = [x̄_i; x_i x̄_i; y_i x̄_i]` (…, 2, 3k+3) for both cameras (§4, compressed pipeline).

    Parameters
    ----------
    x_bar : (…, k+1) lifts of the observations' poses.
    u : (…, 2, 2) pixels of both cameras.
    """
    x = x_bar[..., None, :]
    x = np.broadcast_to(x, (*u.shape[:-1], x.shape[-1]))
    return np.concatenate([x, u[..., :1] * x, u[..., 1:] * x], axis=-1)


def centre_factors(task: Task, R_w: Floats, E_c: Floats, u_c: Floats) -> Floats:
    """Return the factors (V, 2, 3k+3, 3k+3) of centres over all observations of their target.

    Every pair's augmented rows are linear in `w_i`: they are `B_x(c) w_i` and `B_y(c) w_i`, so
    `qr([R_w B_xᵀ; R_w B_yᵀ])` holds all pairs of the centre without visiting one (§4).

    Parameters
    ----------
    task : the task space.
    R_w : (V, 2, 3k+3, 3k+3) factors of `w_i` of each centre's target, for both cameras.
    E_c : (V, 4, 4) pose of each centre, in the frame of the lifts in `w_i`.
    u_c : (V, 2, 2) pixels of each centre, measured from where those in `w_i` are.
    """
    n = task.n_lift + 1
    L = task.closure(E_c)[:, None]
    L_T = np.swapaxes(L, -1, -2)
    one, x, y = R_w[..., :n] @ L_T, R_w[..., n : 2 * n] @ L_T, R_w[..., 2 * n :] @ L_T
    x_error = x - u_c[..., 0, None, None] * one
    y_error = y - u_c[..., 1, None, None] * one
    nothing = np.zeros_like(one)
    # The constant of a lift is 1, so the last column of an error block is the error itself.
    sign = np.append(-np.ones(n - 1), 1.0)
    first = np.concatenate([one, nothing, sign * x_error], axis=-1)
    second = np.concatenate([nothing, one, sign * y_error], axis=-1)
    return update_rank_k(first, second)
