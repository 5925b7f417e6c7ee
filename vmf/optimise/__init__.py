"""Optimisers over batches of problems."""

from vmf.optimise.arrow import ArrowFit, Equations, minimise_arrow
from vmf.optimise.levenberg_marquardt import LeastSquares, Stop, levenberg_marquardt

__all__ = ["ArrowFit", "Equations", "LeastSquares", "Stop", "levenberg_marquardt", "minimise_arrow"]
