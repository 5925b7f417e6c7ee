"""Training in different orders against the literal iteration, and ranks against the bound of §4.2.4."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.approximate import Tiling
from vmf.spec.studies import KaczmarzStudy, Lattice, StudiedCmac
from vmf.study import carry_out
from vmf.study.kaczmarz import _answers, basis_matrix, rank_of

SMALL = KaczmarzStudy(
    points=15,
    visits=3,
    epochs=40,
    orders=2,
    lattices=(Lattice(dimensions=1, span_px=16, codes=40),),
    rank_overlays=(2,),
)


@given(
    st.integers(1, 4),
    st.integers(1, 6),
    st.integers(1, 60),
    st.sampled_from(["diagonal", "uniform"]),
    st.integers(0, 999),
)
def test_the_rank_is_never_above_the_bound(
    dimensions: int, overlays: int, n: int, displacement: str, seed: int
) -> None:
    codes = np.zeros((n, 4))
    codes[:, :dimensions] = np.random.default_rng(seed).uniform(0, 20, (n, dimensions))
    tiling = Tiling(overlays, 6.0, "diagonal" if displacement == "diagonal" else "uniform")
    B = basis_matrix(tiling, codes)
    dense = B.toarray()
    assert set(np.unique(dense)) <= {0.0, 1.0}
    assert (dense.sum(axis=1) == overlays).all()
    rank = rank_of(B)
    assert rank == np.linalg.matrix_rank(dense)
    assert rank <= dense.shape[1] - (overlays - 1)


def test_codes_in_the_same_cells_share_their_rows() -> None:
    tiling = Tiling(4, 8.0, "diagonal")
    codes = np.array([[0.1] * 4, [1.9] * 4, [2.1] * 4, [100.0] * 4])
    B = basis_matrix(tiling, codes).toarray()
    np.testing.assert_array_equal(B[0], B[1])
    assert B[0] @ B[2] == 3
    assert B[0] @ B[3] == 0


@pytest.mark.parametrize("order", ["sorted", "cyclic"])
def test_an_epoch_is_the_literal_iteration(order: str, rng: np.random.Generator) -> None:
    """Eq. 4.8 on the dense B, one equation after the other."""
    settings = SMALL.model_copy(update={"cmac": StudiedCmac(overlays=8, tile_px=16.0, step=0.8)})
    codes, values = rng.uniform(0, 40, (20, 4)), rng.standard_normal((20, 2))
    B = basis_matrix(Tiling(8, 16.0, "diagonal"), codes).toarray()
    permutation = np.argsort(codes[:, 0], kind="stable")
    if order == "cyclic":
        permutation = np.random.default_rng((settings.seed, 0)).permutation(20)
    answers = _answers(settings, codes, values, order, 0)
    w = np.zeros((B.shape[1], 2))
    for _ in range(3):
        for k in permutation:
            w += 0.8 * B[k][:, None] * (values[k] - B[k] @ w) / 8
        np.testing.assert_allclose(next(answers), B @ w, atol=1e-12)


@pytest.fixture(scope="module")
def values() -> dict[tuple[str, str, str], float]:
    return {(q.quantity, q.case, q.component): q.value for q in carry_out(SMALL).quantities}


def test_orders_agree_on_what_can_be_had_and_differ_on_what_cannot(
    values: dict[tuple[str, str, str], float],
) -> None:
    last = f"epoch={SMALL.epochs}"
    rounding = 1e-9
    for order in ("sorted", "cyclic", "random", "drawn"):
        assert values["residual", f"consistent, {order}", last] < rounding
        assert values["residual", f"noisy, {order}", last] > 0.1 * SMALL.noise
    for order in ("cyclic", "random", "drawn"):
        assert values["order_spread", f"consistent, {order}", last] < rounding
        assert values["order_spread", f"noisy, {order}", last] > 0.1 * SMALL.noise
    # Cyclic training comes to rest, random training never does.
    for order in ("sorted", "cyclic"):
        assert values["movement", f"noisy, {order}", last] < rounding
    for order in ("random", "drawn"):
        assert values["movement", f"noisy, {order}", last] > 0.1 * SMALL.noise


def test_every_order_begins_with_an_error_of_its_own(values: dict[tuple[str, str, str], float]) -> None:
    first = [values["residual", f"noisy, {order}", "epoch=1"] for order in ("sorted", "cyclic", "drawn")]
    assert len(set(first)) == 3
