"""The population that records' own parameters are drawn from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Population"]

_Array = NDArray[np.float64]

# Steps of the search for the standard deviation, and its least size, as a part of the records' standard errors.
_STEPS = 60
_LEAST = 1e-3


@dataclass(frozen=True)
class Population:
    """A normal distribution of which each record's value of a parameter is a draw.

    mean, std        its parameters, in the parameter's unit.
    mean_error       standard error of the mean.
    std_error        standard error of the standard deviation.
    """

    name: str
    mean: float
    std: float
    mean_error: float = math.nan
    std_error: float = math.nan

    def fitted(self, values: _Array, errors: _Array) -> Population:
        """Return the likeliest population, given estimates of the records' values under this one as their prior.

        values, errors  (n,) estimates and standard errors of the records, this population counted as their prior.

        What the record itself says is the estimate without the prior, value b and standard error s, and the likelihood
        of the population is that of normal variables of mean m and variance t^2 + s^2: one step of Newton's method in
        m, for trial values of t (Laplace's approximation; exact where a record's likelihood is that of a normal
        variable).
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            precision = 1.0 / errors**2 - 1.0 / self.std**2
        told = np.isfinite(values) & np.isfinite(errors) & (precision > 1e-6 / self.std**2)
        if told.sum() < 2:
            return self
        precision = precision[told]
        own = (values[told] / errors[told] ** 2 - self.mean / self.std**2) / precision
        variance = 1.0 / precision

        def at(std: float) -> tuple[float, float]:
            weights = 1.0 / (std**2 + variance)
            mean = float(weights @ own / weights.sum())
            return mean, float(0.5 * np.sum(np.log(weights) - weights * (own - mean) ** 2))

        typical = float(np.sqrt(np.median(variance)))
        low, high = math.log(_LEAST * typical), math.log(10.0 * (float(np.std(own)) + typical))
        grid = np.linspace(low, high, _STEPS)
        best = int(np.argmax([at(math.exp(g))[1] for g in grid]))
        a, b = grid[max(best - 1, 0)], grid[min(best + 1, _STEPS - 1)]
        for _ in range(_STEPS):  # golden section
            c, d = b - 0.618034 * (b - a), a + 0.618034 * (b - a)
            if at(math.exp(c))[1] > at(math.exp(d))[1]:
                b = d
            else:
                a = c
        std = math.exp(0.5 * (a + b))
        mean, _ = at(std)
        weights = 1.0 / (std**2 + variance)
        # Fisher information of the mean and of the standard deviation.
        return Population(
            self.name,
            mean,
            std,
            1.0 / math.sqrt(weights.sum()),
            1.0 / math.sqrt(2.0 * std**2 * float(weights @ weights)),
        )

    def moved(self, other: Population) -> float:
        """Return how far another population is, in standard errors of that one."""
        errors = (other.mean_error, other.std_error)
        if not all(e > 0.0 for e in errors):
            return math.inf
        return max(abs(self.mean - other.mean) / errors[0], abs(self.std - other.std) / errors[1])
