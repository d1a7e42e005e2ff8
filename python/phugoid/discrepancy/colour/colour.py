"""The colour of residuals: an autoregressive (AR) model of what can be predicted of them from their own past.

``r[t] = a_1 r[t-1] + ... + a_p r[t-p] + e[t]``. Its innovations e are what noise there is, whatever the residuals
consist of: by Kolmogorov's formula their variance is that of the best prediction, while differences of high order see
only the noise near the Nyquist frequency, which a filtered sensor does not have.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .autoregression import burg

__all__ = ["Colour", "Memory", "colour_of"]

_Array = NDArray[np.float64]

_MEMORY = 8  # times the lags asked for


@dataclass(frozen=True, eq=False)
class Colour:
    """An AR model.

    coefficients  (p,) a_1 ... a_p, of a stable model; none where the residuals are white.
    noise         standard deviation of the innovations.
    """

    coefficients: _Array
    noise: float

    @property
    def order(self) -> int:
        """Number of lags, p."""
        return int(self.coefficients.size)

    def whitened(self, grid: _Array) -> _Array:
        """(G,) or (G, m) passed through the filter 1 - a_1 z^-1 - ...; NaN where a lag is missing."""
        p = self.order
        if p == 0:
            return grid
        out = np.full_like(grid, np.nan)
        out[p:] = grid[p:]
        for k, a in enumerate(self.coefficients, start=1):
            out[p:] -= a * grid[p - k : grid.shape[0] - k]
        return out

    def autocorrelation(self, lags: int) -> _Array:
        """(lags,) of the model, from lag 0, where it is 1."""
        if self.order == 0:
            return np.concatenate([[1.0], np.zeros(lags - 1)])
        # The transform of its spectrum, over a time so long that what is left there of the memory does not matter.
        size = 1 << (_MEMORY * max(lags, 128)).bit_length()
        spectrum = np.abs(np.fft.rfft(np.concatenate([[1.0], -self.coefficients]), size)) ** -2.0
        full = np.fft.irfft(spectrum)[:lags]
        return np.asarray(full / full[0])


class Memory:
    """Residuals of size 1 with an autocorrelation: how far their weighted sums scatter.

    rho  (L,) autocorrelation, from lag 0, for as many lags as the longest grid has places.
    """

    def __init__(self, rho: _Array) -> None:
        self.rho = rho
        self._spectra: dict[int, _Array] = {}

    def spread(self, weights: Sequence[_Array]) -> float:
        """Standard deviation of the weighted sum of residuals; each experiment has a memory of its own.

        ``weights``: (G,) on the grid of each experiment, 0 where there is no sample. For weights 1/n it is the standard
        error of a mean, corrected for blocks of samples that are alike.
        """
        # sum_ts w_t w_s rho(t - s), by the convolution theorem.
        total = 0.0
        for w in weights:
            size = 1 << (2 * w.size - 1).bit_length()
            total += float((np.abs(np.fft.rfft(w, size)) ** 2) @ self._spectrum(size)) / size
        return math.sqrt(max(total, 0.0))

    def effective(self, n: int) -> float:
        """Samples that n such ones in a row are worth for their mean."""
        return float(np.clip(self.spread([np.full(n, 1.0 / n)]) ** -2.0, 1.0, n))

    def _spectrum(self, size: int) -> _Array:
        """Weights of the frequencies of `numpy.fft.rfft`, those between 0 and Nyquist twice."""
        if size not in self._spectra:
            lags = min(self.rho.size, size // 2)
            both = np.zeros(size)
            both[:lags] = self.rho[:lags]
            both[size - lags + 1 :] = self.rho[lags - 1 : 0 : -1]
            spectrum = np.fft.rfft(both).real
            spectrum[1:-1] *= 2.0
            self._spectra[size] = spectrum
        return self._spectra[size]


def colour_of(grids: Sequence[_Array]) -> Colour:
    """The AR model of residuals on grids, NaN where missing, none of them all zero."""
    a = burg([run for grid in grids for run in _runs(grid)]).predictors[-1]
    innovations = np.concatenate([Colour(a, math.nan).whitened(grid) for grid in grids])
    innovations = innovations[np.isfinite(innovations)]
    freedom = max(innovations.size - a.size, 1)
    return Colour(a, math.sqrt(float(innovations @ innovations) / freedom))


def _runs(grid: _Array) -> list[_Array]:
    there = np.isfinite(grid)
    edges = np.flatnonzero(np.diff(there.astype(np.int8)))
    return [run for run in np.split(grid, edges + 1) if np.isfinite(run[0])]
