"""The order in which a CMAC sees its pairs, and the rank of its equations (§4.2.4, §4.3.2)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import islice

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import csr_array

from vmf.approximate import Cmac, Tiling
from vmf.geometry import stereo_code
from vmf.spec.studies import KaczmarzStudy, Lattice
from vmf.study.result import Quantity, StudyResult, mean_quantity
from vmf.study.rig import rig_cameras, visible_points
from vmf.tasks import make_task

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Orders of an epoch's pairs; `sorted` as a smooth motion along the rows would meet them.
ORDERS = ("sorted", "cyclic", "random", "drawn")
# Of these there is one course, of the others one for each seed.
_FIXED = ("sorted",)


def kaczmarz(settings: KaczmarzStudy) -> StudyResult:
    """Train in different orders, and count ranks."""
    from vmf.study.figures.kaczmarz import draw_orders, draw_ranks

    courses = _courses(settings)
    ranks = pd.DataFrame(
        [row for lattice in settings.lattices for row in _ranks(settings, lattice)],
        columns=["case", "overlays", "codes", "cells", "bound", "rank"],
    )
    quantities = [*_order_quantities(courses, settings), *_rank_quantities(ranks)]
    drawings = {
        "orders": partial(draw_orders, settings, courses),
        "ranks": partial(draw_ranks, settings, ranks),
    }
    return StudyResult(tuple(quantities), {"orders": courses, "ranks": ranks}, drawings)


def _courses(settings: KaczmarzStudy) -> pd.DataFrame:
    """Return residual, movement and distance to the first course's answers, one row per course and epoch."""
    rng = np.random.default_rng(settings.seed)
    P = visible_points(settings.box, settings.rig, settings.points, rng)
    cameras = rig_cameras(settings.rig)
    codes = stereo_code(cameras, P)[0]
    theta = make_task("six_dof").parameters(cameras.left, P).reshape(len(P), -1)
    varying = np.ptp(theta, axis=0) > 1e-9 * np.abs(theta).max()
    theta = (theta[:, varying] - theta[:, varying].mean(axis=0)) / theta[:, varying].std(axis=0)
    solvable = np.repeat(_taken_on(settings, codes, theta), settings.visits, axis=0)
    codes, theta = (np.repeat(values, settings.visits, axis=0) for values in (codes, theta))
    noisy = solvable + settings.noise * rng.standard_normal(theta.shape)
    rows = []
    for targets, values in (("consistent", solvable), ("noisy", noisy)):
        for order in ORDERS:
            first: list[Floats] = []
            for course in range(1 if order in _FIXED else settings.orders):
                answers = list(islice(_answers(settings, codes, values, order, course), settings.epochs))
                first = first or answers
                before = [np.zeros_like(values), *answers]
                for epoch, now in enumerate(answers):
                    numbers = (_rms(now - values), _rms(now - before[epoch]), _rms(now - first[epoch]))
                    rows.append((targets, order, course, epoch + 1, *numbers))
    names = ["targets", "order", "course", "epoch", "residual", "movement", "spread"]
    return pd.DataFrame(rows, columns=names)


def _taken_on(settings: KaczmarzStudy, codes: Floats, theta: Floats) -> Floats:
    """Return values at the codes that the CMAC can have: its own after one pass."""
    cmac = _cmac(settings)
    cmac.partial_fit(codes, theta)
    return cmac.predict(codes).parameters


def _cmac(settings: KaczmarzStudy, training: str = "albus", seed: int = 1) -> Cmac:
    return Cmac(**settings.cmac.model_dump(), training=training, seed=seed)


def _answers(
    settings: KaczmarzStudy, codes: Floats, values: Floats, order: str, course: int
) -> Iterator[Floats]:
    """Yield the CMAC's answers at the codes (N, d) after every epoch, without end."""
    rng = np.random.default_rng((settings.seed, course))
    cmac = _cmac(settings, "randomised" if order == "drawn" else "albus", seed=course + 1)
    permutation = np.argsort(codes[:, 0], kind="stable") if order == "sorted" else rng.permutation(len(codes))
    while True:
        cmac.partial_fit(codes[permutation], values[permutation])
        yield cmac.predict(codes).parameters
        if order == "random":
            permutation = rng.permutation(len(codes))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.square(values).mean()))


def _order_quantities(courses: pd.DataFrame, settings: KaczmarzStudy) -> Iterator[Quantity]:
    for (targets, order), rows in courses.groupby(["targets", "order"], sort=False):
        case = f"{targets}, {order}"
        for epoch in (1, settings.epochs):
            component = f"epoch={epoch}"
            at = rows[rows["epoch"] == epoch]
            yield mean_quantity("residual", at["residual"].to_numpy(float), case, component)
            yield mean_quantity("movement", at["movement"].to_numpy(float), case, component)
            others = at.loc[at["course"] > 0, "spread"].to_numpy(float)
            if len(others):
                yield mean_quantity("order_spread", others, case, component)


def basis_matrix(tiling: Tiling, codes: Floats) -> csr_array:
    """Return B (N, L) of Eq. 4.4: ones where a code lies in a cell, of the L cells that some code is in."""
    cells = tiling.cells(codes)
    n, T = cells.shape[:2]
    keys = np.concatenate([np.broadcast_to(np.arange(T)[:, None], (n, T, 1)), cells], axis=-1)
    _, column = np.unique(keys.reshape(n * T, -1), axis=0, return_inverse=True)
    return csr_array((np.ones(n * T), column.ravel(), T * np.arange(n + 1)))


def _ranks(settings: KaczmarzStudy, lattice: Lattice) -> Iterator[tuple[str, int, int, int, int, int]]:
    """Yield case, T, codes, cells L, the bound L − (T − 1), and rank(B)."""
    rng = np.random.default_rng((settings.seed, lattice.dimensions))
    codes = np.zeros((lattice.codes, 4))
    codes[:, : lattice.dimensions] = rng.uniform(0, lattice.span_px, (lattice.codes, lattice.dimensions))
    for overlays in settings.rank_overlays:
        tiling = Tiling(overlays, settings.rank_tile_px, settings.rank_displacement)
        B = basis_matrix(tiling, codes)
        n, cells = B.shape
        yield f"{lattice.dimensions}-D", overlays, n, cells, cells - (overlays - 1), rank_of(B)


def rank_of(B: csr_array) -> int:
    """Return the rank of a matrix of ones and zeros, from the eigenvalues of the smaller Gram matrix."""
    gram = (B.T @ B if B.shape[1] <= B.shape[0] else B @ B.T).toarray()
    values = np.linalg.eigvalsh(gram)
    # Eigenvalues of zero come out as rounding of the largest.
    return int((values > len(gram) * np.finfo(float).eps * values[-1]).sum())


def _rank_quantities(ranks: pd.DataFrame) -> Iterator[Quantity]:
    for row in ranks.itertuples():
        case, n = f"{row.case}, T={row.overlays}", int(str(row.codes))
        for name, value in (("cells", row.cells), ("rank_bound", row.bound), ("rank", row.rank)):
            yield Quantity(name, float(str(value)), case, n=n)
