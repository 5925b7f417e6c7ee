"""What is written to the run directory."""

from __future__ import annotations

import warnings
from pathlib import Path

import error_tables as tables
import matplotlib as mpl
import pytest

from vmf.report import plots, write_plots


def written(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir()}


def test_the_same_data_gives_the_same_bytes_whatever_the_users_style(tmp_path: Path) -> None:
    pixels = (tables.stereo_pixels(50, (64, 48)), (64, 48), 8.0)
    errors = tables.few_answers()
    first = write_plots(tmp_path / "a", errors, updates=pixels, condition=tables.condition())
    hostile = {"font.size": 20, "axes.grid": True, "savefig.bbox": "tight", "lines.marker": "x"}
    with mpl.rc_context(hostile):
        write_plots(tmp_path / "b", errors, updates=pixels, condition=tables.condition())
    a, b = written(tmp_path / "a"), written(tmp_path / "b")
    assert set(a) == {f"{path.stem}.{kind}" for path in first for kind in ("png", "pdf")}
    assert a == b


def test_only_what_the_data_supports_is_written(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        errors = tables.few_answers()
        paths = write_plots(
            tmp_path,
            errors,
            paired=tables.paired(errors),
            condition=([1, 2], [5.0, 3.0]),
            crossing=tables.calibration_sweep(),
        )
    names = ["comparison_held_out", "paired_differences", "calibration_crossover", "condition_number"]
    assert paths == tuple(tmp_path / f"{name}.png" for name in names)
    assert write_plots(tmp_path / "none", errors.head(0)) == ()


def test_png_alone_is_the_same_png(tmp_path: Path) -> None:
    errors = tables.few_answers()
    both = write_plots(tmp_path / "both", errors)
    alone = write_plots(tmp_path / "alone", errors, pdf=False)
    assert written(tmp_path / "alone") == {path.name: path.read_bytes() for path in both}
    assert [path.name for path in alone] == [path.name for path in both]


def test_all_refused_is_written_too(tmp_path: Path) -> None:
    paths = write_plots(tmp_path, tables.all_refused(), paired=tables.paired(tables.all_refused()))
    assert len(paths) == 5


def test_a_failed_write_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_plots(tmp_path, tables.few_answers())
    before = written(tmp_path)

    def full_disk(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(plots.os, "replace", full_disk)
    with pytest.raises(OSError, match="disk full"):
        write_plots(tmp_path, tables.few_answers())
    assert written(tmp_path) == before
