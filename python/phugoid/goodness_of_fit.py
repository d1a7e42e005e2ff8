"""The chi-square test of residuals against noise whose standard deviations are known."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .noise.noise import Gaussian, Noise
from .records import Record

__all__ = ["chi_square", "chi_square_warning"]

# Residuals are reported to differ from the noise that was given where chance explains the difference with less than
# this probability, and their variances differ by more than this factor: in long records trifles are significant.
_LEVEL, _FACTOR = 1e-3, 1.2


def chi_square(noise: Noise, outputs: Sequence[str], records: Sequence[Record]) -> tuple[float, int]:
    """Return the sum of r' R^-1 r over the samples, each with the rows and columns of R that are measured, and the
    number of measured values in it.

    Outputs whose standard deviation is not known are left out. NaN and 0 where none is known, where noise is not
    Gaussian, and where the states of a record do not satisfy the equations.
    """
    known = noise.known_sigmas(outputs) if isinstance(noise, Gaussian) else {}
    names = [name for name in outputs if name in known]
    if not names or not all(record.feasible for record in records):
        return math.nan, 0
    assert isinstance(noise, Gaussian)
    R = np.diag([known[name] ** 2 for name in names]) if noise.covariance is None else noise.matrix(outputs)
    total, count = 0.0, 0
    for record in records:
        residuals = np.array([record.residuals[name] for name in names])
        there = np.isfinite(residuals)
        count += int(there.sum())
        for pattern in np.unique(there, axis=1).T:
            if pattern.any():
                r = residuals[np.ix_(pattern, (pattern == there.T).all(axis=1))]
                total += float(np.sum(r * np.linalg.solve(R[np.ix_(pattern, pattern)], r)))
    return total, count


def chi_square_warning(noise: Noise, outputs: Sequence[str], records: Sequence[Record], unknowns: int) -> str:
    """Return a sentence where the residuals are not those of the noise that was declared, else "".

    ``unknowns``: the number of parameters and initial states that were estimated.
    """
    from scipy.special import gammainc, gammaincc

    total, count = chi_square(noise, outputs, records)
    degrees = count - unknowns
    if not math.isfinite(total) or degrees < 1:
        return ""
    ratio = total / degrees
    numbers = f"chi-square is {total:.4g} on {degrees} degrees of freedom"
    size = f"{math.sqrt(ratio):.3g} times the noise that is given as known"
    if ratio > _FACTOR and gammaincc(0.5 * degrees, 0.5 * total) < _LEVEL:
        return (
            f"the residuals are {size} ({numbers}): the model does not explain the data to that accuracy, or the noise "
            "is larger; standard errors and likelihood are those of the noise as given"
        )
    if ratio < 1 / _FACTOR and gammainc(0.5 * degrees, 0.5 * total) < _LEVEL:
        return f"the residuals are only {size} ({numbers}): that noise is too large, and so are the standard errors"
    return ""
