"""Every kind of study can be carried out, and has a commented config."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np

from vmf.spec import is_study, load_study
from vmf.spec.studies import AnyStudy
from vmf.study import QUANTITIES, STUDIES, Quantity, StudyResult
from vmf.study.result import mean_quantity

CONFIGS = Path(__file__).parents[2] / "configs"
KINDS = {model.model_fields["kind"].default for model in get_args(get_args(AnyStudy)[0])}


def test_every_kind_of_the_spec_is_in_the_registry() -> None:
    assert set(STUDIES) == KINDS


def test_every_kind_has_a_config_that_says_what_it_is() -> None:
    found = {}
    for path in CONFIGS.rglob("*.yaml"):
        if is_study(path):
            found[load_study(path).spec.study.kind] = path.read_text()
    assert set(found) == KINDS
    assert all(text.startswith("# Thesis ") for text in found.values())


def test_a_table_has_the_columns_of_the_contract_and_empty_cells() -> None:
    result = StudyResult((Quantity("a", 1.0), mean_quantity("b", np.array([1.0, 3.0]), "case", "part", "px")))
    table = result.table()
    assert tuple(table) == QUANTITIES
    assert table.to_csv(index=False).splitlines()[1:] == [
        "a,,,1,1.0,,,",
        f"b,case,part,px,2.0,2,{2 - 1.96 * np.sqrt(2) / np.sqrt(2)},{2 + 1.96 * np.sqrt(2) / np.sqrt(2)}",
    ]


def test_one_sample_has_no_interval() -> None:
    assert mean_quantity("a", np.array([2.0])).ci_low is None
