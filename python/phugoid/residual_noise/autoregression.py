"""The colour of residuals: an autoregressive (AR) model of what can be predicted of them from their own past.

``r[t] = a_1 r[t-1] + ... + a_p r[t-p] + e[t]``. Its innovations e are what noise there is, whatever the residuals
consist of: by Kolmogorov's formula their variance is that of the best prediction, while differences of high order see
only the noise near the Nyquist frequency, which a filtered sensor does not have. Also at which frequencies residuals
have their power: Welch's spectrum, bands above white noise, and tones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

import phugoid._core as _core

from ..goodness_of_fit import chi_square_quantile
from . import Series

__all__ = [
    "Autoregression",
    "Band",
    "CorrelatedNoise",
    "Spectrum",
    "Tone",
    "burg",
    "spectrum_of",
    "tones_of",
]

_Array = NDArray[np.float64]

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
    predictors, powers = _core.burg(list(runs))
    return Autoregression(tuple(predictors), powers)


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


_SEGMENT = 256  # samples of a segment of Welch's method, at most
_BACKGROUND = 61  # frequencies whose median is the background of a tone
_NEAR = np.repeat([1.0, 0.0, 1.0], [8, 5, 8])  # weights of lines by a line, without those that its window spreads to
_SLOWEST = 4  # cycles in the record: less is not a tone
_LEAST = 64  # places of the grid for a tone
_MOST = 3


@dataclass(frozen=True)
class Band:
    """``share`` of the residuals' power lies from ``low`` to ``high`` (Hz), more than white noise has there."""

    low: float
    high: float
    share: float


@dataclass(frozen=True)
class Tone:
    """A line at ``frequency`` (Hz) with ``amplitude``, and ``share`` of the power of an experiment's residuals."""

    experiment: str
    frequency: float
    amplitude: float
    share: float


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum:
    """One-sided power spectral density of the residuals.

    frequency  (k,) Hz, without 0.
    density    (k,) unit²/Hz.
    level      density of white noise of the same power.
    most_below Hz: 80 % of the power lies at lower frequencies.
    bands      where the density is above that of white noise by more than chance, the largest share first.
    freedom    degrees of freedom of each value: density / expectation * freedom is chi-square distributed.
    """

    frequency: _Array
    density: _Array
    level: float
    most_below: float
    bands: tuple[Band, ...]
    freedom: float


def spectrum_of(series: Sequence[Series], alpha: float) -> Spectrum:
    """Estimate the spectrum by Welch's method, over all experiments of one rate.

    Welch (1967): segments with Hann's window, half overlapped.

    Segments are not freed of their mean: a bias is part of the misfit. Gaps count as residuals of zero, and the density
    is scaled to the samples that are there.
    """
    longest = max(s.segment.size for s in series)
    size = int(np.clip(longest, 8, _SEGMENT))
    if size > 64:  # four segments at least, so that bands differ from chance
        size = max(64, min(size, (sum(s.segment.size for s in series) * 2) // 9))
    density: _Array = np.zeros(size // 2 + 1)
    segments = 0
    window = np.hanning(size + 1)[:-1]
    scale = 2.0 * series[0].segment.step / float(window @ window)
    frequency = np.asarray(np.fft.rfftfreq(size, series[0].segment.step), dtype=np.float64)
    for s in series:
        grid = s.segment.on_grid(s.r, 0.0)
        if grid.size < size // 2 and grid.size < longest:
            continue  # too short to resolve frequencies
        grid = np.pad(grid, (0, max(size - grid.size, 0)))
        pieces = sliding_window_view(grid, size)[:: size - size // 2]
        # Of gaps: the mean square over the grid is less than that over the samples.
        density += (np.abs(np.fft.rfft(pieces * window)) ** 2).sum(axis=0) * scale * grid.size / s.r.size
        segments += len(pieces)
    frequency, density = frequency[1:], np.asarray(density[1:] / segments, dtype=np.float64)
    step = frequency[0]
    level = float(density.mean())
    total = density.sum()
    below = float(np.interp(0.8, np.cumsum(density) / total, frequency))
    # Two degrees of freedom of each segment, but neighbours, half overlapped, have a correlation of 1/36 (Welch 1967).
    freedom = 2.0 * segments / (1.0 + 2.0 / 36.0)
    over = density > level * chi_square_quantile(freedom, alpha / density.size) / freedom
    bands = []
    # From a peak that is no chance, a band reaches as far as the density is above that of white noise.
    for low, high in _groups(density > level):
        if not over[low : high + 1].any():
            continue
        share = float(density[low : high + 1].sum() / total)
        lowest = 0.0 if low == 0 else float(frequency[low] - 0.5 * step)
        bands.append(Band(lowest, float(frequency[high] + 0.5 * step), share))
    bands.sort(key=lambda band: -band.share)
    return Spectrum(frequency, density, level, below, tuple(bands[:_MOST]), freedom)


def tones_of(series: Sequence[Series], alpha: float) -> list[Tone]:
    """Lines that rise above the spectrum on either side of them, the strongest first.

    Of the periodogram of each experiment, flattened by a first-order filter, which can be no resonance. Its background
    is the running median, and the mean close by; ratios to it have an F-distribution where there is no tone.
    """
    found: list[Tone] = []
    for s in series:
        grid = s.segment.on_grid(s.r - s.r.mean(), 0.0)
        power = float(grid @ grid)
        if grid.size < _LEAST or power == 0.0:
            continue
        slope = float(grid[:-1] @ grid[1:]) / power
        flat = grid[1:] - slope * grid[:-1]
        # Tapered over a tenth at either end: little leakage is left, and little is lost.
        edge = np.hanning(2 * (flat.size // 10) + 1)[: flat.size // 10]
        flat[: edge.size] *= edge
        flat[flat.size - edge.size :] *= edge[::-1]
        step = 1.0 / (flat.size * s.segment.step)
        chance = alpha / (flat.size * len(series))
        peaks = [peak for shift in (0.0, 0.5) for peak in _peaks(flat, shift, chance)]
        kept: list[float] = []
        for _, place in sorted(peaks, reverse=True):
            if len(kept) < _MOST and all(abs(place - other) > 2.0 for other in kept):
                kept.append(place)
                frequency, amplitude = _line(s, place * step, step)
                share = 0.5 * amplitude**2 / float(np.mean(s.r**2))
                found.append(Tone(s.experiment, frequency, amplitude, min(share, 1.0)))
    return sorted(found, key=lambda tone: -tone.share)[:_MOST]


def _peaks(x: _Array, shift: float, chance: float) -> list[tuple[float, float]]:
    """Lines of the periodogram that are no chance: how far above the limit, and where, in lines from 0.

    ``shift``: part of a line that all lines are moved by; a tone halfway between two would lose more than half of its
    power in both.
    """
    from scipy.ndimage import median_filter
    from scipy.special import fdtri

    turned = x * np.exp(-2j * np.pi * shift * np.arange(x.size) / x.size)
    lines = np.abs(np.fft.fft(turned)[1 : x.size // 2 - 1]) ** 2  # neither 0 nor Nyquist
    width = min(_BACKGROUND, lines.size // 2 * 2 - 1)
    background = median_filter(lines, width, mode="reflect") / np.log(2.0)
    # A median of k exponential values is as sure as the mean of about 0.48 k; the window joins neighbours.
    ratio = lines / np.maximum(background, 1e-300) / fdtri(2, 2 * 0.48 * width / 1.15, 1.0 - chance)
    # A resonance is broad, a tone is not: the line must rise above the mean of those close by, too.
    near = np.convolve(np.pad(lines, _NEAR.size // 2, "reflect"), _NEAR / _NEAR.sum(), "valid")
    sharp = lines / np.maximum(near, 1e-300) / fdtri(2, 2 * _NEAR.sum() / 1.15, 1.0 - chance)
    over = np.minimum(ratio, sharp)
    return [(float(over[k]), k + 1 + shift) for k in np.flatnonzero(over > 1.0) if k + 1 >= _SLOWEST]


def _line(s: Series, near: float, step: float) -> tuple[float, float]:
    """Frequency and amplitude of the sine that fits the residuals best, within a line of the periodogram."""
    best = (near, 0.0)
    for frequency in np.linspace(near - step, near + step, 41):
        angle = 2.0 * np.pi * frequency * (s.t - s.t[0])
        columns = np.column_stack([np.cos(angle), np.sin(angle)])
        a, b = np.linalg.lstsq(columns, s.r, rcond=None)[0]
        best = max(best, (float(frequency), float(np.hypot(a, b))), key=lambda pair: pair[1])
    return best


def _groups(over: NDArray[np.bool_]) -> list[tuple[int, int]]:
    where = np.flatnonzero(over)
    if where.size == 0:
        return []
    return [(int(g[0]), int(g[-1])) for g in np.split(where, np.flatnonzero(np.diff(where) > 1) + 1)]
