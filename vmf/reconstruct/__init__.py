"""The rival: motions by 3-D reconstruction with calibrated cameras (§7), one method a file."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from vmf.estimate.noise import Noise
from vmf.geometry import StereoCameras
from vmf.geometry.triangulate import Triangulation, triangulate
from vmf.reconstruct.arun import triangulate_arun
from vmf.reconstruct.bundle import bundle
from vmf.reconstruct.calibration import CalibrationError, CalibrationErrorLike, RigModel, disturb, label
from vmf.reconstruct.cramer_rao import Bound, cramer_rao
from vmf.reconstruct.pnp import pnp
from vmf.solve import Query, Solutions
from vmf.tasks import Task


class Method(Protocol):
    """A way to get motions from two views with known cameras."""

    def __call__(
        self,
        task: Task,
        cameras: StereoCameras,
        query: Query,
        *,
        known_rotation: bool = False,
        noise: Noise | None = None,
    ) -> Solutions:
        """Return one solution per query."""


METHODS: Mapping[str, Method] = MappingProxyType(
    {"triangulate_arun": triangulate_arun, "pnp": pnp, "bundle": bundle}
)


def reconstruct(
    method: str,
    task: Task,
    cameras: StereoCameras,
    query: Query,
    *,
    known_rotation: bool = False,
    noise: Noise | None = None,
) -> Solutions:
    """Return the motions of queries by 3-D reconstruction.

    Parameters
    ----------
    method : a name in `METHODS`.
    task : the task space.
    cameras : the rig as its calibration has it.
    query : Q pairs of views of up to n targets, NaN where not seen.
    known_rotation : take the rotation of each motion from the robot and solve for the rest.
    noise : how pixel coordinates scatter, for covariances and robust losses; None takes the residuals'.

    Returns
    -------
    Solutions
        One per query, with the reason where there is no motion.

    Raises
    ------
    KeyError : no such method.
    ValueError : `known_rotation` with a task that only rotates, or cameras that share a centre.
    """
    return METHODS[method](task, cameras, query, known_rotation=known_rotation, noise=noise)


__all__ = [
    "METHODS",
    "Bound",
    "CalibrationError",
    "CalibrationErrorLike",
    "Method",
    "RigModel",
    "Triangulation",
    "bundle",
    "cramer_rao",
    "disturb",
    "label",
    "pnp",
    "reconstruct",
    "triangulate",
    "triangulate_arun",
]
