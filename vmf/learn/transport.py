"""One lifted camera per target, transported to every visited stereo code (§4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vmf.approximate import Approximator, Lookup, Prediction
from vmf.data.tracks import TargetBatch, Tracks, target_batches
from vmf.estimate import (
    LINEAR,
    Cameras,
    Estimate,
    augmented_rows,
    in_gauge,
    maximum_likelihood,
    sign_at_rest,
    update_rank_k,
)
from vmf.estimate.noise import Noise
from vmf.estimate.robust import Loss
from vmf.geometry import inverse
from vmf.learn.base import Answer, Arrays, Learner
from vmf.tasks import Task

Floats = NDArray[np.float64]

# Relative errors below this are rounding: noise-free targets all count the same.
_EXACT = 1e-9


@dataclass(frozen=True)
class WorldFit:
    """Lifted cameras of one batch of targets over poses relative to a reference pose of each.

    Attributes
    ----------
    batch : the targets and their observations.
    E_ref : (B, 4, 4) reference poses.
    u_ref : (B, 2, 2) reference pixels of the left and right camera.
    estimate : of batch shape (B, 2).
    """

    batch: TargetBatch
    E_ref: Floats
    u_ref: Floats
    estimate: Estimate


class TransportLearner(Learner):
    """Fits each target once and trains an approximator on the parameters of all its visited codes.

    Parameters
    ----------
    task : the task space.
    make_approximator : makes an empty approximator.
    estimator : `qr`, `tls` or `ml`.
    loss : of `ml`.
    gauge : in which the approximator stores parameters.
    own_codes : visited codes answer with their own target's parameters, not the approximator's.
    """

    def __init__(
        self,
        task: Task,
        make_approximator: Callable[[], Approximator],
        estimator: str = "ml",
        loss: Loss = "squared",
        gauge: str = "unit_depth",
        own_codes: bool = False,
    ) -> None:
        super().__init__(task)
        self._own = Lookup() if own_codes else None
        self._make_approximator = make_approximator
        self.estimator, self.loss, self.gauge = estimator, loss, gauge
        self.approximator = make_approximator()
        self._fits: list[WorldFit] = []
        self._fresh = True
        self._noise_px: float | None = None

    def _learn(self, block: Tracks) -> None:
        self._fresh = False

    def parameters(self, codes: ArrayLike, cameras: Cameras = "both") -> Answer:
        self._refresh()
        codes = np.asarray(codes, float)
        prediction = self.approximator.predict(codes)
        if isinstance(self.approximator, Lookup):
            return self._answer(prediction, ~prediction.refused)
        if self._own is None:
            return self._answer(prediction)
        own = self._own.predict(codes)
        return self._answer(_prefer(own, prediction), ~own.refused)

    def condition(self, code: ArrayLike) -> float:
        code = np.asarray(code, float)
        for fit in self._all_fits():
            target, _ = np.nonzero((fit.batch.pixels == code).all(axis=-1))
            if len(target):
                return float(fit.estimate.condition[target[0], 0])
        return float("nan")

    @property
    def noise(self) -> Noise | None:
        self._refresh()
        return None if self._noise_px is None else Noise(self._noise_px)

    @property
    def losses(self) -> tuple[str, ...]:
        total = sum(len(fit.batch.target) for fit in self._all_fits())
        bad = sum(int((~_determined(fit.estimate)).sum()) for fit in self._all_fits())
        if not bad:
            return ()
        return (f"{bad} of {total} targets have too few or too uniform observations to fix their parameters",)

    def _all_fits(self) -> list[WorldFit]:
        """Return all targets' fits; a restored learner answers without them and makes them anew."""
        self._refresh()
        if not self._fits and self.tracks is not None:
            self._fits = [self._fit(batch) for batch in target_batches(self.tracks)]
        return self._fits

    def _refresh(self) -> None:
        if self._fresh or self.tracks is None:
            return
        self._fresh = True
        self._fits = [self._fit(batch) for batch in target_batches(self.tracks)]
        self.approximator = self._make_approximator()
        self._own = None if self._own is None else Lookup()
        pairs = [self._transported(fit) for fit in self._fits]
        frame, target, codes, parameters, error = (
            np.concatenate(column) for column in zip(*pairs, strict=True)
        )
        if len(codes):
            # Frame by frame, as a robot would meet the codes, whatever the batches were.
            order = np.lexsort((target, frame))
            # A least-squares weight: the inverse variance, one for the best-known target.
            weights = np.square((error.min() + _EXACT) / (error + _EXACT))
            self.approximator.partial_fit(codes[order], parameters[order], weights[order])
            if self._own is not None:
                self._own.partial_fit(codes, parameters)
        self._noise_px = self._pooled_noise()

    def _fit(self, batch: TargetBatch) -> WorldFit:
        """Fit the lifted cameras of a batch over poses relative to each target's first."""
        assert self.tracks is not None
        world = self.task.world()
        E = self.tracks.E_S_from_W
        B = len(batch.target)
        E_ref = E[batch.frame[:, 0]] if self.task.closed else np.broadcast_to(np.eye(4), (B, 4, 4))
        x_bar = world.lift(E[batch.frame] @ inverse(E_ref)[:, None])
        u = batch.pixels.reshape(*batch.frame.shape, 2, 2)
        seen = np.asarray(np.isfinite(u).all(axis=-1))
        first = seen.argmax(axis=1)
        u_ref = np.take_along_axis(u, first[:, None, :, None], axis=1)[:, 0]
        # Both cameras side by side: (B·2, m, …).
        e = np.moveaxis(u - u_ref[:, None], 2, 1).reshape(2 * B, -1, 2)
        x_bar = np.repeat(x_bar, 2, axis=0)
        estimate = fit_centres(self.estimator, x_bar, e, self.loss)
        return WorldFit(batch, E_ref, np.nan_to_num(u_ref), _reshaped(estimate, (B, 2)))

    def _transported(self, fit: WorldFit) -> tuple[NDArray[Any], ...]:
        """Return frames, targets, codes (V, 4), parameters (V, d) and their relative errors.

        Codes of targets that are not determined are left out.
        """
        assert self.tracks is not None
        batch = fit.batch
        rows = self.task.from_world(fit.estimate.rows)
        error = fit.estimate.relative_error.max(axis=1)
        good = _determined(fit.estimate) & np.isfinite(rows).all(axis=(1, 2, 3))
        which, column = np.nonzero(np.isfinite(batch.pixels).all(axis=-1) & good[:, None])
        frame, code = batch.frame[which, column], batch.pixels[which, column]
        E_c = self.tracks.E_S_from_W[frame] @ inverse(fit.E_ref[which])
        u_c = code.reshape(-1, 2, 2) - fit.u_ref[which]
        moved = transport(self.task, rows[which], E_c, u_c)
        # A camera has all its observations in front of it: one of the other sign cannot be right.
        sign = sign_at_rest(moved, self.task.identity_lift)[..., 0, 0]
        votes = np.zeros((len(batch.target), 2))
        np.add.at(votes, which, sign)
        moved = in_gauge(moved, self.gauge, self.task.identity_lift)
        ok = (sign == np.sign(votes)[which]).all(axis=1) & np.isfinite(moved).all(axis=(1, 2, 3))
        d = int(np.prod(moved.shape[1:]))
        return frame[ok], batch.target[which[ok]], code[ok], moved[ok].reshape(-1, d), error[which[ok]]

    def _pooled_noise(self) -> float | None:
        residual = np.concatenate([fit.estimate.residual_px.ravel() for fit in self._fits])
        good = np.concatenate([np.repeat(_determined(fit.estimate), 2) for fit in self._fits])
        n = np.concatenate([fit.estimate.n_equations.ravel() for fit in self._fits])
        # Residuals of n equations with 3(k+1) − 1 unknowns understate the noise.
        spare = n - (3 * self.task.world().n_lift + 2)
        use = good & (spare > 0) & np.isfinite(residual)
        if not use.any():
            return None
        variance = np.square(residual[use]) * n[use] / spare[use]
        return float(np.sqrt(np.median(variance)))

    def state(self) -> dict[str, NDArray[Any]]:
        self._refresh()
        arrays = _named("approximator.", self.approximator.state())
        if self._own is not None:
            arrays |= _named("own.", self._own.state())
        noise = np.array(np.nan if self._noise_px is None else self._noise_px)
        return {**super().state(), **arrays, "noise_px": noise}

    def restore(self, state: Arrays) -> None:
        super().restore(state)
        self.approximator.restore(_unnamed("approximator.", state))
        width = self.approximator.predict(np.zeros((1, 4))).parameters.shape[1]
        expected = 6 * (self.task.n_lift + 1)
        if width not in (1, expected):
            raise ValueError(f"the approximator has {width} parameters, expected {expected}")
        if self._own is not None:
            self._own.restore(_unnamed("own.", state))
        noise = float(state["noise_px"])
        self._noise_px = None if np.isnan(noise) else noise
        self._fresh = True


def fit_centres(estimator: str, x_bar: Floats, e: Floats, loss: Loss = "squared") -> Estimate:
    """Return the estimates (B,) from lifts (B, m, n) and errors (B, m, 2), NaN where not seen."""
    n = x_bar.shape[-1]
    rows = augmented_rows(x_bar, e)
    rows[np.isnan(e).any(axis=-1)] = 0.0
    rows = rows.reshape(len(rows), -1, 3 * n)
    R = update_rank_k(np.zeros((len(rows), 3 * n, 3 * n)), rows)
    if estimator == "ml":
        return maximum_likelihood(R, n, x_bar, e, loss)[0]
    return LINEAR[estimator](R, n)


def transport(task: Task, rows: Floats, E_c: Floats, u_c: Floats) -> Floats:
    """Return the parameters of centres from lifted cameras over poses (§4).

    Parameters
    ----------
    task : the task space.
    rows : (V, C, 3, k+1) lifted cameras.
    E_c : (V, 4, 4) pose of each centre, in the frame of the lifted camera's poses.
    u_c : (V, C, 2) pixels of each centre, measured from where the lifted camera's are.
    """
    a_b = rows[..., :2, :] - u_c[..., None] * rows[..., 2:, :]
    moved = np.concatenate([a_b, rows[..., 2:, :]], axis=-2)
    L_T = np.swapaxes(task.closure(E_c), -1, -2)
    return np.asarray(np.linalg.solve(L_T[:, None], np.swapaxes(moved, -1, -2)).swapaxes(-1, -2))


def _prefer(first: Prediction, then: Prediction) -> Prediction:
    """Return the first answers where there are any, the others elsewhere."""
    if first.parameters.shape != then.parameters.shape:
        return then
    known = ~first.refused
    parameters = np.where(known[:, None], first.parameters, then.parameters)
    return Prediction(parameters, np.where(known, first.support, then.support))


def _named(prefix: str, arrays: Arrays) -> dict[str, NDArray[Any]]:
    return {prefix + name: array for name, array in arrays.items()}


def _unnamed(prefix: str, arrays: Arrays) -> dict[str, NDArray[Any]]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _determined(estimate: Estimate) -> NDArray[np.bool_]:
    """Which targets (B,) have both cameras' parameters fixed, with equations to spare."""
    return np.asarray((estimate.determined & np.isfinite(estimate.relative_error)).all(axis=1))


def _reshaped(estimate: Estimate, shape: tuple[int, int]) -> Estimate:
    def leading(a: NDArray[Any]) -> NDArray[Any]:
        return a.reshape(*shape, *a.shape[1:])

    return Estimate(
        leading(estimate.rows),
        leading(estimate.rank),
        leading(estimate.determined),
        leading(estimate.condition),
        leading(estimate.residual_px),
        leading(estimate.relative_error),
        leading(estimate.n_equations),
    )
