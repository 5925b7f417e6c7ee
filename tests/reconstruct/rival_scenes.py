"""Stereo pairs of views on the thesis rig, for every task."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vmf.geometry import StereoCameras, in_view, motion, stereo_code
from vmf.geometry.camera import R_CAMERA_FROM_BODY
from vmf.reconstruct import RigModel
from vmf.solve import Query
from vmf.tasks import make_task

TARGETS = {"six_dof": 6, "translation": 2, "planar": 3, "pan_tilt": 2}
FEWEST = {"six_dof": 3, "translation": 1, "planar": 2, "pan_tilt": 1}
K = np.array([[469.0, 0.0, 344.0], [0.0, 472.0, 255.0], [0.0, 0.0, 1.0]])


def axes(task):
    """Camera axes in S: those of S for flying cameras, looking along x for robots on the ground."""
    return R_CAMERA_FROM_BODY if task in ("planar", "pan_tilt") else np.eye(3)


def thesis_rig(task):
    R = axes(task)
    return RigModel(K, K, R, R.T @ [-0.10, 0.0, 0.10], 0.20)


def random_poses(task, N, rng):
    """Poses E_S_from_W (N, 4, 4) around the start; for `pan_tilt` with tilts other than zero."""
    if task == "pan_tilt":
        return make_task(task, "thesis").motion(rng.uniform(-0.6, 0.6, (N, 2)), np.eye(4))
    if task == "planar":
        p = np.column_stack([rng.uniform(-0.6, 0.6, N), rng.uniform(-1.0, 1.0, (N, 2))])
        return make_task(task).motion(p, np.eye(4))
    R = Rotation.random(N, rng=rng).as_matrix() if task == "six_dof" else np.eye(3)
    return motion.inverse(motion.from_rotation_translation(R, rng.uniform(-1.0, 1.0, (N, 3))))


def random_query(task, Q, n, rng, noise_px=0.0, from_rest=False, cameras: StereoCameras | None = None):
    """Q pairs of views in which all n targets of a 1 m box, 2 m in front of the start, are visible."""
    cameras = cameras or thesis_rig(task).cameras()
    found = []
    while len(found) < Q:
        P = rng.uniform([-0.5, -0.5, 1.5], [0.5, 0.5, 2.5], (n, 3)) @ axes(task)
        E = random_poses(task, 5000, rng)
        if from_rest:
            E[0] = np.eye(4)
        codes, depth = stereo_code(cameras, P @ np.swapaxes(E[:, :3, :3], -1, -2) + E[:, None, :3, 3])
        visible = np.nonzero(in_view(codes, depth, (640, 480)).all(axis=1))[0][:2]
        if len(visible) == 2 and (visible[0] == 0 or not from_rest):
            i, j = visible
            found.append((codes[i], codes[j], E[i], E[j]))
    initial, desired, E_i, E_d = (np.stack(part) for part in zip(*found, strict=True))
    initial = initial + noise_px * rng.standard_normal(initial.shape)
    desired = desired + noise_px * rng.standard_normal(desired.shape)
    return Query(initial, desired, E_i, E_d)
