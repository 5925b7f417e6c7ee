"""Motion that is not rich enough is refused, and what it lacks is named in the field's words."""

import numpy as np
import pytest

from vmf.data.simulate import rig_axes
from vmf.data.tracks import from_dense
from vmf.geometry import parallel_rig
from vmf.learn import StructuredLearner
from vmf.tasks import make_task

K = np.array([[469.0, 0.0, 344.0], [0.0, 472.0, 255.0], [0.0, 0.0, 1.0]])
FRAMES, TARGETS = 100, 8


def learned(task, moving, px, rng):
    """Learn from motions in which only the unknowns `moving` vary, by ±.3 m or rad."""
    space = make_task(task)
    R = rig_axes(space)
    M = parallel_rig(K, K, 0.2, R, R.T @ np.array([-0.1, 0.0, 0.1])).M
    p = np.zeros((FRAMES, space.n_motion))
    p[:, moving] = rng.uniform(-0.3, 0.3, (FRAMES, len(moving)))
    E = space.motion(p, np.broadcast_to(np.eye(4), (FRAMES, 4, 4)))
    P = rng.uniform((-0.5, -0.4, 1.5), (0.5, 0.4, 2.5), (TARGETS, 3)) @ R
    here = np.einsum("nij,kj->nki", E[:, :3, :3], P) + E[:, None, :3, 3]
    h = np.einsum("cri,nki->nkcr", M[:, :, :3], here) + M[:, :, 3]
    pixels = (h[..., :2] / h[..., 2:]).reshape(FRAMES, TARGETS, 4)
    learner = StructuredLearner(space)
    noisy = pixels + px * rng.standard_normal(pixels.shape)
    learner.partial_fit(from_dense(np.arange(FRAMES), E, noisy, image_size=(640, 480)))
    return learner


# Six-DOF unknowns are in the order rot_z, rot_y, rot_x, t_x, t_y, t_z.
LACKING = [
    ("six_dof", [3, 4, 5], ["rotation about x", "rotation about y", "rotation about z"]),
    ("six_dof", [0, 3, 4, 5], ["rotation about x", "rotation about y"]),
    ("six_dof", [0, 1, 2], ["translation along x", "translation along y", "translation along z"]),
    ("planar", [1, 2], ["turning"]),
    ("planar", [1], ["turning", "translation along y"]),
    ("translation", [0, 1], ["translation along z"]),
    ("pan_tilt", [0], ["tilt"]),
    ("pan_tilt", [1], ["pan"]),
]


@pytest.mark.parametrize("px", [0.0, 1.0])
@pytest.mark.parametrize(("task", "moving", "lacking"), LACKING)
def test_what_is_missing_is_named_and_nothing_else(task, moving, lacking, px, rng):
    learner = learned(task, moving, px, rng)
    assert learner.cameras is None
    (why,) = learner.losses
    found = sorted(part.strip() for part in why.removeprefix("the motion is not rich enough:").split(","))
    assert [part.removeprefix("no ") for part in found] == sorted(lacking)


# Rotations show the lever arms, so that not every direction has to be moved along.
ENOUGH = [
    ("six_dof", [0, 1, 2, 3, 4, 5]),
    ("six_dof", [0, 1, 2, 3, 5]),
    ("six_dof", [0, 2, 3]),
    ("planar", [0, 1, 2]),
    ("translation", [0, 1, 2]),
    ("pan_tilt", [0, 1]),
]


@pytest.mark.parametrize("px", [0.0, 1.0])
@pytest.mark.parametrize(("task", "moving"), ENOUGH)
def test_rich_motion_is_not_refused(task, moving, px, rng):
    learner = learned(task, moving, px, rng)
    assert learner.cameras is not None
    assert not any("rich" in loss for loss in learner.losses)


def test_a_little_motion_is_too_little(rng):
    """Turns of a few hundredths of a degree drown in 3 px of noise; they are said to be there."""
    space = make_task("pan_tilt")
    learner = learned("pan_tilt", [0], 1.0, rng)
    tracks = learner.tracks
    shaken = space.motion(
        np.column_stack([np.zeros(FRAMES), 1e-4 * rng.standard_normal(FRAMES)]), tracks.E_S_from_W
    )
    other = StructuredLearner(space)
    other.partial_fit(type(tracks)(**{**vars(tracks), "E_S_from_W": shaken @ tracks.E_S_from_W}))
    assert other.cameras is None
    assert "too little tilt" in other.losses[0]
