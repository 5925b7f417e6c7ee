"""Errors of joint motions over the number of frames, and how unknowns grow with the number of joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vmf.report.style import (
    BLUE,
    DOUBLE_IN,
    GREY,
    SINGLE_IN,
    SMALL_PT,
    TEXT_PT,
    VERMILLION,
    dress,
    footnote,
    heading,
    log_axis,
    log_limits,
    new_figure,
    styled,
)
from vmf.spec.studies import JointSpaceStudy
from vmf.study.figures.lines import line_styles
from vmf.study.result import Quantity

_TITLES = {"trained_code": "targets of training", "held_out": "new targets"}


@styled
def draw_errors(settings: JointSpaceStudy, errors: pd.DataFrame) -> Figure:
    """Draw the median error of a joint motion against the number of training frames."""
    from vmf.study.joint_space import error_norms

    norms = error_norms(errors)
    names = [name for name in dict.fromkeys(norms["method"]) if name != "no motion"]
    # Ours is drawn last, and thick.
    ordered = [*names[1:], names[0]]
    styles = line_styles(ordered)
    medians = norms.groupby(["protocol", "method", "frames"])["error_rad"].median()
    limits = log_limits(medians.to_numpy(float))
    figure = new_figure(DOUBLE_IN, 3.4)
    for place, (protocol, title) in enumerate(_TITLES.items(), start=1):
        ax = figure.add_subplot(1, 2, place)
        dress(ax)
        for name in ordered:
            mine = medians[protocol, name]
            ax.plot(mine.index, mine.to_numpy(), **styles[name])
        still = float(medians[protocol, "no motion"].iloc[0])
        ax.axhline(still, color=GREY, linewidth=0.8, linestyle=(0, (1, 1.6)))
        ax.text(min(settings.frames), still, "no motion", color=GREY, fontsize=SMALL_PT, va="bottom")
        log_axis(ax.xaxis, (min(settings.frames) / 1.15, max(settings.frames) * 1.15), max_labels=6)
        if limits is not None:
            log_axis(ax.yaxis, (limits[0], limits[1] * 1.3), max_labels=8)
        ax.set_xlabel("training frames")
        if place == 1:
            ax.set_ylabel("median |error| of the joints (rad)")
        ax.set_title(title, fontsize=TEXT_PT)
    heading(
        figure,
        "joint motions from image-based errors",
        [Line2D([], [], label=name, **styles[name]) for name in names],
    )
    footnote(
        figure,
        f"{len(settings.links)} joints within {settings.reach_rad:g} rad of home, {settings.targets} "
        f"targets, {settings.pixel_px:g} px of noise, {settings.questions} questions about "
        f"{settings.question_targets} targets each; norm of all joints' errors.",
    )
    return figure


@styled
def draw_unknowns(settings: JointSpaceStudy, unknowns: Sequence[Quantity]) -> Figure:
    """Draw the number of parameters of a target against the number of joints."""
    figure = new_figure(SINGLE_IN, 2.4)
    ax = figure.add_subplot()
    dress(ax)
    joints = [q.value for q in unknowns if q.case == "joint space"]
    n = np.arange(1, len(joints) + 1)
    ax.plot(n, joints, color=BLUE, marker="o", markersize=4, linewidth=2.0, label="joint space, 3·3ⁿ − 1")
    se3 = next(q.value for q in unknowns if q.case == "SE(3)")
    ax.axhline(se3, color=VERMILLION, linestyle=(0, (6, 1.5)), linewidth=1.1, label=f"SE(3), {se3:g}")
    log_axis(ax.yaxis, (5.0, max(joints) * 1.8), max_labels=7)
    for x, y in zip(n, joints, strict=True):
        ax.annotate(f"{y:,.0f}", (x, y), (4, -8), textcoords="offset points", fontsize=SMALL_PT)
    ax.set_xlim(0.7, len(joints) + 0.8)
    ax.set_xlabel("joints n")
    ax.set_ylabel("unknowns of a target")
    heading(figure, "parameters of one target in one camera", ax.get_lines())
    return figure
