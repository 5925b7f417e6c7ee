"""What is drawn of an evaluation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vmf.experiment.evaluation_file import _Question, _shown


@pytest.mark.parametrize(
    ("status", "drawn"),
    [
        (["ok", "ok"], 0),
        (["refused", "ok", "ok"], 1),
        (["refused", "diverged", "ok"], 2),
        (["refused", "refused"], 0),
    ],
)
def test_the_first_answered_question_of_a_frame_is_drawn(status: list[str], drawn: int) -> None:
    answer: Any = SimpleNamespace(solutions=SimpleNamespace(status=np.array(status, object)))
    asked = [_Question(answer, i, np.zeros((0, 4))) for i in range(len(status))]
    assert _shown(asked) is asked[drawn]
