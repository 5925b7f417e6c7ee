"""What `vmf track` says of what it found."""

from __future__ import annotations

from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vmf.data.recording.write_tracks import written_quality
from vmf.experiment.tracking import _median


@given(st.lists(st.floats(0, 1), min_size=1, max_size=40))
def test_the_median_of_counted_qualities_is_that_of_all(quality: list[float]) -> None:
    written = written_quality(np.array(quality))
    assert _median(Counter(written)) == np.median(written)
