"""CMACs of several widths: the finest trained enough answers, as that CMAC alone would."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmf.approximate import Cmac, CmacMultires

WIDTHS = (20.0, 60.0, 150.0)


def visits_of(cmac, codes, trust):
    """Sum of trust of the pairs in every tile, by its key."""
    visits = {}
    for keys, t in zip(cmac.tiling.keys(codes).tolist(), trust, strict=True):
        for key in keys:
            visits[key] = visits.get(key, 0.0) + t
    return visits


@given(
    seed=st.integers(0, 2**32 - 1),
    min_visits=st.floats(0.0, 6.0),
    min_trained=st.floats(0.0, 1.0),
)
def test_the_finest_width_that_is_trained_enough_answers(seed, min_visits, min_trained):
    rng = np.random.default_rng(seed)
    # Many codes in one place, few in others.
    codes = np.concatenate([rng.normal(100.0, 4.0, (20, 4)), rng.uniform(0.0, 300.0, (20, 4))])
    theta, trust = rng.normal(size=(40, 2)), rng.uniform(0.2, 1.0, 40)
    asked = np.concatenate([codes + rng.normal(size=codes.shape), rng.uniform(0.0, 300.0, (20, 4))])
    options = {"overlays": 6, "table_size": 1 << 17, "step": 0.7, "epochs": 2, "min_support": 0.3}
    options["new_tiles"] = "first_visit"
    multires = CmacMultires(tiles_px=WIDTHS[::-1], min_visits=min_visits, min_trained=min_trained, **options)
    for part in (slice(0, 25), slice(25, 40)):
        multires.partial_fit(codes[part], theta[part], trust[part])
    # The widest answers as a CMAC does.
    single = {}
    for width in WIDTHS:
        single[width] = Cmac(tile_px=width, **options)
        for part in (slice(0, 25), slice(25, 40)):
            single[width].partial_fit(codes[part], theta[part], trust[part])
    answers = {width: single[width].predict(asked) for width in WIDTHS}
    visits = {width: visits_of(single[width], codes, trust) for width in WIDTHS}
    found = multires.predict(asked)
    for i, code in enumerate(asked):
        for width in WIDTHS:
            tiles = single[width].tiling.keys(code[None])[0].tolist()
            # Tiles whose slot belongs to another are not trained at all.
            own = single[width].table.find(code[None])[1][0]
            seen = [visits[width].get(tile, 0.0) for tile in tiles]
            enough = sum(o and v >= min_visits for o, v in zip(own, seen, strict=True))
            if width == WIDTHS[-1] or (enough / 6 >= min_trained and answers[width].support[i] >= 0.3):
                break
        np.testing.assert_array_equal(found.parameters[i], answers[width].parameters[i])
        assert found.support[i] == answers[width].support[i]


def test_dense_places_get_the_fine_and_sparse_ones_the_coarse(rng):
    """A function with detail where many codes are: better than either width alone, everywhere."""
    dense = np.array([100.0, 100.0, 60.0, 100.0]) + rng.uniform(-20.0, 20.0, (1500, 4))
    sparse = np.array([500.0, 300.0, 450.0, 300.0]) + rng.uniform(-60.0, 60.0, (60, 4))

    def function(codes):
        return np.where(codes[:, :1] < 300.0, np.sin(codes[:, :1] / 8.0), 0.01 * codes[:, :1] - 3.0)

    codes = rng.permutation(np.concatenate([dense, sparse]))
    asked = np.concatenate([dense[:200] + rng.normal(size=(200, 4)), sparse + rng.normal(0.0, 10.0, (60, 4))])
    truth = function(asked)
    options = {"table_size": 1 << 20, "step": 0.5, "epochs": 3}
    errors = {}
    for name, cmac in {
        "fine": Cmac(tile_px=16.0, **options),
        "coarse": Cmac(tile_px=128.0, **options),
        "both": CmacMultires(tiles_px=(16.0, 128.0), min_visits=8.0, **options),
    }.items():
        cmac.partial_fit(codes, function(codes))
        # No answer is as wrong as the function is large.
        answer = cmac.predict(asked)
        error = np.where(answer.refused[:, None], truth, answer.parameters - truth)
        errors[name] = [np.sqrt(np.square(error[part]).mean()) for part in (slice(0, 200), slice(200, 260))]
    assert errors["both"][0] < 0.8 * errors["coarse"][0]
    assert errors["both"][1] < 0.8 * errors["fine"][1]


@pytest.mark.parametrize("missing", ["1.visits", "0.owner", "2.weights"])
def test_a_state_that_lacks_something_is_refused(missing, rng):
    cmac = CmacMultires(tiles_px=WIDTHS)
    cmac.partial_fit(rng.uniform(0.0, 100.0, (10, 4)), rng.normal(size=(10, 2)))
    state = cmac.state()
    del state[missing]
    with pytest.raises(KeyError):
        CmacMultires(tiles_px=WIDTHS).restore(state)
