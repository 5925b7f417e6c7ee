"""The Cramér–Rao bound as rows of the error table, beside the methods it bounds (§7)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import elliprg

from vmf.experiment.build import build_task, rig_model
from vmf.experiment.errors_table import Asked, Column, around_the_circle, in_table_order, tidy
from vmf.geometry import from_rotation_translation, rotation_angle
from vmf.reconstruct import Bound, cramer_rao
from vmf.spec import Spec
from vmf.tasks import Task

Floats = NDArray[np.float64]

METHOD = "cramer_rao"


def bound_rows(spec: Spec, asked: Asked) -> pd.DataFrame:
    """Return the rows of an efficient, unbiased Gaussian estimator, whose covariance is the bound itself.

    Its errors are what the question's own noise makes of it to first order: they can be counted beside those
    of the other methods, which see the same noise. `expected_error` is the mean of |error| over all noise.

    The cameras are known. In `held_out` the targets are not, so both views are noisy; in `trained_code` they
    are known from training, up to `noise.point_m`, and the desired view alone is. The thesis's protocol asks
    about views that were learned from, with their poses: a function that has learned little can be better.
    Wrong correspondences (`noise.outlier_ratio`) are not part of it, and could only make it larger.

    Raises
    ------
    ValueError : the questions come without a truth.
    """
    model = rig_model(spec)
    if asked.truth is None or model is None:
        raise ValueError("only simulated questions have a known bound")
    task, points_known = build_task(spec), asked.protocol == "trained_code"
    bound = cramer_rao(
        task,
        model.cameras(),
        asked.query.of_camera(spec.solver.cameras),
        asked.truth,
        spec.noise.pixel_px,
        points_known=points_known,
        known_rotation=spec.solver.known == "rotation",
        point_m=spec.noise.point_m if points_known else 0.0,
    )
    status = np.array([reason.status for reason in bound.reason], dtype=str)
    return tidy(asked, METHOD, _columns(task, asked, bound), status)


def _columns(task: Task, asked: Asked, bound: Bound) -> list[Column]:
    columns = []
    std = np.sqrt(np.einsum("qii->qi", bound.covariance))
    for i, (name, unit) in in_table_order(task):
        truth, drawn = bound.p[:, i], bound.error[:, i]
        error = around_the_circle(np.abs(drawn)) if unit == "rad" else np.abs(drawn)
        columns.append(Column(name, unit, truth, truth + drawn, error, np.sqrt(2 / np.pi) * std[:, i]))
    E = task.motion(bound.p, asked.query.E_initial)
    R, t = E[:, :3, :3], E[:, :3, 3]
    change = np.where(bound.ok[:, None], np.einsum("qki,qi->qk", bound.derivative, bound.error), 0.0)
    turned = from_rotation_translation(R @ Rotation.from_rotvec(change[:, :3]).as_matrix(), t + change[:, 3:])
    covariance = bound.derivative @ bound.covariance @ np.swapaxes(bound.derivative, -1, -2)
    angle, distance = (mean_norm(covariance[:, part, part]) for part in (slice(0, 3), slice(3, 6)))
    off = around_the_circle(np.linalg.norm(change[:, :3], axis=1))
    columns.append(Column("angle", "rad", rotation_angle(E), rotation_angle(turned), off, angle))
    size, found = np.linalg.norm(t, axis=1), np.linalg.norm(turned[:, :3, 3], axis=1)
    columns.append(Column("distance", "m", size, found, np.linalg.norm(change[:, 3:], axis=1), distance))
    return columns


def mean_norm(covariance: Floats) -> Floats:
    """Return the mean length (…,) of Gaussian vectors with covariances (…, 3, 3); NaN where these are.

    With eigenvalues λ it is `√(8/π) R_G(λ)`: the mean length of a standard normal vector times the mean of
    `√Σ λ_i u_i²` over the unit sphere, Carlson's symmetric elliptic integral of the second kind.
    """
    known = np.asarray(np.isfinite(covariance).all(axis=(-2, -1)))
    eigenvalues = np.linalg.eigvalsh(np.where(known[..., None, None], covariance, 0.0))
    x, y, z = np.moveaxis(np.maximum(eigenvalues, 0.0), -1, 0)
    return np.where(known, np.sqrt(8 / np.pi) * elliprg(x, y, z), np.nan)
