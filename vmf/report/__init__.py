"""The report of a run: the thesis's figures, in print quality."""

from vmf.report.absolute_error import absolute_error
from vmf.report.calibration_crossover import calibration_crossover
from vmf.report.comparison import comparison
from vmf.report.condition_number import condition_number
from vmf.report.mean_std_error import mean_std_error
from vmf.report.odometry import odometry
from vmf.report.paired_differences import paired_differences
from vmf.report.plots import PLOTS, PlotData, write_plots
from vmf.report.truth_vs_estimate import truth_vs_estimate
from vmf.report.update_map import update_counts, update_map

__all__ = [
    "PLOTS",
    "PlotData",
    "absolute_error",
    "calibration_crossover",
    "comparison",
    "condition_number",
    "mean_std_error",
    "odometry",
    "paired_differences",
    "truth_vs_estimate",
    "update_counts",
    "update_map",
    "write_plots",
]
