"""Standard errors that allow for coloured residuals.

With J the sensitivities of all outputs in units of their noise (first states made up for), estimates follow the noise
by (J'J)^-1 J', so that their covariance is (J'J)^-1 J' R J (J'J)^-1, with R that of the noise over time. R is taken
from the residuals' autocorrelation, output by output. (E. A. Morelli and V. Klein, Accuracy of aerodynamic model
parameters estimated from flight test data, J. Guidance, Control and Dynamics 20(1), 1997.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..discrepancy.linearised import Linearised, collocated
from ..planning.tangents import sensitivities
from ..result import Fit

__all__ = ["coloured_errors"]

_Array = NDArray[np.float64]

# Lags: this part of a record, and no more than so many.
_PART, _MOST = 0.2, 1000


def coloured_errors(fit: Fit) -> dict[str, float]:
    """Standard errors of the parameters that are free, by name; those of parameters that are not told are infinite."""
    fit = collocated(fit)
    linear = Linearised(fit)
    names, J = sensitivities(fit, linear)
    middle = np.zeros((len(names), len(names)))
    whitened = linear.residuals / linear.scale()
    for line in linear.rows:
        for rows in line:
            middle += _coloured(J[rows], whitened[rows])
    information = J.T @ J
    scale = np.sqrt(np.diag(information))
    scale[scale == 0.0] = 1.0
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    told = values > 1e-11
    inverse = (vectors[:, told] / values[told]) @ vectors[:, told].T / np.outer(scale, scale)
    errors = np.sqrt(np.diag(inverse @ middle @ inverse))
    errors[(np.abs(vectors[:, ~told]) > 1e-4).any(axis=1)] = np.inf
    return dict(zip(names, errors.tolist(), strict=True))


def _coloured(J: _Array, e: _Array) -> _Array:
    """J' R J for one output of one record, with R from its residuals: never negative, by Bartlett's window."""
    n = e.size
    lags = min(int(_PART * n), _MOST)
    total = np.zeros((J.shape[1],) * 2)
    for lag in range(lags + 1):
        weight = (1.0 - lag / (lags + 1.0)) * float(e[lag:] @ e[: n - lag]) / n
        part = J[lag:].T @ J[: n - lag]
        total += weight * (part if lag == 0 else part + part.T)
    return total
