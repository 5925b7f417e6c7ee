"""Fixtures that all tests share: task spaces with a world around them, reference vectors, recorded data."""

from __future__ import annotations

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Tests run side by side, and their matrices are small: threads inside BLAS would only wait for each other.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# A background job's children would inherit that Ctrl-C means nothing to them.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import HealthCheck, Phase, settings  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

from vmf.geometry import StereoCameras, parallel_rig  # noqa: E402
from vmf.geometry.camera import R_CAMERA_FROM_BODY  # noqa: E402
from vmf.tasks import Task, make_task  # noqa: E402

Floats = NDArray[np.float64]

SHARED = Path(__file__).resolve().parents[2] / "shared"
IMAGE_SIZE = (640, 480)
# Table 5.1.
K = np.array([[469.0, 0.0, 344.0], [0.0, 472.0, 255.0], [0.0, 0.0, 1.0]])

# Tests say laws, so the same examples are drawn on every machine and nothing is remembered between runs.
settings.register_profile(
    "vmf",
    deadline=None,
    max_examples=25,
    derandomize=True,
    database=None,
    phases=[Phase.explicit, Phase.generate, Phase.shrink],
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("vmf")


@dataclass(frozen=True)
class TaskCase:
    """A task space, the thesis's rig in the frame that suits it, and poses and points to draw in front of it.

    Amplitudes (0.3 rad, 0.3 m, points 2 m ahead within 0.3 m) keep every depth above 0.5 m.
    """

    id: str
    task: Task
    cameras: StereoCameras
    body_axes: bool

    @property
    def thesis_lift(self) -> bool:
        """Whether this is the 8-entry form of `pan_tilt`, good for centres of zero tilt only."""
        return self.id == "pan_tilt_thesis"

    @property
    def n_free(self) -> int:
        """Entries per row that motions from one centre determine: nine of ten in the 9-entry lift (C3)."""
        return 9 if self.id == "pan_tilt" else self.task.n_lift + 1

    def unknowns(self, rng: np.random.Generator, *shape: int, reach: float = 0.3) -> Floats:
        return rng.uniform(-reach, reach, (*shape, self.task.n_motion))

    def centres(self, rng: np.random.Generator, *shape: int) -> Floats:
        p = self.unknowns(rng, *shape)
        if self.thesis_lift:
            p[..., 1] = 0.0
        return self.task.motion(p, np.eye(4))

    def poses(self, rng: np.random.Generator, *shape: int) -> Floats:
        return self.task.motion(self.unknowns(rng, *shape), np.eye(4))

    def points(self, rng: np.random.Generator, *shape: int) -> Floats:
        """Points of S (…, 3) in view."""
        P = np.array([0.0, 0.0, 2.0]) + rng.uniform(-0.3, 0.3, (*shape, 3))
        return P @ R_CAMERA_FROM_BODY if self.body_axes else P

    def pixels(self, P_S: Floats) -> Floats:
        """Pixels (…, 2, 2) of points (…, 3) in the left and right camera, written out for its own sake."""
        p = P_S @ np.swapaxes(self.cameras.M[:, :, :3], -1, -2)[(slice(None), *[None] * (P_S.ndim - 2))]
        p = np.moveaxis(p + self.cameras.M[(slice(None), *[None] * (P_S.ndim - 1), slice(None), 3)], 0, -2)
        return p[..., :2] / p[..., 2:]

    def move(self, E: Floats, P: Floats) -> Floats:
        """Points (…, n, 3) after motions (…, 4, 4)."""
        return P @ np.swapaxes(E[..., :3, :3], -1, -2) + E[..., None, :3, 3]


def thesis_rig(*, body_axes: bool) -> StereoCameras:
    """The rig of Table 5.1: 20 cm baseline, 10 cm ahead of S, whose axes are the camera's or x forward."""
    R = R_CAMERA_FROM_BODY if body_axes else np.eye(3)
    return parallel_rig(K, K, 0.2, R, R.T @ np.array([-0.1, 0.0, 0.1]))


CASES = {
    "translation": ("translation", "general", False),
    "planar": ("planar", "general", True),
    "six_dof": ("six_dof", "general", False),
    "pan_tilt": ("pan_tilt", "general", True),
    "pan_tilt_thesis": ("pan_tilt", "thesis", True),
}


def make_case(name: str) -> TaskCase:
    task, lift, body_axes = CASES[name]
    return TaskCase(name, make_task(task, lift), thesis_rig(body_axes=body_axes), body_axes)


@pytest.fixture(scope="session", params=list(CASES))
def case(request: pytest.FixtureRequest) -> TaskCase:
    """Every task space in turn."""
    return make_case(request.param)


@pytest.fixture(scope="session")
def cases() -> dict[str, TaskCase]:
    """All task spaces by name."""
    return {name: make_case(name) for name in CASES}


@pytest.fixture
def rng() -> np.random.Generator:
    """A stream of its own for every test."""
    return np.random.default_rng(20090317)


@pytest.fixture(scope="session")
def reference() -> dict[str, Any]:
    """Independent reference values, 12 digits each."""
    path = SHARED / "vectors" / "reference.json"
    if not path.exists():
        pytest.skip(f"no reference vectors at {path}")
    return dict(json.loads(path.read_text()))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The directory of recordings."""
    path = SHARED / "data"
    if not path.exists():
        pytest.skip(f"no recordings at {path}")
    return path
