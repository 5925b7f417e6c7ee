"""Every figure a run's data supports, written as PNG and PDF."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from vmf.report.absolute_error import absolute_error
from vmf.report.calibration_crossover import calibration_crossover
from vmf.report.comparison import comparison
from vmf.report.condition_number import condition_number
from vmf.report.mean_std_error import mean_std_error
from vmf.report.odometry import odometry
from vmf.report.paired_differences import paired_differences
from vmf.report.style import DPI, look
from vmf.report.tables import check, select, trial_numbers
from vmf.report.truth_vs_estimate import truth_vs_estimate
from vmf.report.update_map import update_map

# Without dates and program versions the same data gives the same bytes.
METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}


@dataclass(frozen=True)
class PlotData:
    """What there is to draw; what a run did not record is None.

    Attributes
    ----------
    errors : the tidy error table.
    condition : frames (F,) and condition numbers (F,) or (trials, F).
    updates : pixels (M, 4), (width, height) and tile width, all in px.
    paired : paired differences rival − vmf.
    crossing : curves and crossovers of the calibration sweep.
    """

    errors: pd.DataFrame
    condition: tuple[ArrayLike, ArrayLike] | None = None
    updates: tuple[ArrayLike, tuple[int, int], float] | None = None
    paired: pd.DataFrame | None = None
    crossing: tuple[pd.DataFrame, pd.DataFrame] | None = None

    def asked(self, protocol: str, **values: object) -> pd.DataFrame:
        """Return the rows of a protocol."""
        return select(self.errors, protocol=protocol, **values)


Plot = Callable[[PlotData], Figure | None]

PLOTS: dict[str, Plot] = {
    "truth_vs_estimate": lambda data: _one_trial(data, truth_vs_estimate),
    "absolute_error": lambda data: _one_trial(data, absolute_error),
    "mean_std_error": lambda data: mean_std_error(data.errors) if len(data.asked("trained_code")) else None,
    "comparison_trained_code": lambda data: _comparison(data, "trained_code"),
    "comparison_held_out": lambda data: _comparison(data, "held_out"),
    "paired_differences": lambda data: (
        None if data.paired is None or data.paired.empty else paired_differences(data.paired)
    ),
    "calibration_crossover": lambda data: (
        None if data.crossing is None else calibration_crossover(*data.crossing)
    ),
    "odometry": lambda data: (
        _one_trial(data, odometry) if len(data.asked("trained_code", method="odometry")) else None
    ),
    "condition_number": lambda data: None if data.condition is None else condition_number(*data.condition),
    "update_map": lambda data: None if data.updates is None else update_map(*data.updates),
}


def write_plots(
    directory: Path,
    errors: pd.DataFrame,
    *,
    condition: tuple[ArrayLike, ArrayLike] | None = None,
    updates: tuple[ArrayLike, tuple[int, int], float] | None = None,
    paired: pd.DataFrame | None = None,
    crossing: tuple[pd.DataFrame, pd.DataFrame] | None = None,
    pdf: bool = True,
) -> tuple[Path, ...]:
    """Write every figure the data supports as PNG and PDF, atomically, and return the PNGs' paths.

    Without `pdf`, which is most of the work, there are PNGs alone.
    """
    check(errors)
    data = PlotData(errors, condition, updates, paired, crossing)
    directory.mkdir(parents=True, exist_ok=True)
    written = []
    for name, plot in PLOTS.items():
        figure = plot(data)
        if figure is not None:
            written.append(save(figure, directory / name, pdf))
    return tuple(written)


def save(figure: Figure, stem: Path, pdf: bool = True) -> Path:
    """Write `stem.png` and `stem.pdf`, each by a temporary file and a rename; return the PNG's path."""
    for kind, content in rendered(figure, pdf).items():
        _replace(stem.with_name(f"{stem.name}.{kind}"), content)
    return stem.with_name(f"{stem.name}.png")


def rendered(figure: Figure, pdf: bool = True) -> dict[str, bytes]:
    """Return a figure's files by kind: `png` and, if wanted, `pdf`."""
    with look():
        # The layout is the same in both, and is most of the work.
        if figure.axes and (layout := figure.get_layout_engine()) is not None:
            layout.execute(figure)
    figure.set_layout_engine(None)
    contents = {}
    for kind, metadata in METADATA.items():
        if kind == "pdf" and not pdf:
            continue
        buffer = BytesIO()
        with look():
            figure.savefig(buffer, format=kind, dpi=DPI, metadata=metadata)
        contents[kind] = buffer.getvalue()
    return contents


def _replace(path: Path, content: bytes) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _one_trial(data: PlotData, draw: Callable[[pd.DataFrame, int], Figure]) -> Figure | None:
    """Draw the first trial in which vmf was asked the trained code, if any."""
    trials = trial_numbers(data.asked("trained_code", method="vmf"))
    return draw(data.errors, trials[0]) if trials else None


def _comparison(data: PlotData, protocol: str) -> Figure | None:
    rows = data.asked(protocol)
    return comparison(rows, protocol) if len(rows) else None
