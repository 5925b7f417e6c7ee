"""Trainings of a CMAC: iterative solutions of B w = y (Eq. 4.5), one equation per visited code (§4.2.4).

§4.2.4 names the algorithms that Parks and Militzer compared (Automatica 28(5), 1992) without their equations;
what stands for each here is written in its docstring. With `b` the basis vector of a code, `e = y − bᵀw` and
the projection `P(e, b) = e b/‖b‖²`, Albus–Kaczmarz (Eq. 4.8) is `w ← w + ε P(e, b)`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Where this little of b² is left after Gram–Schmidt, an equation says nothing that the window does not.
_DEPENDENT = 1e-8


@dataclass(frozen=True)
class Equations:
    """Equations `bᵀw = y` of N codes, each of which touches few weights.

    Attributes
    ----------
    columns : (N, C) which weights.
    b : (N, C) basis vectors, zero where the weight belongs to another tile.
    gain : (N,) T over the number of own tiles: these stand for all T, as in `predict`.
    norm : (N,) gain · ‖b‖², which is T for a CMAC of constant cells.
    targets : (N, d) y.
    steps : (N,) ε, shorter for a pair that is trusted less, 0 for a code without a tile of its own.
    """

    columns: Ints
    b: Floats
    gain: Floats
    norm: Floats
    targets: Floats
    steps: Floats

    def __len__(self) -> int:
        return len(self.columns)

    def row(self, k: int) -> tuple[Ints, Floats]:
        """Return the weights that equation k touches, and its basis vector there."""
        own = self.b[k] != 0.0
        return self.columns[k, own], self.b[k, own]

    def error(self, W: Floats, k: int) -> Floats:
        """Return e (d,) of equation k with weights W (L, d)."""
        columns, b = self.row(k)
        return np.asarray(self.targets[k] - (b[:, None] * W[columns]).sum(axis=0) * self.gain[k])

    def project(self, W: Floats, k: int, error: Floats) -> None:
        """Add `ε P(e, b)` of equation k to the weights W (L, d)."""
        columns, b = self.row(k)
        W[columns] += b[:, None] * (self.steps[k] * error / self.norm[k])

    def satisfy(self, W: Floats, k: int) -> None:
        """Project the weights W (L, d) onto equation k (Eq. 4.8): `error` and `project` in one."""
        columns, b = self.row(k)
        b = b[:, None]
        held = W[columns]
        error = self.targets[k] - (b * held).sum(axis=0) * self.gain[k]
        W[columns] = held + b * (self.steps[k] * error / self.norm[k])


def albus(W: Floats, equations: Equations, first: int, window: int, rng: np.random.Generator) -> None:
    """Albus–Kaczmarz (Eq. 4.8): satisfy one equation after the other, in their order."""
    for k in range(first, len(equations)):
        equations.satisfy(W, k)


def moving_average(
    W: Floats, equations: Equations, first: int, window: int, rng: np.random.Generator
) -> None:
    """Average over the last m equations: `w ← w + (ε/m) Σ P(e_i, b_i)`, all errors before the correction."""
    for k in range(first, len(equations)):
        last = range(max(k - window + 1, 0), k + 1)
        errors = [equations.error(W, i) / len(last) for i in last]
        for i, error in zip(last, errors, strict=True):
            equations.project(W, i, error)


def maximum_error(W: Floats, equations: Equations, first: int, window: int, rng: np.random.Generator) -> None:
    """Project onto each new equation, then onto that of the m − 1 before which is worst: `ε‖e‖` the largest.

    The new one comes first so that no visited code is left untaught.
    """
    for k in range(first, len(equations)):
        equations.satisfy(W, k)
        errors = {i: equations.error(W, i) for i in range(max(k - window + 1, 0), k)}
        if errors:
            worst = max(errors, key=lambda i: float(equations.steps[i] * np.linalg.norm(errors[i])))
            equations.project(W, worst, errors[worst])


def partial_gram_schmidt(
    W: Floats, equations: Equations, first: int, window: int, rng: np.random.Generator
) -> None:
    """Correct along v, which is b less its part in the span of the m − 1 before: `w ← w + ε e v/(vᵀb)`.

    The last m equations stay satisfied. An equation that depends on those before is passed over.
    """
    for k in range(first, len(equations)):
        last = range(max(k - window + 1, 0), k + 1)
        rows = [equations.row(i) for i in last]
        columns, place = np.unique(np.concatenate([c for c, _ in rows]), return_inverse=True)
        B = np.zeros((len(last), len(columns)))
        which = np.repeat(np.arange(len(last)), [len(c) for c, _ in rows])
        B[which, place] = np.concatenate([b for _, b in rows])
        b = B[-1]
        v = b - np.linalg.lstsq(B[:-1].T, b, rcond=_DEPENDENT)[0] @ B[:-1]
        if v @ v > _DEPENDENT * (b @ b):
            along = equations.gain[k] * (v @ b)
            W[columns] += v[:, None] * (equations.steps[k] * equations.error(W, k) / along)


def randomised(W: Floats, equations: Equations, first: int, window: int, rng: np.random.Generator) -> None:
    """Albus–Kaczmarz on as many equations, drawn with probability `‖b‖²/‖B‖²` (Strohmer, Vershynin 2009).

    Those that no draw hit follow in their order, so that no visited code is left untaught.
    """
    squares = (equations.norm * equations.gain)[first:]
    drawn = rng.choice(len(squares), len(squares), p=squares / squares.sum())
    left = np.setdiff1d(np.arange(len(squares)), drawn)
    for k in first + np.concatenate([drawn, left]):
        equations.satisfy(W, k)


class Training(NamedTuple):
    """A way to train: `train(W, equations, first, window, rng)` with the equations from `first` on.

    `remembers` says whether it looks back on those before, which it was given earlier.
    """

    train: Callable[[Floats, Equations, int, int, np.random.Generator], None]
    remembers: bool = False


TRAININGS: Mapping[str, Training] = MappingProxyType(
    {
        "albus": Training(albus),
        "moving_average": Training(moving_average, remembers=True),
        "maximum_error": Training(maximum_error, remembers=True),
        "partial_gram_schmidt": Training(partial_gram_schmidt, remembers=True),
        "randomised": Training(randomised),
    }
)
