"""Linearised fits with coloured noise: efficient estimates, their likelihood, and random time histories at a place."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .._core import random_effects
from ..residual_noise.whitening import Filter, MultivariateWhitening, Whitening
from ..solvers import check_time
from .linearised import Linearised

__all__ = ["Marginal", "RandomEffects", "Whitened", "at_knots", "joint_whitening", "own_whitening"]

_Array = NDArray[np.float64]

# Rounds of fitting the noise to residuals and parameters to the noise.
_ROUNDS = 3
_NOTHING = 1e-9
# Ratio of the smallest square to the largest from which on products of tangents are accurate.
_ROUGH = 1e-8


class Whitened:
    """A linearised fit seen through a whitening filter.

    One step of generalised least squares from the fit: of all that differ from it by a tangent, the residuals most
    likely under the filter. To first order that is the maximum-likelihood estimate with coloured noise, whose standard
    errors are valid where those of white noise are not.
    """

    def __init__(self, linear: Linearised, filter: Filter) -> None:
        self.linear, self.filter = linear, filter
        self._moves = linear.moves[1]
        seen = filter(np.ascontiguousarray(linear.tangents.T))
        # The tangents were orthonormal before they were whitened: their products keep what there is to know, unless
        # the filter takes nearly all of some.
        squares, vectors = np.linalg.eigh(seen @ seen.T)
        if squares.size and not squares[0] > _ROUGH * squares[-1]:
            _, values, vt = np.linalg.svd(seen.T, full_matrices=False)
            squares, vectors = values**2, vt.T
        kept = squares > _NOTHING**2 * squares.max(initial=0.0)
        self._back = vectors[:, kept] / np.sqrt(squares[kept])
        self.basis = np.asarray(seen.T @ self._back)
        e = filter(linear.residuals)
        self._part = self.basis.T @ e
        self.errors = e - self.basis @ self._part
        """(n_rows,) whitened residuals after the step."""

    @cached_property
    def plain_basis(self) -> _Array:
        """(n_rows, k) changes of the outputs, in their units, of which ``basis`` are the whitened ones."""
        outputs, _ = self.linear.moves
        return np.asarray(self.linear.scale()[:, None] * (outputs @ self._back))

    @cached_property
    def residuals(self) -> _Array:
        """(n_rows,) residuals after the step."""
        outputs, _ = self.linear.moves
        return np.asarray(self.linear.residuals - self.linear.scale() * (outputs @ (self._back @ self._part)))

    @cached_property
    def log_densities(self) -> _Array:
        """(n_measured,) log-likelihood of each sample after the step; NaN for samples that the fit leaves out."""
        at = self.linear.measured_rows
        out = np.full(self.linear.n_measured, np.nan)
        out[at] = self.filter.log_densities(self.errors)
        return out

    @cached_property
    def log_likelihood(self) -> float:
        """Of the residuals after the step, as if there were all samples."""
        total = 0.0
        densities = self.filter.log_densities(self.errors)
        for line, measured in zip(self.linear.rows, self.linear.counts, strict=True):
            rows = densities[line[0].start : line[-1].stop]
            # A late sensor leaves some samples out: they count as the others of the channel do.
            total += float(rows.sum()) * measured / max(rows.size, 1)
        return total

    @property
    def merit(self) -> float:
        """The log-likelihood less what the noise model's parameters are worth by Schwarz's criterion."""
        samples = self.linear.n_measured / len(self.linear.rows)
        return self.log_likelihood - 0.5 * self.filter.parameters * float(np.log(samples))

    @property
    def lenient_merit(self) -> float:
        """The same by Akaike's criterion, which takes a richer noise model sooner."""
        return self.log_likelihood - self.filter.parameters

    @cached_property
    def step(self) -> _Array:
        """(n_theta,) of the variables."""
        return np.asarray(self._moves @ (self._back @ self._part))

    @cached_property
    def covariance(self) -> _Array:
        """(n_theta, n_theta) of the variables after the step."""
        root = self._moves @ self._back
        return np.asarray(root @ root.T)

    def parameter(self, name: str) -> tuple[float, float]:
        """Value after the step and standard error of a parameter."""
        return self.linear.value(name, self.step, self.covariance)

    def direction(self, name: str) -> _Array:
        """Return (k,) by how much a parameter changes along each vector of ``basis``."""
        return np.asarray(self._moves[self.linear.place(name)] @ self._back)

    def inflation(self, name: str) -> float:
        """Return the ratio of the variance of a parameter's estimate to that by the filter, at least 1.

        The filter takes channels one by one, but one gust moves all of them, one after the other. The estimate is a sum
        over time; the variance of that sum follows from the covariances of its terms over some lags (Newey & West
        1987), whatever it is that makes them go together.
        """
        weights = self.basis @ self.direction(name)
        size = float(weights @ weights)
        total, lags = 0.0, 0
        for terms in self.linear.over_time(weights * self.errors):
            lags = int(np.sqrt(terms.size))
            total += float(terms @ terms)
            for lag in range(1, min(lags + 1, terms.size)):
                total += 2.0 * (1.0 - lag / (lags + 1)) * float(terms[lag:] @ terms[:-lag])
        return max(1.0, total / size) if size > 0.0 else 1.0

    def correlation(self, some: Sequence[str], others: Sequence[str]) -> float:
        """Return the greatest correlation between the estimates of two sets of parameters."""
        places = [[self.linear.place(name) for name in names] for names in (some, others)]
        size = np.sqrt(np.diag(self.covariance))
        parts = self.covariance[np.ix_(*places)] / np.maximum(np.outer(size[places[0]], size[places[1]]), 1e-300)
        return float(np.abs(parts).max())

    def beside(self, columns: _Array) -> _Array:
        """Columns (k, n_rows), whitened, without what tangents can imitate."""
        c = self.filter(columns)
        return np.asarray(c - (c @ self.basis) @ self.basis.T)


def own_whitening(linear: Linearised) -> Whitened:
    """Return the fit whitened by the likeliest filter; the search starts from that of the fit's own residuals."""
    return climbed(Whitened(linear, Whitening.of(linear.residuals, linear.structure)))


def climbed(best: Whitened) -> Whitened:
    """Through filters of what is left, one after another, as long as they are likelier."""
    for _ in range(_ROUNDS):
        following = Whitened(best.linear, Whitening.of(best.residuals, best.linear.structure))
        if following.merit <= best.merit:
            break
        best = following
    return best


def joint_whitening(own: Whitened) -> Whitened | None:
    """Return the fit whitened by a filter of all channels together; None where one filter a channel is better.

    Akaike's criterion decides, which takes the filter of all channels early: it is there to question the evidence that
    independent channels give.
    """
    best, order = own, None
    for _ in range(_ROUNDS):
        filters = MultivariateWhitening.fitted(best.residuals, own.linear.structure, order)
        tried = [(Whitened(own.linear, f), len(f.orders) - 1) for f in filters]
        following, p = max(tried, key=lambda pair: pair[0].lenient_merit, default=(best, order))
        if following.lenient_merit <= best.lenient_merit:
            break
        best, order = following, p  # the first round determines the order
    return best if best is not own else None


# Added to the diagonal of a correlation, and to the normal equations of the parameters in parts of their largest:
# directions that the rows do not determine stay where they are.
_RIDGE = 1e-10
# Ratio of the pivots of a correlation from which on its inverse is accurate.
_NEARLY_DEPENDENT = 1e-3
_TINY = 1e-300


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
    unknowns        the effective number of coefficients, at most k: those that the data determine.
    """

    log_likelihood: float
    variance: float
    noise: _Array
    coefficients: _Array
    deviations: _Array
    residuals: _Array
    unknowns: float


class RandomEffects:
    """Residuals r = T b + G d + v of a fit.

    T are the tangents, with free coefficients b (parameters and initial states), G answers to signals with random
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
        # (d, b) = root (e, b): of e the products are known, Cholesky's factor of its correlation, and its prior: the
        # inverse of the correlation, and the logarithm of its determinant.
        self._root = np.eye(self.k + linear.tangents.shape[1])
        self._spread = np.eye(self.k)
        self._prior = np.eye(self.k), 0.0
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
        spread: _Array = np.linalg.cholesky(correlation + _RIDGE * np.eye(self.k)).astype(np.float64, copy=False)
        pivots = np.diag(spread)
        if pivots.min() > _NEARLY_DEPENDENT * pivots.max():
            inverse = np.linalg.inv(spread)
            other._spread = spread
            other._prior = np.ascontiguousarray(inverse.T @ inverse), 2.0 * float(np.log(pivots).sum())
        else:  # the inverse would be rounding
            root = self._root.copy()
            root[: self.k, : self.k] = spread
            other._root = root
            other._grams = np.ascontiguousarray(root.T @ self._grams @ root)
            other._with_r = self._with_r @ root
        return other

    def at(self, variance: float, noise: _Array) -> Marginal:
        """Return the likelihood at given variances, maximised over b only."""
        return self._marginal(np.log(np.array([variance, *(np.asarray(noise) / self._units**2)])), maximised=False)

    def components(self, variance: float, noise: _Array) -> _Array:
        """Return the independent combinations of the coefficients that the residuals determine, at given variances, in
        units of their standard deviations: standard normal if the coefficients are random with that variance.

        Those along the eigenvectors of the information, with the parameters free, where that exceeds what is known of
        the coefficients beforehand.
        """
        weights, k = 1.0 / (np.asarray(noise) / self._units**2), self.k
        gram, right = np.tensordot(weights, self._grams, axes=1), weights @ self._with_r
        others = gram[k:, k:] + _RIDGE * np.trace(gram[k:, k:]) * np.eye(gram.shape[0] - k)
        beside = np.linalg.solve(others, np.column_stack([gram[k:, :k], right[k:]]))
        information = gram[:k, :k] - gram[:k, k:] @ beside[:, :-1]
        score = right[:k] - gram[:k, k:] @ beside[:, -1]
        # Of independent coefficients.
        information, score = self._spread.T @ information @ self._spread, self._spread.T @ score
        sizes, vectors = np.linalg.eigh(0.5 * (information + information.T))
        known = variance * sizes > 1.0
        along = vectors[:, known].T @ score
        return np.asarray(along / np.sqrt(sizes[known] * (1.0 + variance * sizes[known])))

    def maximised(self, noise: _Array, variance: float | None = None) -> Marginal:
        """Return the likelihood, maximised over the variances too.

        The search starts from a variance of the noise for each output, and from one of the coefficients where that is
        nearly known.
        """
        noise = np.maximum(np.asarray(noise) / self._units**2, _TINY)
        power = float(np.trace(self._grams[:, : self.k, : self.k], axis1=1, axis2=2) @ (1.0 / noise))
        first = variance or float(self._squares @ (1.0 / noise)) / max(power, _TINY)
        return self._marginal(np.log(np.array([max(first, _TINY), *noise])), maximised=True)

    def _marginal(self, x: _Array, maximised: bool) -> Marginal:
        """Return the likelihood at logarithms of the variances, or from there at its maximum, with the coefficients."""
        from scipy.linalg.lapack import dtrtrs

        check_time()
        products = self._grams, self._with_r, self._squares, self._counts
        found = random_effects(products, self.k, self._prior, x, maximised)
        if found is None:
            raise np.linalg.LinAlgError("the normal equations of the random coefficients are not positive definite")
        x, value, mean, factor, unknowns = found
        noise = np.exp(x[1:]) * self._units**2
        # In units of the noise as fitted the density is another.
        log_likelihood = -0.5 * value + self._constant
        half, _ = dtrtrs(factor.T, self._root[: self.k].T, lower=0, trans=1)
        deviations = np.sqrt(np.einsum("ij,ij->j", half, half))
        mean = self._root @ mean
        left = self.linear.residuals - self._effects @ mean
        return Marginal(log_likelihood, float(np.exp(x[0])), noise, mean[: self.k], deviations, left, unknowns)


def at_knots(times: _Array, knots: Sequence[float] | _Array) -> _Array:
    """Return broken lines (k, n) that are 1 at one of k knots and 0 at the others, at n times."""
    return np.stack([np.interp(times, knots, row) for row in np.eye(len(knots))])
