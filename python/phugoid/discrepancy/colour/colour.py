"""The colour of residuals: an autoregressive (AR) model of what can be predicted of them from their own past.

``r[t] = a_1 r[t-1] + ... + a_p r[t-p] + e[t]``. Its innovations e are what noise there is, whatever the residuals
consist of: by Kolmogorov's formula their variance is that of the best prediction, while differences of high order see
only the noise near the Nyquist frequency, which a filtered sensor does not have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Autoregression", "Channel", "Colour", "Memory", "autoregressive", "burg", "colour_of"]

_Array = NDArray[np.float64]

# The greatest order.
_LONGEST = 12
# Samples for each coefficient, and samples whose lags are all there for each.
_SAMPLES_EACH, _PAIRS_EACH = 10, 5
# Of all samples, the part whose lags are all there: of a record in tatters little can be said.
_TATTERS = 4
# A reflection coefficient this near to 1 is as good as a unit root: the filter stays invertible.
_EDGE = 1.0 - 1e-6
# What is left of the variance where the next sample is known from those before it: rounding.
_EXACT = 1e-14


@dataclass(frozen=True, eq=False)
class Autoregression:
    """AR models of one series, of all orders up to the best.

    predictors  predictors[k] (k,) are a_1 ... a_k, the best prediction from k samples.
    powers      (p + 1,) variances of their errors, from that of the residuals on.
    """

    predictors: tuple[_Array, ...]
    powers: _Array

    @property
    def order(self) -> int:
        """p."""
        return len(self.predictors) - 1


def burg(runs: Sequence[_Array]) -> Autoregression:
    """The AR models of residuals: ``runs`` are (n,) each, equally spaced and without a gap.

    Runs (k, n) are k sequences that stand for the same samples: their squares are added, and samples count once.

    The order has the least BIC (Schwarz 1978), of those up to 12 and a tenth of the samples, as long as the lags are
    there for a quarter of the samples. What an order gains counts for the samples that have its lags: where there are
    gaps, few have long ones. The mean is not removed, for that of residuals should be zero.
    """
    n = sum(run.shape[-1] for run in runs)
    power = sum(_product(run, run) for run in runs) / max(n, 1)
    predictors, powers = [np.empty(0)], [power]
    forward, backward = list(runs), list(runs)
    best, bic, best_bic = 0, 0.0, 0.0
    for p in range(1, min(_LONGEST, n // _SAMPLES_EACH) + 1):
        # Runs that are shorter than the lags say nothing more.
        pairs = [(f[..., 1:], b[..., :-1]) for f, b in zip(forward, backward, strict=True) if f.shape[-1] > 1]
        size = sum(_product(f, f) + _product(b, b) for f, b in pairs)
        count = sum(f.shape[-1] for f, _ in pairs)
        if size <= 0.0 or count < max(n // _TATTERS, _PAIRS_EACH * p):
            break
        k = float(np.clip(2.0 * sum(_product(f, b) for f, b in pairs) / size, -_EDGE, _EDGE))
        predictors.append(np.r_[predictors[-1] - k * predictors[-1][::-1], k])
        powers.append(powers[-1] * (1.0 - k * k))
        forward, backward = [f - k * b for f, b in pairs], [b - k * f for f, b in pairs]
        bic += count * math.log1p(-k * k) + math.log(n)
        if bic < best_bic:
            best, best_bic = p, bic
        if abs(k) == _EDGE or powers[-1] <= _EXACT * power:  # as a constant and a pure sine are
            break
    return Autoregression(tuple(predictors[: best + 1]), np.array(powers[: best + 1]))


def _product(a: _Array, b: _Array) -> float:
    return float(a @ b) if a.ndim == 1 else float(np.einsum("ij,ij->", a, b))


@dataclass(frozen=True, eq=False)
class Channel:
    """The autoregressive model of one channel.

    predictors  predictors[k] (k,) is the best predictor from k samples: r_t is about sum_i predictors[k][i] r_{t-1-i}.
    sigmas      (p + 1,) standard deviations of their errors.
    """

    predictors: tuple[_Array, ...]
    sigmas: _Array

    @property
    def order(self) -> int:
        """p."""
        return len(self.predictors) - 1


def autoregressive(runs: Sequence[_Array]) -> Channel:
    """The model of residuals, runs of equally spaced samples."""
    model = burg(runs)
    return Channel(model.predictors, np.sqrt(np.maximum(model.powers, np.finfo(float).tiny)))


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
