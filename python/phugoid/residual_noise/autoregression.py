"""The colour of residuals: an autoregressive (AR) model of what can be predicted of them from their own past.

``r[t] = a_1 r[t-1] + ... + a_p r[t-p] + e[t]``. Its innovations e are what noise there is, whatever the residuals
consist of: by Kolmogorov's formula their variance is that of the best prediction, while differences of high order see
only the noise near the Nyquist frequency, which a filtered sensor does not have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

__all__ = ["Autoregression", "CorrelatedNoise", "burg"]

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
# Steps of a recursion that are taken at once.
_BLOCK = 64


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
        """Number of coefficients, p."""
        return len(self.predictors) - 1

    @property
    def coefficients(self) -> _Array:
        """(p,) a_1 ... a_p, of a stable model; none where the residuals are white."""
        return self.predictors[-1]

    @property
    def sigmas(self) -> _Array:
        """(p + 1,) standard deviations of the errors of the predictors, greater than zero."""
        return np.asarray(np.sqrt(np.maximum(self.powers, np.finfo(float).tiny)))

    @property
    def power(self) -> float:
        """Variance of the innovations: of what cannot be predicted."""
        return float(self.powers[-1])

    @cached_property
    def covariances(self) -> _Array:
        """(p + 1,) autocovariances of lags 0 to p, which the predictors imply from lag to lag."""
        c = [float(self.powers[0])]
        for before, after, power in zip(self.predictors[:-1], self.predictors[1:], self.powers[:-1], strict=True):
            c.append(float(before @ np.array(c[:0:-1]) + after[-1] * power))
        return np.array(c)

    def covariance(self, lags: int) -> _Array:
        """Return the autocovariance (lags,) from lag 0 on, in the unit of the residuals squared."""
        return _continued(self.covariances, self.coefficients, lags)

    def autocorrelation(self, lags: int) -> _Array:
        """Return the autocorrelation (lags,) of the model, from lag 0, where it is 1."""
        c = self.covariance(lags)
        return np.asarray(c / c[0] if c[0] > 0.0 else np.eye(1, lags)[0])

    def response(self, lags: int) -> _Array:
        """Return the impulse response (lags,): the weights of this and earlier innovations in the residual."""
        p = self.order
        first = np.zeros(p + 1)
        first[0] = 1.0
        for i in range(1, p + 1):
            first[i] = self.coefficients[:i] @ first[i - 1 :: -1][:i]
        return _continued(first, self.coefficients, lags)

    def spectrum(self, lags: int, size: int) -> _Array:
        """Return the spectrum of the autocovariance up to so many lags, on the frequencies of `numpy.fft.rfft`.

        ``size``: at least twice the number of lags.
        """
        c = self.covariance(lags)
        both = np.zeros(size)
        both[:lags] = c
        both[size - lags + 1 :] = c[:0:-1]
        return np.asarray(np.fft.rfft(both).real)

    def innovations(self, grid: _Array) -> _Array:
        """Pass values (G,) or (G, m) on a grid through the filter 1 - a_1 z^-1 - ...; NaN where a lag is missing."""
        p = self.order
        if p == 0:
            return grid
        out = np.full_like(grid, np.nan)
        out[p:] = grid[p:]
        for k, a in enumerate(self.coefficients, start=1):
            out[p:] -= a * grid[p - k : grid.shape[0] - k]
        return out

    def deviation(self, grids: Sequence[_Array]) -> float:
        """Return the standard deviation of the innovations of series on grids (NaN where missing), with the degrees of
        freedom of the model taken off."""
        found = np.concatenate([self.innovations(grid) for grid in grids])
        found = found[np.isfinite(found)]
        return math.sqrt(float(found @ found) / max(found.size - self.order, 1))


def _continued(first: _Array, a: _Array, n: int) -> _Array:
    """Continue a sequence from its first values as x[t] = a_1 x[t-1] + ..., up to n values, in blocks."""
    p = a.size
    out = np.zeros(n)
    out[: first.size] = first[:n]
    if not p or n <= first.size:
        return out
    block = np.zeros((p + min(_BLOCK, n), p))  # from the last p values to those that follow
    block[:p] = np.eye(p)
    for i in range(p, len(block)):
        block[i] = a[::-1] @ block[i - p : i]
    step = block[p:]
    at = first.size
    while at < n:
        size = min(len(step), n - at)
        out[at : at + size] = step[:size] @ out[at - p : at]
        at += size
    return out


def burg(runs: Sequence[_Array]) -> Autoregression:
    """Fit the AR models of residuals: ``runs`` are (n,) each, equally spaced and without a gap.

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


class CorrelatedNoise:
    """Residuals of size 1 with an autocorrelation: how far their weighted sums scatter.

    rho  (L,) autocorrelation, from lag 0, for as many lags as the longest grid has places.
    """

    def __init__(self, rho: _Array) -> None:
        self.rho = rho
        self._spectra: dict[int, _Array] = {}

    def spread(self, weights: Sequence[_Array]) -> float:
        """Return the standard deviation of the weighted sum of residuals; experiments are independent of each other.

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
        """Return the number of independent samples that determine a mean as well as n such samples in a row."""
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
