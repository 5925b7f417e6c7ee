"""Whether the training motion was rich enough: how well image motion is predicted, direction by direction.

What a task cannot see must not matter (§4), so the cameras' own uncertainty says little. Asked is instead
how uncertain the predicted image motion of the targets is when the robot makes one component of the task's
motions, as the information of the training data has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vmf.learn.adjustment import CAMERAS, Estimate, Scene, System
from vmf.tasks import Task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Predicted image motion more uncertain than this share of itself is not known.
_LARGEST = 0.3
# Targets that the prediction is tried on, at most.
_TRIED = 12
# Eigenvalues of the information, its diagonal being 1, below which there is none.
_NO_INFORMATION = 1e-13
# Components of motion smaller than this in training count as none at all.
_NONE = 1e-6
_COMPLEX_STEP = 1e-30
_WORDS = (("rot_", "rotation about "), ("t_", "translation along "))


@dataclass(frozen=True)
class Excitation:
    """How much of each component of the task's motions the training data have shown.

    Attributes
    ----------
    names, units : of the task's components.
    spread : (m,) standard deviation of the training motions.
    uncertainty : (m,) standard deviation of predicted image motion, as a share of that motion.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    spread: Floats
    uncertainty: Floats

    @property
    def nothing_known(self) -> bool:
        """Whether the training motion says too little about every component."""
        return bool((self.uncertainty > _LARGEST).all())

    @property
    def lacking(self) -> tuple[str, ...]:
        """Components that the training motion says too little about, in words."""
        said = []
        for name, unit, spread, u in zip(self.names, self.units, self.spread, self.uncertainty, strict=True):
            if u > _LARGEST:
                amount = "no" if spread < _NONE else "too little"
                extent = "" if spread < _NONE else f" ({spread:.2g} {unit})"
                said.append(f"{amount} {_in_words(name)}{extent}")
        return tuple(said)


def excitation(
    task: Task, scene: Scene, now: Estimate, system: System, E_S_from_W: Floats, variance: float
) -> Excitation:
    """Return what training motions have excited.

    Parameters
    ----------
    task : the task space.
    scene, now : the observations kept, and the estimate.
    system : normal equations of the estimate, in units of the noise.
    E_S_from_W : (N, 4, 4) poses of the training frames.
    variance : factor on the noise's variance.
    """
    starts = scene.starts
    tried = np.linspace(0, len(starts) - 1, min(_TRIED, len(starts))).round().astype(np.int64)
    d, slope = _image_motion(task, now, scene.E[starts[tried]], tried)
    spread = _variances(system, tried, slope).sum(axis=(0, 1, 3)) * variance
    share = np.sqrt(spread / np.square(d).sum(axis=(0, 1, 3)))
    p = task.coordinates(E_S_from_W[1:] @ np.linalg.inv(E_S_from_W[:1]), E_S_from_W[:1])
    names, units = zip(*task.components, strict=True)
    return Excitation(names, units, np.asarray(p.std(axis=0)), np.asarray(share))


def _image_motion(task: Task, now: Estimate, E: Floats, target: Ints) -> tuple[Floats, Floats]:
    """Return ∂u/∂p_i (J, 2, m, 2) of targets at rest, and its derivatives (J, 2, m, 2, 15) in M and P."""
    generators = np.einsum(
        "ijb,...bm->...mij", task.embedding, task.lift_jacobian(np.zeros((len(E), task.n_motion)), E)
    )

    def flow(M: NDArray[np.complex128], P: NDArray[np.complex128]) -> NDArray[np.complex128]:
        here = np.einsum("jab,...jb->...ja", E, np.concatenate([P, np.ones_like(P[..., :1])], axis=-1))
        p = np.einsum("...cra,...ja->...jcr", M, here)[..., None, :]
        h = np.einsum("...cra,jmab,...jb->...jcmr", M, generators, here)
        return np.asarray((h[..., :2] - p[..., :2] / p[..., 2:] * h[..., 2:]) / p[..., 2:])

    M, P = now.M.astype(complex), now.points[target].astype(complex)
    at_rest = flow(M, P).real
    steps = 1j * _COMPLEX_STEP * np.eye(15)
    slopes = flow(M + steps[:, None, :12].reshape(15, 1, 3, 4), P + steps[:, None, 12:]).imag / _COMPLEX_STEP
    return at_rest, np.moveaxis(slopes, 0, -1)


def _variances(system: System, target: Ints, slope: Floats) -> Floats:
    """Return variances (J, 2, m, 2), in units of the noise, of what has derivatives (J, 2, m, 2, 15).

    Sums of squares throughout: where next to nothing is known, the covariance itself is lost in rounding.
    """
    S, _, gain = system.reduced()
    used = S.diagonal() > 0.0
    size = np.sqrt(np.where(used, S.diagonal(), 1.0))
    values, vectors = np.linalg.eigh(S / np.outer(size, size))
    # The cameras' covariance is root @ root.T, and a target moves with them by minus its gain.
    root = vectors / size[:, None] / np.sqrt(np.maximum(values, _NO_INFORMATION))
    root[~used] = 0.0
    of_target = slope[..., 12:]
    of_cameras = -np.einsum("jcmup,jpa->jcmua", of_target, gain[target][..., :CAMERAS])
    for camera in (0, 1):
        mine = slice(camera * CAMERAS // 2, camera * CAMERAS // 2 + 12)
        of_cameras[:, camera, ..., mine] += slope[:, camera, ..., :12]
    own = np.linalg.inv(system.H_p[target] + 1e-300 * np.eye(3))
    return np.asarray(
        np.square(of_cameras @ root).sum(axis=-1)
        + np.einsum("jcmup,jpq,jcmuq->jcmu", of_target, own, of_target)
    )


def _in_words(component: str) -> str:
    for prefix, words in _WORDS:
        if component.startswith(prefix):
            return words + component.removeprefix(prefix)
    return {"heading": "turning"}.get(component, component)
