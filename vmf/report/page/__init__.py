"""One self-contained HTML page of runs, and of the thesis's numbers beside ours."""

from vmf.report.page.claims import Thesis, thesis
from vmf.report.page.origin import configs, counted
from vmf.report.page.page import Page, render, run_sections, thesis_part
from vmf.report.page.pictures import decoded
from vmf.report.page.runs import Run, Runs, flat, numbers_in
from vmf.report.page.tables import Table, frame_table

__all__ = [
    "Page",
    "Run",
    "Runs",
    "Table",
    "Thesis",
    "configs",
    "counted",
    "decoded",
    "flat",
    "frame_table",
    "numbers_in",
    "render",
    "run_sections",
    "thesis",
    "thesis_part",
]
