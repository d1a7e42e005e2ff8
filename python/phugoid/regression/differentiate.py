"""Smoothed values and slopes of a measured channel, for the equation-error method."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.filtering import intervals
from ..errors import DataError, OptionError, whole

__all__ = ["Differentiator", "FourierSmoothing", "SavitzkyGolay", "SmoothingSpline"]

_Array: TypeAlias = NDArray[np.float64]

# Median of the square of a standard normal variable.
_MEDIAN_CHI2 = 0.4549
# Squared, the coefficients of a smooth signal's sine series fall with this power of the frequency.
_DECAY = 6


@dataclass(frozen=True)
class SmoothingSpline:
    """Cubic smoothing spline through the samples that are there, evenly spaced or not.

    ``penalty`` is the weight of the squared curvature, in units of the median sampling interval to the power 3; None
    chooses it by generalised cross-validation (Wahba, Spline Models for Observational Data, SIAM 1990, ch. 4).
    Cross-validation takes noise to be white: where it is not, the spline follows it too closely. It also takes about
    half a millisecond a sample: on long records with even sampling `FourierSmoothing` is far quicker.
    """

    penalty: float | None = None

    def __post_init__(self) -> None:
        _positive("SmoothingSpline: penalty", self.penalty)

    def smooth(self, t: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return values and slopes (per second) at the times ``t`` (N,), of a channel ``z`` (N,) with NaN where
        missing.

        Raises DataError for fewer than 5 samples.
        """
        from scipy.interpolate import make_smoothing_spline

        present = _present(z, "SmoothingSpline")
        # In sampling intervals and standard deviations, so that neither unit matters.
        step, size = float(np.median(np.diff(t))), _size(z[present])
        clock = (t - t[0]) / step
        spline = make_smoothing_spline(clock[present], z[present] / size, lam=self.penalty)
        return size * spline(clock), size / step * spline.derivative()(clock)


@dataclass(frozen=True)
class FourierSmoothing:
    """Global Fourier smoothing: sine series of the record, less the line through its ends, through a low-pass filter.

    ``cutoff`` in Hz is where the filter has fallen to one half; None puts it where the series falls to the noise level,
    as Wiener's filter does for a signal whose coefficients fall with the third power of frequency (E. A. Morelli,
    Estimating Noise Characteristics from Flight Test Data Using Optimal Fourier Smoothing, J. Aircraft 32(4), 1995).
    Needs evenly spaced times; missing samples are filled linearly first.
    """

    cutoff: float | None = None

    def __post_init__(self) -> None:
        _positive("FourierSmoothing: cutoff", self.cutoff)

    def smooth(self, t: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return values and slopes (per second) at the times ``t`` (N,), of a channel ``z`` (N,) with NaN where
        missing.

        Raises DataError for fewer than 5 samples or uneven sampling.
        """
        from scipy.fft import dct, dst

        step = _even(t, "FourierSmoothing")
        filled = _filled(t, z, "FourierSmoothing")
        n = t.size
        place = np.arange(n) / (n - 1)
        # Both ends are noisy, and an error of the line is a ramp in all samples: a short cubic fit gives the ends.
        first, last = _end(filled), _end(filled[::-1])
        line = first + (last - first) * place
        k = np.arange(1, n - 1)
        series = dst((filled - line)[1:-1], type=1) / (n - 1)
        turn = self._crossing(series) if self.cutoff is None else 2.0 * self.cutoff * step * (n - 1)
        passed = series / (1.0 + (k / turn) ** _DECAY)
        values = line.copy()
        values[1:-1] += dst(passed, type=1) / 2.0
        # The slope of a sine series is a cosine series.
        cosines = np.concatenate([[0.0], passed * k * (math.pi / (step * (n - 1))) / 2.0, [0.0]])
        return values, (last - first) / (step * (n - 1)) + dct(cosines, type=1)

    @staticmethod
    def _crossing(series: _Array) -> float:
        """Return the number of the coefficient where the signal falls to the noise level of the upper half of them."""
        power = series**2
        noise = float(np.median(power[power.size // 2 :])) / _MEDIAN_CHI2
        width = max(3, power.size // 100)
        mean = np.convolve(power, np.full(width, 1.0 / width), mode="valid")
        below = np.flatnonzero(mean <= 2.0 * noise)
        return float(below[0] + (width + 1) / 2) if below.size and noise > 0.0 else float(power.size)


@dataclass(frozen=True)
class SavitzkyGolay:
    """Local least-squares polynomial of a ``degree`` through ``window`` samples (an odd number) round each.

    (A. Savitzky and M. J. E. Golay, Analytical Chemistry 36(8), 1964.) Needs evenly spaced times; missing samples are
    filled linearly first.
    """

    window: int = 9
    degree: int = 3

    def __post_init__(self) -> None:
        for name in ("window", "degree"):
            value = getattr(self, name)
            whole(f"SavitzkyGolay: {name}", value, 1)
        if self.window % 2 == 0 or self.window <= self.degree:
            raise OptionError(
                f"SavitzkyGolay: window is an odd number above the degree {self.degree}, not {self.window}"
            )

    def smooth(self, t: _Array, z: _Array) -> tuple[_Array, _Array]:
        """Return values and slopes (per second) at the times ``t`` (N,), of a channel ``z`` (N,) with NaN where
        missing.

        Raises DataError for fewer samples than the window, or uneven sampling.
        """
        from scipy.signal import savgol_filter

        step = _even(t, "SavitzkyGolay")
        filled = _filled(t, z, "SavitzkyGolay")
        if filled.size < self.window:
            raise DataError(f"SavitzkyGolay: {filled.size} samples are fewer than the window of {self.window}")
        values = savgol_filter(filled, self.window, self.degree)
        return values, savgol_filter(filled, self.window, self.degree, deriv=1, delta=step)


Differentiator: TypeAlias = SmoothingSpline | FourierSmoothing | SavitzkyGolay


def _positive(what: str, value: float | None) -> None:
    if value is not None and not (isinstance(value, Real) and 0 < value < math.inf):
        raise OptionError(f"{what} is a positive number, or None to choose it from the data, not {value!r}")


def _present(z: _Array, who: str) -> NDArray[np.bool_]:
    present = np.isfinite(z)
    if present.sum() < 5:
        raise DataError(f"{who}: {int(present.sum())} samples are too few to differentiate; at least 5 are needed")
    return present


def _size(z: _Array) -> float:
    return float(z.std()) or 1.0


def _even(t: _Array, who: str) -> float:
    """Return the sampling interval, s; raise DataError for uneven sampling."""
    step, steps, uneven = intervals(t)
    if uneven.size:
        worst = int(np.argmax(np.abs(steps - step)))
        raise DataError(
            f"{who}: needs evenly spaced samples, but the interval after t = {t[worst]:g} s is {steps[worst]:g} s and "
            f"others are {step:g} s: use SmoothingSpline"
        )
    return float(t[-1] - t[0]) / (t.size - 1)


def _filled(t: _Array, z: _Array, who: str) -> _Array:
    present = _present(z, who)
    return np.interp(t, t[present], z[present])


def _end(z: _Array) -> float:
    """Return the first value of a cubic fitted to the first samples."""
    n = min(12, z.size)
    cubic = np.polynomial.Polynomial.fit(np.arange(n), z[:n], min(3, n - 2))
    return float(cubic(0.0))
