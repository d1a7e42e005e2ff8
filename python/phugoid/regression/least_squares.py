"""Weighted least squares over time histories: solution, collinear regressors, covariance under coloured residuals.

Arrays are one an experiment: residuals (E, N) of E equations at N samples, regressors (E, N, p) of p parameters, masks
(E, N) of the rows that count. Residuals and regressors are zero where the mask is False.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Collinear", "Regression", "coloured_middle", "regress"]

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
