"""Albus's CMAC, trained by the Albus–Kaczmarz rule (§4.2.4, §4.3.2) or another of its family."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from vmf.approximate.base import Approximator, Arrays, Floats, Prediction, chunk_by_chunk
from vmf.approximate.kaczmarz import TRAININGS, Equations
from vmf.approximate.tiling import Collisions, Displacement, SlotTable, Tiling

NewTiles = Literal["zero", "first_visit"]


class Pairs(NamedTuple):
    """Codes (N, 4), parameters (N, d) and steps ε (N,) of N pairs."""

    codes: Floats
    parameters: Floats
    steps: Floats


class Cmac(Approximator):
    """Sum of T tile weights (Eq. 4.7); `support` is the share of a code's T tiles that were trained.

    Parameters
    ----------
    overlays, tile_px, displacement, table_size : the tiling.
    step : ε of Eq. 4.8, between 0 and 2.
    epochs : passes over the pairs of each `partial_fit`.
    min_support : codes with a smaller share of trained tiles are refused.
    training : a name of `TRAININGS`.
    window : m, how many of the last pairs a training that remembers looks at.
    seed : of the draws of `randomised`.
    new_tiles : what a tile holds before its first correction: `zero`, or its share of the parameters of the
        `first_visit`, so that tiles visited rarely, or by pairs trusted little, are not pulled to zero.
    """

    # Weights of a tile: one, its constant.
    n_features = 1

    def __init__(
        self,
        overlays: int = 32,
        tile_px: float = 32.0,
        displacement: Displacement = "diagonal",
        table_size: int = 65536,
        step: float = 1.0,
        epochs: int = 1,
        min_support: float = 0.25,
        training: str = "albus",
        window: int = 8,
        seed: int = 1,
        new_tiles: NewTiles = "zero",
    ) -> None:
        self.tiling = Tiling(overlays, tile_px, displacement, table_size)
        self.step, self.epochs, self.min_support = step, epochs, min_support
        self.training, self.window, self.seed = TRAININGS[training], window, seed
        self.new_tiles = new_tiles
        self.table = SlotTable(self.tiling)
        # Weights are allocated for the slots in use only: row of each slot, −1 for none.
        self._row = np.full(table_size, -1, np.int64)
        self._weights = np.zeros((0, self.n_features, 0))
        self._n_rows = 0
        self._recent: Pairs | None = None

    @property
    def collisions(self) -> Collisions:
        """How well the table kept tiles apart."""
        return self.table.collisions

    def partial_fit(self, codes: ArrayLike, parameters: ArrayLike, weights: ArrayLike | None = None) -> None:
        codes, theta = np.asarray(codes, float), np.asarray(parameters, float)
        # A pair that is trusted less takes a shorter step.
        steps = self.step * (np.ones(len(codes)) if weights is None else np.asarray(weights, float))
        trusted = steps > 0.0
        pairs = Pairs(codes[trusted], theta[trusted], steps[trusted])
        for _ in range(self.epochs if trusted.any() else 0):
            self._allocate(self.table.visit(pairs.codes), pairs.parameters)
            self._train(pairs)

    def _train(self, new: Pairs) -> None:
        """Train with every pair once; what is remembered of those before comes first."""
        first, pairs = 0, new
        if self._recent is not None:
            first = len(self._recent.codes)
            pairs = Pairs(*(np.concatenate(both) for both in zip(self._recent, new, strict=True)))
        W = self._weights.reshape(-1, pairs.parameters.shape[1])
        # Draws depend on the seed and on what was learned so far, so that a restored CMAC goes on alike.
        rng = np.random.default_rng((self.seed, self.table.updates))
        self.training.train(W, self._equations(pairs), first, self.window, rng)
        if self.training.remembers:
            begin = max(len(pairs.codes) - self.window + 1, 0)
            self._recent = Pairs(*(column[begin:] for column in pairs))

    def _equations(self, pairs: Pairs) -> Equations:
        columns, b, n_own = self._basis(pairs.codes)
        left = np.maximum(n_own, 1)
        T = self.tiling.overlays
        # Tiles whose slot another tile owns are left out; the others stand for all T, as in `predict`.
        squares = np.square(b).sum(axis=1)
        norm = T * np.where(n_own > 0, squares / left, 1.0)
        steps = np.where(n_own > 0, pairs.steps, 0.0)
        return Equations(columns, b, T / left, norm, pairs.parameters, steps)

    def _basis(self, codes: Floats) -> tuple[NDArray[np.int64], Floats, NDArray[np.int64]]:
        """Return the weights (N, C) that codes touch, their basis vectors (N, C), and how many tiles (N,)."""
        slots, own = self.table.find(codes)
        rows = np.where(own, self._row[slots], 0)
        columns = rows[..., None] * self.n_features + np.arange(self.n_features)
        b = self._features(codes) * own[..., None]
        shape = (len(codes), self.tiling.overlays * self.n_features)
        return columns.reshape(shape), b.reshape(shape), own.sum(axis=1)

    def _features(self, codes: Floats) -> Floats:
        """Return what each weight of a tile is multiplied with, (N, T, F)."""
        return np.ones((len(codes), self.tiling.overlays, 1))

    def _allocate(self, slots: NDArray[np.int64], theta: Floats) -> None:
        """Give slots (N, T) in use a row of weights."""
        new, first = np.unique(slots, return_index=True)
        unused = self._row[new] < 0
        new, first = new[unused], first[unused]
        rows = self._n_rows + np.arange(len(new))
        self._row[new] = rows
        self._n_rows += len(new)
        held, width = len(self._weights), theta.shape[1]
        if self._n_rows > held or self._weights.shape[2] != width:
            grown = np.zeros((max(2 * held, self._n_rows), self.n_features, width))
            grown[:held, :, : self._weights.shape[2]] = self._weights
            self._weights = grown
        if self.new_tiles == "first_visit":
            T = self.tiling.overlays
            self._weights[rows, 0] = theta[first // T] / T

    def predict(self, codes: ArrayLike) -> Prediction:
        return chunk_by_chunk(self._predict, np.asarray(codes, float))

    def _predict(self, codes: Floats) -> Prediction:
        columns, b, n_own = self._basis(codes)
        support = n_own / self.tiling.overlays
        answered = (support > 0.0) & (support >= self.min_support)
        values = np.full((len(codes), max(self._weights.shape[2], 1)), np.nan)
        if answered.any():
            W = self._weights.reshape(-1, values.shape[1])
            # Untrained tiles would pull the sum to zero: the trained ones stand for all T, which is Eq. 4.7
            # wherever all are trained.
            some, places = b[answered], columns[answered]
            ends = some.shape[1] * np.arange(len(some) + 1)
            B = csr_array((some.ravel(), places.ravel(), ends), shape=(len(some), len(W)))
            values[answered] = (B @ W) / support[answered, None]
        return Prediction(values, support)

    def state(self) -> dict[str, NDArray[Any]]:
        used = np.nonzero(self.table.used)[0]
        width = self.n_features * self._weights.shape[2]
        state = {
            "slots": used,
            "owner": self.table.owner[used],
            "weights": self._weights[self._row[used]].reshape(len(used), width),
            "counts": np.array([self.table.updates, self.table.collided]),
        }
        if self._recent is not None:
            state |= {f"recent_{name}": column.copy() for name, column in self._recent._asdict().items()}
        return state

    def restore(self, state: Arrays) -> None:
        used, owner = np.asarray(state["slots"]).astype(np.int64), np.asarray(state["owner"])
        weights = np.array(state["weights"], float)
        n, F = len(used), self.n_features
        if used.ndim != 1 or owner.shape != (n,) or weights.ndim != 2 or len(weights) != n:
            raise ValueError(
                f"slots {used.shape}, owner {owner.shape} and weights {weights.shape} do not fit"
            )
        if weights.shape[1] % F:
            raise ValueError(f"weights {weights.shape} are not of {F} numbers per tile and parameter")
        self.table = SlotTable(self.tiling)
        self.table.used[used] = True
        self.table.owner[used] = owner
        self.table.updates, self.table.collided = (int(v) for v in state["counts"])
        self._row = np.full(self.tiling.table_size, -1, np.int64)
        self._row[used] = np.arange(n)
        self._n_rows = n
        self._weights = weights.reshape(n, F, weights.shape[1] // F)
        self._recent = None
        if "recent_codes" in state:
            recent = Pairs(*(np.array(state[f"recent_{name}"], float) for name in Pairs._fields))
            m = len(recent.codes)
            shapes = ((m, 4), (m, self._weights.shape[2]), (m,))
            if tuple(column.shape for column in recent) != shapes:
                raise ValueError(f"the recent pairs have shapes {[c.shape for c in recent]}, not {shapes}")
            self._recent = recent
