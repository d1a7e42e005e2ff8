"""The correlation matrix of a covariance matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["correlation_matrix"]


def correlation_matrix(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, n) correlations of a covariance (n, n); NaN beside what has no variance: NaN, infinite or not above 0.

    >>> correlation_matrix(np.array([[4.0, 0, 1], [0, np.nan, 0], [1, 0, 1]]))
    array([[1. , nan, 0.5],
           [nan, nan, nan],
           [0.5, nan, 1. ]])
    """
    variance = np.diag(covariance)
    with np.errstate(invalid="ignore"):
        deviation = np.sqrt(np.where((variance > 0.0) & np.isfinite(variance), variance, np.nan))
    return np.asarray(np.clip(covariance / np.outer(deviation, deviation), -1.0, 1.0))
