"""Motions against odometry that drifts: what is drawn is what the table says (Fig. 5.50)."""

from __future__ import annotations

import error_tables
import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from test_figures import check_layout

from vmf.report import odometry

FRAMES = np.arange(2, 62, 2)


def table(task: str) -> pd.DataFrame:
    """Errors of one trial's trained code, with the bound's rows for odometry's."""
    methods = ("vmf", "cramer_rao", "no_motion")
    errors = error_tables.block(task, "trained_code", methods, 1, FRAMES, "")
    errors["method"] = errors["method"].replace("cramer_rao", "odometry")
    return errors


def drawn(ax: Axes, label: str) -> np.ndarray:
    (line,) = [line for line in ax.get_lines() if line.get_label() == label]
    return np.asarray(line.get_xydata())


@pytest.mark.parametrize("task", ["planar", "translation", "six_dof"])
def test_the_layout_holds_for_every_task(task: str) -> None:
    figure = odometry(table(task))
    check_layout("odometry", figure)
    rows = {"planar": 4, "translation": 3, "six_dof": 6}[task]
    assert len(figure.axes) == 2 * rows


def test_headings_are_drawn_as_entries_of_their_rotation() -> None:
    errors = table("planar")
    axes = odometry(errors).axes
    labels = [ax.get_ylabel() for ax in axes[::2]]
    assert labels == ["$r_{11}$ (1)", "$r_{21}$ (1)", "$t_x$ (m)", "$t_y$ (m)"]
    heading = errors[errors["component"] == "heading"]
    measured = heading[heading["method"] == "odometry"].sort_values("frame")
    np.testing.assert_array_equal(drawn(axes[0], "odometry")[:, 1], np.cos(measured["estimate"]))
    np.testing.assert_array_equal(drawn(axes[2], "odometry")[:, 1], np.sin(measured["estimate"]))
    mine = heading[(heading["method"] == "vmf") & (heading["status"] == "ok")].sort_values("frame")
    points = drawn(axes[3], "vmf")
    np.testing.assert_array_equal(points[:, 0], mine["frame"])
    at = measured.set_index("frame").loc[mine["frame"], "estimate"].to_numpy()
    np.testing.assert_allclose(points[:, 1], np.sin(mine["estimate"]) - np.sin(at), rtol=0, atol=1e-15)


def test_without_odometry_it_says_so() -> None:
    errors = table("planar")
    figure = odometry(errors[errors["method"] != "odometry"])
    assert "does not drift" in figure.texts[0].get_text().replace("\n", " ")
