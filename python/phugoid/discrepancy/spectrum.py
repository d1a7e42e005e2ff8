"""At which frequencies residuals have their power: Welch's spectrum, bands above white noise, and tones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import welch
from scipy.stats import chi2, f

from .series import Series

__all__ = ["Band", "Spectrum", "Tone", "spectrum_of", "tones_of"]

_Array = NDArray[np.float64]

_SEGMENT = 256  # samples of a segment of Welch's method, at most
_BACKGROUND = 41  # frequencies whose median is the background of a tone
_SLOWEST = 4  # cycles in the record: less is no tone
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
    """

    frequency: _Array
    density: _Array
    level: float
    most_below: float
    bands: tuple[Band, ...]


def spectrum_of(series: Sequence[Series], alpha: float) -> Spectrum:
    """By Welch's method (1967; segments with Hann's window, half overlapped), over all experiments of one rate.

    Segments are not freed of their mean: a bias is part of the misfit. Gaps count as residuals of zero, and the density
    is scaled to the samples that are there.
    """
    size = int(np.clip(min(s.at[-1] + 1 for s in series), 8, _SEGMENT))
    if size > 64:  # four segments at least, so that bands differ from chance
        size = max(64, min(size, (sum(int(s.at[-1]) + 1 for s in series) * 2) // 9))
    rate = 1.0 / series[0].dt
    density: _Array = np.zeros(size // 2 + 1)
    segments = 0
    frequency = np.fft.rfftfreq(size, 1.0 / rate)
    for s in series:
        grid = np.nan_to_num(s.on_grid(s.r))
        pieces = max(1, (grid.size - size // 2) // (size - size // 2))
        _, p = welch(grid, rate, nperseg=min(size, grid.size), nfft=size, detrend=False)
        # Of gaps: the mean square over the grid is less than that over the samples.
        density += p * pieces * grid.size / s.r.size
        segments += pieces
    frequency, density = frequency[1:], np.asarray(density[1:] / segments, dtype=np.float64)
    step = frequency[0]
    level = float(density.mean())
    total = density.sum()
    below = float(np.interp(0.8, np.cumsum(density) / total, frequency))
    # Two degrees of freedom of each segment, but neighbours, half overlapped, have a correlation of 1/36 (Welch 1967).
    freedom = 2.0 * segments / (1.0 + 2.0 / 36.0)
    over = density > level * chi2.isf(alpha / density.size, freedom) / freedom
    bands = []
    # From a peak that is no chance, a band reaches as far as the density is above that of white noise.
    for low, high in _groups(density > level):
        if not over[low : high + 1].any():
            continue
        share = float(density[low : high + 1].sum() / total)
        lowest = 0.0 if low == 0 else float(frequency[low] - 0.5 * step)
        bands.append(Band(lowest, float(frequency[high] + 0.5 * step), share))
    bands.sort(key=lambda band: -band.share)
    return Spectrum(frequency, density, level, below, tuple(bands[:_MOST]))


def tones_of(series: Sequence[Series], alpha: float) -> list[Tone]:
    """Lines that rise above the spectrum on either side of them, the strongest first.

    Of the periodogram of each experiment, flattened by a first-order filter, which can be no resonance; the background
    is the running median. The ratio of a line to it has an F-distribution where there is no tone.
    """
    found = []
    for s in series:
        grid = np.nan_to_num(s.on_grid(s.r))
        n = grid.size
        if n < 4 * _SLOWEST * 4:
            continue
        power = float(grid @ grid)
        slope = float(grid[:-1] @ grid[1:]) / power if power > 0.0 else 0.0
        flat = grid[1:] - slope * grid[:-1]
        window = np.hanning(flat.size)
        lines = np.abs(np.fft.rfft(flat * window)) ** 2
        frequency = np.fft.rfftfreq(flat.size, s.dt)
        width = min(_BACKGROUND, (lines.size - _SLOWEST) // 2 * 2 - 1)
        background = median_filter(lines[1:], width, mode="reflect") / np.log(2.0)
        ratio = np.concatenate([[0.0], lines[1:] / np.maximum(background, 1e-300)])
        ratio[:_SLOWEST] = 0.0
        ratio[-2:] = 0.0  # the line at Nyquist has one degree of freedom
        # A median of k exponential values is as sure as the mean of about 0.48 k; Hann's window joins neighbours.
        limit = f.isf(alpha / (ratio.size * len(series)), 2, 2 * 0.48 * width / 1.5)
        peaks = np.flatnonzero((ratio > limit) & (ratio >= np.roll(ratio, 1)) & (ratio > np.roll(ratio, -1)))
        for k in peaks[np.argsort(-ratio[peaks])][:_MOST]:
            refined, amplitude = _line(s, float(frequency[k]), float(frequency[1]))
            share = 0.5 * amplitude**2 / float(np.mean(s.r**2))
            found.append(Tone(s.experiment, refined, amplitude, min(share, 1.0)))
    return sorted(found, key=lambda tone: -tone.share)[:_MOST]


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
