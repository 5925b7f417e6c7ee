"""Least squares for many small problems at once."""

from vmf.optimise.levenberg_marquardt import LeastSquares, Stop, levenberg_marquardt

__all__ = ["LeastSquares", "Stop", "levenberg_marquardt"]
