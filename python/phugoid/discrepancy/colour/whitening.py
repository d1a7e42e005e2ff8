"""Coloured residuals made white: an autoregressive model of each channel's residual, and its prediction errors.

The residuals of real records are never white: turbulence and what the model misses colour them. Statistics that take
them as white see an effect in any slow motion. So each channel's residual is modelled as r_t = a_1 r_{t-1} + ... +
a_p r_{t-p} + e_t, with p by Schwarz's criterion, and everything (residuals, sensitivities) is replaced by its
prediction error e_t / sigma_e, at the beginning and past a gap by that of the best prediction from what samples there
are, which makes the transform that of the exact likelihood.

A gust moves several channels at once. Where prediction errors of different channels at the same time are correlated,
and Schwarz's criterion says that this is not chance, they are made independent of each other too: else one disturbance
would count as evidence several times over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ... import _core
from .colour import Channel, autoregressive

__all__ = ["Rows", "Strand", "Whitening", "strands_of"]

_Array = NDArray[np.float64]

# Part of the spacing by which a sample may be off its place.
_OFF = 0.1


@dataclass(frozen=True, eq=False)
class Strand:
    """Samples of a channel, equally spaced but for those that are missing.

    rows    where they are among the rows.
    places  (n,) their numbers on the grid, increasing from 0: more than 1 between two is a gap.
    """

    rows: slice
    places: NDArray[np.intp]

    @property
    def runs(self) -> list[slice]:
        """Runs without a gap, of its own samples."""
        breaks = np.flatnonzero(np.diff(self.places) > 1) + 1
        return [slice(a, b) for a, b in pairwise([0, *breaks.tolist(), self.places.size])]

    def from_row(self, first: int) -> Strand:
        """The same where rows are counted from another."""
        return Strand(slice(self.rows.start + first, self.rows.stop + first), self.places)


def strands_of(times: _Array) -> Sequence[Strand]:
    """The strands of increasing times (n,): where a step is no multiple of the usual one, another begins.

    The usual step is the median; where more samples are missing than that tells, a lesser one that leaves fewer
    strands.
    """
    if times.size < 2:
        return [Strand(slice(0, 1), np.zeros(1, dtype=np.intp))] if times.size else []
    steps = np.diff(times)
    # Steps that there are: of two that alternate the median is the mean.
    typical = np.quantile(steps, [0.5, 0.1], method="lower")
    return min((_strands(steps, float(step)) for step in typical), key=len)


def _strands(steps: _Array, usual: float) -> list[Strand]:
    usual = float(np.median(steps[np.abs(steps - usual) <= 2.0 * _OFF * usual]))  # where times are rounded
    numbers = np.maximum(np.rint(steps / usual), 1.0)
    # After a long gap a part of a step does not matter.
    breaks = np.flatnonzero(np.abs(steps / numbers - usual) > _OFF * usual) + 1
    places = np.r_[0, np.cumsum(numbers)].astype(np.intp)
    edges = [0, *breaks.tolist(), places.size]
    return [Strand(slice(a, b), places[a:b] - places[a]) for a, b in pairwise(edges)]


@dataclass(frozen=True, eq=False)
class Rows:
    """How rows of residuals hang together.

    strands   strands[i] those of output i.
    together  rows of the same time: for each set of outputs that are measured at the same times, these outputs and
              their rows, (times, outputs).
    complete  runs of equally spaced times at which all outputs are measured: their rows, (times, n_y).
    """

    strands: Sequence[Sequence[Strand]]
    together: Sequence[tuple[tuple[int, ...], NDArray[np.intp]]]
    complete: Sequence[NDArray[np.intp]] = ()

    @property
    def n(self) -> int:
        """Number of rows."""
        return sum(strand.places.size for line in self.strands for strand in line)


class Whitening:
    """Autoregressive models of all channels, and how their errors go together: what makes rows of residuals and
    sensitivities white.

    channels     the models, one an output.
    correlation  (n_y, n_y) of their errors at the same time; None where they are independent.
    rows         what it is applied to.
    """

    def __init__(self, channels: Sequence[Channel], rows: Rows, correlation: _Array | None = None) -> None:
        self.channels, self.rows, self.correlation = tuple(channels), rows, correlation
        models = [
            (c.predictors, c.sigmas, [(strand.rows.start, strand.places) for strand in line])
            for c, line in zip(self.channels, rows.strands, strict=True)
        ]
        mixings = []
        if correlation is not None:
            for which, at in rows.together:
                mixings.append((np.linalg.inv(np.linalg.cholesky(correlation[np.ix_(which, which)])), at))
        self._core = _core.Whitening(models, mixings)

    @classmethod
    def of(cls, residuals: _Array, rows: Rows) -> Whitening:
        """The models of residuals (n_rows,)."""
        channels = [
            autoregressive([residuals[strand.rows][run] for strand in line for run in strand.runs])
            for line in rows.strands
        ]
        alone = cls(channels, rows)
        return cls(channels, rows, _correlation(alone(residuals), rows, len(channels)))

    @property
    def parameters(self) -> int:
        """Number of coefficients and correlations."""
        n = len(self.channels)
        return sum(c.order for c in self.channels) + (n * (n - 1) // 2 if self.correlation is not None else 0)

    def on(self, rows: Rows) -> Whitening:
        """The same models on other rows."""
        return Whitening(self.channels, rows, self.correlation)

    def __call__(self, rows: _Array) -> _Array:
        """Rows (..., n_rows) as prediction errors in units of their standard deviations."""
        return self._core.errors(np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]))).reshape(rows.shape)

    def products(self, columns: _Array, vectors: _Array, sizes: Sequence[int]) -> tuple[_Array, _Array]:
        """What there is to know of columns (k, n_rows) once they are white, without storing them so: products with
        vectors (m, n_rows), (k, m); and with each other in groups of so many columns, their squares one after the
        other."""
        return self._core.products(columns, np.ascontiguousarray(vectors), sizes)

    def log_densities(self, errors: _Array) -> _Array:
        """(n_rows,) log-likelihood of each row, given those before it, of errors (n_rows,) that were whitened; without
        the constant of the normal density."""
        return np.asarray(-0.5 * errors**2 - self._core.log_scales())


def _correlation(errors: _Array, rows: Rows, n: int) -> _Array | None:
    """Of the errors of n channels at the same times, or None where their independence is the better model."""
    products, counts = np.zeros((n, n)), np.zeros((n, n))
    for which, at in rows.together:
        e = errors[at]
        products[np.ix_(which, which)] += e.T @ e
        counts[np.ix_(which, which)] += at.shape[0]
    size = np.sqrt(np.diag(products) / np.maximum(np.diag(counts), 1.0))
    c = products / np.maximum(counts, 1.0) / np.maximum(np.outer(size, size), np.finfo(float).tiny)
    np.fill_diagonal(c, 1.0)
    smallest = float(np.linalg.eigvalsh(c)[0])
    if smallest <= 0.0:  # correlations from different times need not go together
        return None
    gain = -sum(at.shape[0] * float(np.linalg.slogdet(c[np.ix_(which, which)])[1]) for which, at in rows.together)
    seen = counts[np.triu_indices(n, 1)]
    return c if gain > np.log(np.maximum(seen[seen > 0], 2.0)).sum() else None
