"""Measurement noise of one channel: white, or autoregressive with a little white noise on top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

__all__ = ["WHITE", "Colour"]


@dataclass(frozen=True)
class Colour:
    """Correlation of a stationary noise of unit variance.

    reflection  coefficients of the autoregressive part; the first is its lag-1 autocorrelation; () is white noise.
    white       part of the variance that is white noise on top.
    """

    reflection: tuple[float, ...] = ()
    white: float = 0.0

    @staticmethod
    def draw(rng: np.random.Generator) -> Colour:
        """Order 1 to 3, lag-1 autocorrelation 0.5 to 0.97; in three of ten channels 2 to 15 % of it is white."""
        total = rng.uniform(0.5, 0.97)
        white = rng.uniform(0.02, 0.15) if rng.random() < 0.3 else 0.0
        if total / (1 - white) > 0.985:
            white = 0.0
        others = rng.uniform(-0.4, 0.4, int(rng.integers(0, 3)))
        return Colour((total / (1 - white), *others.tolist()), white)

    @property
    def lag_one(self) -> float:
        """Lag-1 autocorrelation of the whole."""
        return (1 - self.white) * self.reflection[0] if self.reflection else 0.0

    def autocorrelation(self, n: int) -> np.ndarray:
        """(n,) at lags 0 to n - 1, by Levinson's recursion and then the autoregression itself."""
        rho, a = np.zeros(n), np.zeros(0)
        rho[0], error = 1.0, 1.0
        for k, reflection in enumerate(self.reflection, 1):
            rho[k] = a @ rho[k - 1 : 0 : -1] + reflection * error
            a = np.append(a - reflection * a[::-1], reflection)
            error *= 1 - reflection**2
        p = a.size
        for k in range(p + 1, n):
            rho[k] = a @ rho[k - 1 : k - p - 1 : -1] if p else 0.0
        rho[1:] *= 1 - self.white
        return rho

    def factor(self, n: int) -> np.ndarray:
        """(n, n) lower triangle L with L Lᵀ the correlation matrix of n samples."""
        return np.asarray(cholesky(toeplitz(self.autocorrelation(n)), lower=True))

    def sample(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """(n,) of the noise, stationary from the first on."""
        e = rng.standard_normal(n)
        return self.factor(n) @ e if self.reflection else e

    def whiten(self, y: np.ndarray) -> np.ndarray:
        """L⁻¹ y for (n, lanes)."""
        return solve_triangular(self.factor(len(y)), y, lower=True, check_finite=False) if self.reflection else y


WHITE = Colour()
