"""A linearised fit with a random time history at one place: its marginal likelihood, and the history."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .linearised import Linearised

__all__ = ["Marginal", "RandomEffects", "at_knots"]

_Array = NDArray[np.float64]

# Added to the normal equations of the parameters, in parts of their largest: directions that the rows do not determine
# stay where they are.
_RIDGE = 1e-10
# The same for random coefficients, which have a prior already.
_ROUNDING = 1e-13
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
    """

    log_likelihood: float
    variance: float
    noise: _Array
    coefficients: _Array
    deviations: _Array
    residuals: _Array


class RandomEffects:
    """Residuals r = T b + G d + v of a fit.

    T are the tangents, with free coefficients b (parameters and first states), G answers to signals with random
    coefficients d ~ N(0, s² C), and v white noise of a variance for each output.

    The likelihood is that of a linear mixed model, maximised over b, s² and the variances of the noise (Harville 1977;
    for d the integral is exact). With d the white process noise of a state it is the likelihood of the filter-error
    method, linearised about the fit.

    ``answers``: (k, n_rows) rows of G transposed, in the units of the outputs. C is the identity unless
    `with_correlation` says otherwise.
    """

    def __init__(self, linear: Linearised, answers: _Array) -> None:
        self.linear, self.k = linear, answers.shape[0]
        self._free = linear.tangents.shape[1]
        self._root = np.eye(self._free + self.k)  # (b, d) = root (b, e) with independent e
        scale = linear.scale()
        self._columns = columns = np.hstack([linear.tangents / scale[:, None], (answers / scale).T])
        r = linear.residuals / scale
        lines = [slice(line[0].start, line[-1].stop) for line in linear.rows]
        self._counts = np.array([s.stop - s.start for s in lines], dtype=float)
        self._grams = [columns[s].T @ columns[s] for s in lines]
        self._with_r = [columns[s].T @ r[s] for s in lines]
        self._squares = np.array([float(r[s] @ r[s]) for s in lines])
        self._units = np.array([float(scale[s.start]) for s in lines])

    def with_correlation(self, correlation: _Array | None) -> RandomEffects:
        """Return the same with correlated coefficients, C (k, k); None for independent ones."""
        if correlation is None:
            return self
        other = copy(self)
        root = np.eye(self._free + self.k)
        root[self._free :, self._free :] = np.linalg.cholesky(correlation + _RIDGE * np.eye(self.k))
        other._root = root
        other._grams = [root.T @ g @ root for g in self._grams]
        other._with_r = [root.T @ c for c in self._with_r]
        return other

    def at(self, variance: float, noise: _Array) -> Marginal:
        """The likelihood at given variances, maximised over b only."""
        x = np.log(np.array([variance, *(np.asarray(noise) / self._units**2)]))
        return self._marginal(x)

    def maximised(self, noise: _Array) -> Marginal:
        """The likelihood at the variances that are likeliest, sought from a variance of the noise for each output."""
        from scipy.optimize import minimize  # not at import: it takes its time

        noise = np.maximum(np.asarray(noise) / self._units**2, _NOTHING)
        power = sum(float(np.trace(g[self._free :, self._free :])) / n for g, n in zip(self._grams, noise, strict=True))
        first = float(self._squares @ (1.0 / noise)) / max(power, _NOTHING)
        x0 = np.log(np.array([max(first, _NOTHING), *noise]))
        spread = np.log(_RANGE)
        found = minimize(
            lambda x: self._evaluated(x)[:2],
            x0,
            jac=True,
            method="L-BFGS-B",
            bounds=[(a - spread, a + spread) for a in x0],
            options={"maxiter": 60, "ftol": 1e-9},
        )
        return self._marginal(found.x)

    def _marginal(self, x: _Array) -> Marginal:
        from scipy.linalg import cho_solve

        value, _, solution, factor = self._evaluated(x)
        noise = np.exp(x[1:]) * self._units**2
        # In units of the noise as fitted the density is another.
        log_likelihood = -0.5 * value - float(self._counts @ np.log(self._units))
        covariance = self._root @ cho_solve(factor, self._root.T)
        mean = self._root @ solution
        deviations = np.sqrt(np.maximum(np.diag(covariance)[self._free :], 0.0))
        left = self.linear.residuals - self.linear.scale() * (self._columns @ mean)
        return Marginal(log_likelihood, float(np.exp(x[0])), noise, mean[self._free :], deviations, left)

    def _evaluated(self, x: _Array) -> tuple[float, _Array, _Array, Any]:
        """Minus twice the log-likelihood at logarithms of the variances, its gradient, (b, e), and the factor of their
        normal equations."""
        from scipy.linalg import cho_factor, cho_solve

        s2, noise, p = float(np.exp(x[0])), np.exp(x[1:]), self._free
        gram = sum(g / n for g, n in zip(self._grams, noise, strict=True))
        right = sum(c / n for c, n in zip(self._with_r, noise, strict=True))
        size = np.diag(gram)
        diagonal = np.full(gram.shape[0], 1.0 / s2 + _ROUNDING * float(size[p:].max(initial=0.0)))
        diagonal[:p] = _RIDGE * max(float(size[:p].max(initial=0.0)), _NOTHING)
        whole = cho_factor(gram + np.diag(diagonal), lower=True)
        solution = cho_solve(whole, right)
        random = cho_factor(gram[p:, p:] + np.diag(diagonal[p:]), lower=True)
        log_det = 2.0 * float(np.log(np.diag(random[0])).sum()) + self.k * float(x[0])
        covariance = cho_solve(random, np.eye(self.k))
        squares = self._squares @ (1.0 / noise) - float(right @ solution)
        value = float(self._counts @ x[1:]) + log_det + squares
        d = solution[p:]
        gradient = np.empty(x.size)
        gradient[0] = self.k - (float(np.trace(covariance)) + float(d @ d)) / s2
        for i, (g, c) in enumerate(zip(self._grams, self._with_r, strict=True)):
            left = self._squares[i] - 2.0 * float(solution @ c) + float(solution @ (g @ solution))
            spread = float(np.sum(covariance * g[p:, p:]))
            gradient[1 + i] = self._counts[i] - (left + spread) / noise[i]
        return value, gradient, solution, whole


def at_knots(times: _Array, knots: Sequence[float] | _Array) -> _Array:
    """(k, n) broken lines that are 1 at one of k knots and 0 at the others, at n times."""
    return np.stack([np.interp(times, knots, row) for row in np.eye(len(knots))])
