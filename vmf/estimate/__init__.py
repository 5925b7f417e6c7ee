"""Visuomotor parameters from motions and image-based errors (§3.3), one estimator a name."""

from vmf.estimate.estimators import ESTIMATORS, Estimator, MlEstimator, QrEstimator, TlsEstimator
from vmf.estimate.gauge import in_gauge, sign_at_rest, thesis_gauge, unit_depth_gauge
from vmf.estimate.linear import LINEAR, Estimate, condition_number, least_squares, total_least_squares
from vmf.estimate.maximum_likelihood import maximum_likelihood
from vmf.estimate.rows import augmented_rows, update_rank_1, update_rank_k
from vmf.estimate.stereo import CAMERAS, Cameras, StereoEquations

__all__ = [
    "CAMERAS",
    "ESTIMATORS",
    "LINEAR",
    "Cameras",
    "Estimate",
    "Estimator",
    "MlEstimator",
    "QrEstimator",
    "StereoEquations",
    "TlsEstimator",
    "augmented_rows",
    "condition_number",
    "in_gauge",
    "least_squares",
    "maximum_likelihood",
    "sign_at_rest",
    "thesis_gauge",
    "total_least_squares",
    "unit_depth_gauge",
    "update_rank_1",
    "update_rank_k",
]
