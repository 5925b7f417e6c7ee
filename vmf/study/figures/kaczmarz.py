"""How the order of training matters, and how the rank of B falls behind the number of cells."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vmf.report.style import (
    BLACK,
    BLUE,
    DOUBLE_IN,
    SKY,
    TEXT_PT,
    dress,
    footnote,
    heading,
    log_axis,
    log_limits,
    new_figure,
    styled,
)
from vmf.spec.studies import KaczmarzStudy
from vmf.study.figures.lines import line_styles

_LABELS = {
    "sorted": "cyclic, along the rows",
    "cyclic": "cyclic, shuffled once",
    "drawn": "drawn at random",
    "random": "shuffled anew each epoch",
}


@styled
def draw_orders(settings: KaczmarzStudy, courses: pd.DataFrame) -> Figure:
    """Draw residual and movement of the answers by epoch: targets that fit, and targets that do not."""
    styles = line_styles(list(_LABELS))
    figure = new_figure(DOUBLE_IN, 4.6)
    columns = {"residual": "residual (rms)", "movement": "change in an epoch (rms)"}
    for row, (column, label) in enumerate(columns.items()):
        for place, targets in enumerate(("consistent", "noisy")):
            ax = figure.add_subplot(2, 2, 2 * row + place + 1)
            dress(ax)
            drawn = []
            for order in _LABELS:
                mine = courses[(courses["targets"] == targets) & (courses["order"] == order)]
                mean = mine.groupby("epoch")[column].mean()
                # The thick line is beneath the others, of which one falls on it where targets are noisy.
                style = {**styles[order], "marker": "", "zorder": 1.9 if order == "random" else 2.0}
                ax.plot(mean.index, mean.to_numpy(), **style)
                drawn.append(mean.to_numpy(float))
            limits = log_limits(np.concatenate(drawn))
            if limits is not None:
                log_axis(ax.yaxis, (max(limits[0], limits[1] * 1e-12), limits[1]), max_labels=6)
            log_axis(ax.xaxis, (1.0, float(settings.epochs)), max_labels=6)
            ax.set_xlabel("epoch")
            if place == 0:
                ax.set_ylabel(label)
            if row == 0:
                noise = (
                    f"targets with {100 * settings.noise:g} % noise" if place else "targets a CMAC can have"
                )
                ax.set_title(noise, fontsize=TEXT_PT)
    handles = [Line2D([], [], label=_LABELS[o], **{**styles[o], "marker": ""}) for o in _LABELS]
    heading(figure, "Albus–Kaczmarz training in different orders", handles)
    footnote(
        figure,
        f"{settings.points} codes, each {settings.visits} times, {settings.cmac.overlays} overlays of "
        f"{settings.cmac.tile_px:g} px, ε = {settings.cmac.step:g}; means of {settings.orders} courses where "
        "the order is random. In units of each parameter's spread.",
    )
    return figure


@styled
def draw_ranks(settings: KaczmarzStudy, ranks: pd.DataFrame) -> Figure:
    """Draw cells, the bound L − (T − 1), and the rank of B."""
    figure = new_figure(DOUBLE_IN, 2.6)
    cases = list(dict.fromkeys(ranks["case"]))
    for place, case in enumerate(cases, start=1):
        ax = figure.add_subplot(1, len(cases), place)
        dress(ax, grid="y")
        rows = ranks[ranks["case"] == case]
        x = np.arange(len(rows))
        ax.bar(x - 0.2, rows["cells"], 0.38, color=SKY, label="cells L")
        ax.bar(x + 0.2, rows["rank"], 0.38, color=BLUE, label="rank(B)")
        for at, bound in zip(x, rows["bound"], strict=True):
            ax.plot([at - 0.42, at + 0.42], [bound, bound], color=BLACK, linewidth=1.2, label="L − (T − 1)")
        ax.set_xticks(x, [str(overlays) for overlays in rows["overlays"]])
        ax.set_xlabel("overlays T")
        ax.set_title(f"{case}, {int(rows['codes'].iloc[0]):,} codes", fontsize=TEXT_PT)
        if place == 1:
            ax.set_ylabel("number")
            handles, names = ax.get_legend_handles_labels()
            unique = dict(zip(names, handles, strict=True))
    heading(
        figure,
        f"rank of the equations of a CMAC with tiles of {settings.rank_tile_px:g} px",
        list(unique.values()),
    )
    return figure
