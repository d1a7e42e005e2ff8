"""A linearised fit with a random time history at one place: its marginal likelihood, and the history."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..residual_noise.whitening import Filter
from .linearised import Linearised

__all__ = ["Marginal", "RandomEffects", "at_knots"]

_Array = NDArray[np.float64]

# Added to the normal equations of the parameters, in parts of their largest: directions that the rows do not determine
# stay where they are.
_RIDGE = 1e-10
# The same for random coefficients, which have a prior already.
_ROUNDING = 1e-13
# Steps before the search is left to L-BFGS-B, and twice the log-likelihood below which its steps are no gain.
_STEPS, _EQUAL = 4, 1e-3
# Part of the samples that is left beside coefficients, at least.
_LEFT = 1e-3
# Variances are sought within these factors of where they start.
_RANGE = 1e6
_NOTHING = 1e-300


@dataclass(frozen=True, eq=False)
class Marginal:
    """A maximum of the marginal likelihood.

    log_likelihood  of the residuals, with the random coefficients integrated out, at the likeliest parameters; without
                    the constant of the normal density.
    variance        of the random coefficients.
    noise           (n_y,) variances of the measurement noise, white.
    coefficients    (k,) mean of the random coefficients given the data.
    deviations      (k,) their standard deviations given the data.
    residuals       (n_rows,) what is left beside the parameters and these.
    unknowns        the effective number of coefficients, at most k: those that the data tell.
    """

    log_likelihood: float
    variance: float
    noise: _Array
    coefficients: _Array
    deviations: _Array
    residuals: _Array
    unknowns: float


class _Evaluated(NamedTuple):
    """The likelihood at logarithms of the variances.

    value     minus twice its logarithm, maximised over b.
    gradient  of that.
    step      of MacKay's fixed-point iteration.
    solution  (e, b), the mean of the independent coefficients and the parameters.
    factor    Cholesky factor, lower, of their normal equations.
    unknowns  the effective number of coefficients.
    """

    value: float
    gradient: _Array
    step: _Array
    solution: _Array
    factor: _Array
    unknowns: float


class RandomEffects:
    """Residuals r = T b + G d + v of a fit.

    T are the tangents, with free coefficients b (parameters and first states), G answers to signals with random
    coefficients d ~ N(0, s² C), and v white noise of a variance for each output.

    The likelihood is that of a linear mixed model, maximised over b, s² and the variances of the noise (Harville 1977;
    for d the integral is exact). With d the white process noise of a state it is the likelihood of the filter-error
    method, linearised about the fit.

    ``answers``: (k, n_rows) rows of G transposed, in the units of the outputs. C is the identity unless
    `with_correlation` says otherwise. With a ``filter`` v is coloured as that has it, but for a factor of each output,
    which ``noise`` then stands for.
    """

    def __init__(self, linear: Linearised, answers: _Array, filter: Filter | None = None) -> None:
        self.linear, self.k = linear, answers.shape[0]
        self._root = np.eye(self.k + linear.tangents.shape[1])  # (d, b) = root (e, b) with independent e
        self._effects = np.hstack([answers.T, linear.tangents])
        lines = [slice(line[0].start, line[-1].stop) for line in linear.rows]
        self._counts = np.array([s.stop - s.start for s in lines], dtype=float)
        if filter is None:
            scale = linear.scale()
            columns, r = self._effects / scale[:, None], linear.residuals / scale
            self._units = np.array([float(scale[s.start]) for s in lines])
            self._constant = -float(self._counts @ np.log(self._units))
        else:
            columns, r = filter(np.ascontiguousarray(self._effects.T)).T, filter(linear.residuals)
            self._units = np.ones(len(lines))
            self._constant = float(filter.log_densities(np.zeros(linear.n_rows)).sum())
        self._grams = np.array([columns[s].T @ columns[s] for s in lines])
        self._with_r = np.array([columns[s].T @ r[s] for s in lines])
        self._squares = np.array([float(r[s] @ r[s]) for s in lines])

    def with_correlation(self, correlation: _Array | None) -> RandomEffects:
        """Return the same with correlated coefficients, C (k, k); None for independent ones."""
        if correlation is None:
            return self
        other = copy(self)
        root = self._root.copy()
        root[: self.k, : self.k] = np.linalg.cholesky(correlation + _RIDGE * np.eye(self.k))
        other._root = root
        other._grams = root.T @ self._grams @ root
        other._with_r = self._with_r @ root
        return other

    def at(self, variance: float, noise: _Array) -> Marginal:
        """Return the likelihood at given variances, maximised over b only."""
        return self._marginal(np.log(np.array([variance, *(np.asarray(noise) / self._units**2)])))

    def maximised(self, noise: _Array, variance: float | None = None) -> Marginal:
        """Return the likelihood, maximised over the variances too.

        The search starts from a variance of the noise for each output, and from one of the coefficients where that is
        nearly known.

        First by the steps of MacKay (1992, eq. 5), which go far, then by L-BFGS-B, which settles them.
        """
        from scipy.optimize import minimize  # not at import: it takes its time

        noise = np.maximum(np.asarray(noise) / self._units**2, _NOTHING)
        power = float(np.trace(self._grams[:, : self.k, : self.k], axis1=1, axis2=2) @ (1.0 / noise))
        first = variance or float(self._squares @ (1.0 / noise)) / max(power, _NOTHING)
        x = np.log(np.array([max(first, _NOTHING), *noise]))
        spread = np.log(_RANGE)
        low, high = x - spread, x + spread
        best, value = x, np.inf
        for _ in range(_STEPS):
            found = self._evaluated(x)
            if not found.value < value:
                break
            best, value = x, found.value
            x = np.clip(x + found.step, low, high)
        # n samples tell the logarithm of their variance to sqrt(2 / n): in these units the curvatures are alike.
        unit = 1.0 / np.sqrt(0.5 * np.array([max(self.k, 1), *self._counts]))

        def function(z: _Array) -> tuple[float, _Array]:
            at = self._evaluated(best + unit * z)
            return at.value, at.gradient * unit

        settled = minimize(
            function,
            np.zeros(best.size),
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip((low - best) / unit, (high - best) / unit, strict=True)),
            options={"maxiter": 60, "ftol": _EQUAL / max(abs(value), 1.0), "gtol": 0.0},
        )
        return self._marginal(best + unit * settled.x)

    def _marginal(self, x: _Array) -> Marginal:
        from scipy.linalg import cho_solve

        at = self._evaluated(x)
        noise = np.exp(x[1:]) * self._units**2
        # In units of the noise as fitted the density is another.
        log_likelihood = -0.5 * at.value + self._constant
        covariance = self._root @ cho_solve((at.factor, True), self._root.T)
        mean = self._root @ at.solution
        deviations = np.sqrt(np.maximum(np.diag(covariance)[: self.k], 0.0))
        left = self.linear.residuals - self._effects @ mean
        variance = float(np.exp(x[0]))
        return Marginal(log_likelihood, variance, noise, mean[: self.k], deviations, left, at.unknowns)

    def _evaluated(self, x: _Array) -> _Evaluated:
        """Evaluate the likelihood at logarithms of the variances."""
        from scipy.linalg.lapack import dpotrf, dpotri, dpotrs

        s2, noise, k = float(np.exp(x[0])), np.exp(x[1:]), self.k
        gram = np.tensordot(1.0 / noise, self._grams, axes=1)
        right = (1.0 / noise) @ self._with_r
        size = np.diag(gram)
        diagonal = np.full(size.size, _RIDGE * max(float(size[k:].max(initial=0.0)), _NOTHING))
        diagonal[:k] = 1.0 / s2 + _ROUNDING * float(size[:k].max(initial=0.0))
        gram[np.diag_indices_from(gram)] += diagonal
        # Coefficients come first, so that their own factor is the first part of the whole one.
        factor, failed = dpotrf(gram, lower=1)
        if failed:
            raise np.linalg.LinAlgError("the normal equations of the random coefficients are not positive definite")
        solution, _ = dpotrs(factor, right, lower=1)
        inverse, _ = dpotri(factor[:k, :k], lower=1)
        covariance = np.tril(inverse) + np.tril(inverse, -1).T
        log_det = 2.0 * float(np.log(np.diag(factor)[:k]).sum()) + k * float(x[0])
        value = float(self._counts @ x[1:]) + log_det + float(self._squares @ (1.0 / noise)) - float(right @ solution)
        d = solution[:k]
        # Squares that are left, and as many of the samples and coefficients as they tell of, by part.
        squares, taken = np.empty(x.size), np.empty(x.size)
        squares[0], taken[0] = float(d @ d) / s2, float(np.trace(covariance)) / s2
        for i, (g, c, n) in enumerate(zip(self._grams, self._with_r, noise, strict=True), 1):
            squares[i] = (self._squares[i - 1] - 2.0 * float(solution @ c) + float(solution @ (g @ solution))) / n
            taken[i] = float(np.vdot(covariance, g[:k, :k])) / n
        counts = np.array([k, *self._counts])
        gradient = counts - squares - taken
        step = np.log(np.maximum(squares, _NOTHING) / np.maximum(counts - taken, _LEFT * counts))
        return _Evaluated(value, gradient, step, solution, factor, k - float(taken[0]))


def at_knots(times: _Array, knots: Sequence[float] | _Array) -> _Array:
    """Return broken lines (k, n) that are 1 at one of k knots and 0 at the others, at n times."""
    return np.stack([np.interp(times, knots, row) for row in np.eye(len(knots))])
