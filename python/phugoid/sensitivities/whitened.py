"""A fit's residuals against its tangents, whitened: what efficient estimates would be, and their likelihood."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..residual_noise.whitening import Filter, MultivariateWhitening, Whitening
from .linearised import Linearised

__all__ = ["Whitened", "joint_whitening", "own_whitening"]


_Array = NDArray[np.float64]

# Rounds of fitting the noise to residuals and parameters to the noise.
_ROUNDS = 3
_NOTHING = 1e-9


class Whitened:
    """A linearised fit seen through a whitening filter.

    One step of generalised least squares from the fit: of all that differ from it by a tangent, the residuals most
    likely under the filter. To first order that is the maximum-likelihood estimate with coloured noise, whose standard
    errors are honest where those of white noise are not.
    """

    def __init__(self, linear: Linearised, filter: Filter) -> None:
        self.linear, self.filter = linear, filter
        scale = linear.scale()[:, None]
        outputs, self._moves = linear.moves
        u, values, vt = np.linalg.svd(filter((outputs * scale).T).T, full_matrices=False)
        kept = values > _NOTHING * values[:1]
        self.basis, self._back = u[:, kept], vt[kept].T / values[kept]
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

    def inflation(self, name: str) -> float:
        """Return the ratio of the variance of a parameter's estimate to that by the filter, at least 1.

        The filter takes channels one by one, but one gust moves all of them, one after the other. The estimate is a sum
        over time; the variance of that sum follows from the covariances of its terms over some lags (Newey & West
        1987), whatever it is that makes them go together.
        """
        weights = self.basis @ (self._moves[self.linear.place(name)] @ self._back)
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
        best, order = following, p  # the first round tells the order
    return best if best is not own else None
