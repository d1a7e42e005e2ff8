"""Smoothed values and slopes of measured channels, and weighted least squares over time histories: solution, collinear
regressors, covariance under coloured residuals.

Arrays are one an experiment: residuals (E, N) of E equations at N samples, regressors (E, N, p) of p parameters, masks
(E, N) of the rows that count. Residuals and regressors are zero where the mask is False.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.filtering import intervals
from ..errors import DataError, OptionError, whole

__all__ = [
    "Collinear",
    "Differentiator",
    "FourierSmoothing",
    "Regression",
    "SavitzkyGolay",
    "SmoothingSpline",
    "coloured_middle",
    "regress",
]

_Array: TypeAlias = NDArray[np.float64]
_Rows: TypeAlias = tuple[_Array, _Array]  # residuals, regressors

# Passes until the weights settle, and when they have.
_PASSES, _SETTLED = 50, 1e-6
# Least standard deviation of a residual, relative to the left-hand side: an exact equation would have all weight.
_EXACT = 1e-6
# Relative singular value of the scaled regressors below which a direction is undetermined.
_SINGULAR = 1e-10
# Condition index and share of variance from which regressors are called collinear (Belsley, Kuh and Welsch,
# Regression Diagnostics, Wiley 1980, sec. 3.2).
_INDEX, _SHARE = 30.0, 0.5
# Largest lag of autocorrelations as a part of the record.
_LAGS = 1 / 3
# A parameter takes part in a direction where its component is not below this.
_PART = 0.1


@dataclass(frozen=True)
class Collinear:
    """Collinear parameters (their numbers); the index is infinite where the data do not distinguish them at all."""

    parameters: tuple[int, ...]
    condition_index: float


@dataclass(frozen=True)
class Regression:
    """The solution: values (p,), covariances (p, p) for coloured and for white residuals, NaN where undetermined."""

    values: _Array
    covariance: _Array
    white_covariance: _Array
    sigmas: _Array
    collinear: tuple[Collinear, ...]
    active: NDArray[np.int_]  # -1 at the lower bound, 1 at the upper, 0 within
    settled: bool


def regress(
    rows: Callable[[_Array], list[_Rows]],
    masks: Sequence[NDArray[np.bool_]],
    scales: _Array,
    start: _Array,
    bounds: tuple[_Array, _Array],
    priors: Sequence[tuple[float, float] | None],
    linear: bool,
) -> Regression:
    """Return the maximum-likelihood solution with an unknown standard deviation of the residuals of each equation.

    ``rows`` gives residuals and their negative derivatives at parameters; ``scales`` (E,) are the sizes of what the
    equations explain. Undetermined directions stay at ``start``.
    """
    counts = np.maximum(sum(mask.sum(axis=1) for mask in masks), 1)
    problem = _WeightedLeastSquares(rows, priors, bounds, linear)
    theta, sigmas, settled = start, scales, False
    for _ in range(_PASSES):
        theta, success = problem.solve(theta, 1.0 / sigmas)
        squares = sum((r**2).sum(axis=1) for r, _ in rows(theta))
        before, sigmas = sigmas, np.maximum(np.sqrt(squares / counts), _EXACT * scales)
        if success and np.all(np.abs(sigmas / before - 1.0) < _SETTLED):
            settled = True
            break
    return problem.judge(theta, sigmas, masks, settled)


class _WeightedLeastSquares:
    def __init__(
        self,
        rows: Callable[[_Array], list[_Rows]],
        priors: Sequence[tuple[float, float] | None],
        bounds: tuple[_Array, _Array],
        linear: bool,
    ) -> None:
        self.rows, self.bounds, self.linear = rows, bounds, linear
        self.known = np.array([i for i, p in enumerate(priors) if p], dtype=np.intp)
        self.mean = np.array([p[0] for p in priors if p])
        self.root = np.array([1.0 / p[1] for p in priors if p])

    def stacked(self, theta: _Array, roots: _Array) -> tuple[_Array, _Array]:
        """Return residuals and regressors of all rows in their units, those of the priors last."""
        parts = self.rows(theta)
        prior = np.zeros((self.known.size, theta.size))
        prior[np.arange(self.known.size), self.known] = self.root
        r = [(roots[:, None] * r).ravel() for r, _ in parts]
        a = [(roots[:, None, None] * a).reshape(-1, theta.size) for _, a in parts]
        return (
            np.concatenate([*r, self.root * (self.mean - theta[self.known])]),
            np.concatenate([*a, prior]),
        )

    def solve(self, theta: _Array, roots: _Array) -> tuple[_Array, bool]:
        """Return the least-squares point for given weights, and whether the solver converged."""
        from scipy.optimize import least_squares, lsq_linear

        lower, upper = self.bounds
        if not self.linear:
            inside = np.clip(theta, lower, upper)
            found = least_squares(
                lambda p: self.stacked(p, roots)[0],
                inside,
                lambda p: -self.stacked(p, roots)[1],
                (lower, upper),
                x_scale="jac",
                ftol=1e-14,
                xtol=1e-12,
                gtol=1e-14,
                max_nfev=200,
            )
            return found.x, bool(found.status > 0)
        r, a = self.stacked(theta, roots)
        size = _sizes(a)
        step = np.linalg.lstsq(a / size, r, rcond=_SINGULAR)[0] / size
        if np.all((theta + step >= lower) & (theta + step <= upper)):
            return theta + step, True
        shifted = ((lower - theta) * size, (upper - theta) * size)
        bounded = lsq_linear(a / size, r, shifted, method="bvls")
        return np.clip(theta + bounded.x / size, lower, upper), bool(bounded.status > 0)

    def judge(self, theta: _Array, sigmas: _Array, masks: Sequence[NDArray[np.bool_]], settled: bool) -> Regression:
        """Return the regression with covariances and collinearity at the solution."""
        roots = 1.0 / sigmas
        r, a = self.stacked(theta, roots)
        pull = a.T @ r  # at a bound the residuals still pull outwards
        near = 1e-9 * np.maximum(np.abs(theta), 1e-300)
        active = np.where((theta - self.bounds[0] <= near) & (pull <= 0), -1, 0)
        active = np.where((self.bounds[1] - theta <= near) & (pull >= 0), 1, active)
        free = np.flatnonzero(active == 0)
        size = _sizes(a[:, free])
        _, values, directions = np.linalg.svd(a[:, free] / size, full_matrices=False)
        top = values[0] if values.size else 1.0
        sound = values > _SINGULAR * top
        lost = np.any(np.abs(directions[~sound]) > _PART, axis=0)
        inverse = (directions[sound].T / values[sound] ** 2) @ directions[sound] / np.outer(size, size)

        middle = np.zeros((free.size, free.size))
        for (r_i, a_i), mask in zip(self.rows(theta), masks, strict=True):
            middle += coloured_middle(roots[:, None] * r_i, roots[:, None, None] * a_i[:, :, free], mask)
        place = {int(k): j for j, k in enumerate(free)}
        for k, root in zip(self.known, self.root, strict=True):
            if int(k) in place:
                middle[place[int(k)], place[int(k)]] += root**2
        n = sum(int(mask.sum()) for mask in masks)
        lost_freedom = n / max(n - int(sound.sum()), 1)

        def spread(matrix: _Array) -> _Array:
            full = np.full((theta.size, theta.size), np.nan)
            matrix = np.where(lost[:, None] | lost[None, :], np.nan, matrix)
            full[np.ix_(free, free)] = lost_freedom * matrix
            return full

        return Regression(
            values=theta,
            covariance=spread(inverse @ middle @ inverse),
            white_covariance=spread(inverse),
            sigmas=sigmas,
            collinear=_collinear(values, directions, free, top),
            active=active,
            settled=settled,
        )


def _sizes(a: _Array) -> _Array:
    size = np.sqrt((a**2).sum(axis=0))
    return np.where(size > 0.0, size, 1.0)


def _collinear(values: _Array, directions: _Array, free: NDArray[np.intp], top: float) -> tuple[Collinear, ...]:
    """Return Belsley's condition indices with the parameters that share most of their variance in one direction."""
    found = []
    sound = values > _SINGULAR * top
    for direction in directions[~sound]:
        names = tuple(int(k) for k in free[np.abs(direction) > _PART])
        found.append(Collinear(names, np.inf))
    parts = (directions[sound] / values[sound, None]) ** 2
    shares = parts / np.maximum(parts.sum(axis=0), 1e-300)
    for value, share in zip(values[sound], shares, strict=True):
        names = tuple(int(k) for k in free[share > _SHARE])
        if top / value > _INDEX and len(names) > 1:
            found.append(Collinear(names, float(top / value)))
    return tuple(found)


def coloured_middle(r: _Array, a: _Array, mask: NDArray[np.bool_]) -> _Array:
    """Return the covariance of a'r, (p, p), for r a stationary sequence with the autocorrelation of the residuals.

    Sum over i, j of a_i R(i - j) a_j' (V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006, ch. 5),
    for E equations with their cross-correlations; lags are counted in samples and fade out by a Parzen window, since
    the fit has taken out of the residuals what lay at the very frequencies of the regressors. Pairs with a missing
    sample do not count, and the spectrum of R is kept positive.
    """
    n = r.shape[1]
    length = 2 * n
    v, m = np.fft.rfft(r, length), np.fft.rfft(mask.astype(float), length)
    sums = np.fft.irfft(v[:, None] * v[None].conj(), length)
    pairs = np.round(np.fft.irfft(m[:, None] * m[None].conj(), length))
    lag = np.minimum(np.arange(length), length - np.arange(length))
    taper = np.maximum(1.0 - lag / n, 0.0) * _parzen(lag / (_LAGS * n))
    spectrum = np.fft.rfft(np.where(pairs > 0.5, sums / np.maximum(pairs, 1.0), 0.0) * taper, length)
    matrices = np.moveaxis(spectrum, -1, 0)
    if not mask.all():
        power, axes = np.linalg.eigh((matrices + matrices.conj().swapaxes(1, 2)) / 2.0)
        matrices = (axes * np.maximum(power, 0.0)[:, None, :]) @ axes.conj().swapaxes(1, 2)
    x = np.fft.rfft(a, length, axis=1)
    twice = np.full(n + 1, 2.0)
    twice[[0, -1]] = 1.0  # all other frequencies also represent their mirror images
    weighted = np.einsum("fgh,hfp->gfp", matrices, x, optimize=True) * twice[:, None]
    return np.asarray(np.einsum("efp,efq->pq", x.conj(), weighted, optimize=True).real / length)


def _parzen(x: _Array) -> _Array:
    """Return Parzen's lag window, zero from 1 on; its transform is nowhere negative."""
    near, far = 1.0 - 6.0 * x**2 * (1.0 - x), 2.0 * np.maximum(1.0 - x, 0.0) ** 3
    return np.where(x < 0.5, near, far)


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
            f"{who}: needs evenly spaced samples, but the interval after t = {t[worst]:g} is {steps[worst]:g} and "
            f"others are {step:g}: use SmoothingSpline"
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
