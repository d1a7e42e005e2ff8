"""Coloured residuals made white: an autoregressive model of each channel's residual, and its prediction errors.

The residuals of real records are never white: turbulence and what the model misses colour them. Statistics that take
them as white see an effect in any slow motion. So each channel's residual is modelled as r_t = -a_1 r_{t-1} - ... -
a_p r_{t-p} + e_t, with p by Schwarz's criterion, and everything (residuals, sensitivities) is replaced by its
prediction error e_t / sigma_e, the first samples of a run by those of the lower orders (Levinson's recursion), which
makes the transform that of the exact likelihood.

A gust moves several channels at once. Where prediction errors of different channels at the same time are correlated,
and Schwarz's criterion says that this is not chance, they are made independent of each other too: else one disturbance
would count as evidence several times over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["Channel", "Whitening", "burg", "runs_of"]

_Array = NDArray[np.float64]

# The greatest order, and samples that there are to be for each coefficient.
_MOST, _SAMPLES_EACH = 12, 10
# A reflection coefficient this near to 1 is as good as a unit root: the filter stays invertible.
_EDGE = 1.0 - 1e-6
# Series that are filtered together: they stay in the cache.
_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class Channel:
    """The autoregressive model of one channel.

    predictors  predictors[k] (k,) is the best predictor from k samples: r_t is about -sum_i predictors[k][i] r_{t-1-i}.
    sigmas      (p + 1,) standard deviations of their errors.
    """

    predictors: tuple[_Array, ...]
    sigmas: _Array

    @property
    def order(self) -> int:
        """p."""
        return len(self.predictors) - 1

    def errors(self, x: _Array) -> _Array:
        """Prediction errors of runs (..., n) along the last axis, in units of their standard deviations."""
        n, p = x.shape[-1], self.order
        out = x / self.sigmas[-1]
        for i, a in enumerate(self.predictors[p] / self.sigmas[-1], start=1):
            out[..., i:] += a * x[..., : max(n - i, 0)]
        for t in range(min(p, n)):  # from the few samples before it
            out[..., t] = (x[..., t] + x[..., :t] @ self.predictors[t][::-1]) / self.sigmas[t]
        return np.asarray(out)

    def log_scales(self, n: int) -> _Array:
        """(n,) logarithms of the standard deviations of the errors of a run."""
        return np.log(self.sigmas[np.minimum(np.arange(n), self.order)])


def burg(runs: Sequence[_Array], most: int | None = None) -> Channel:
    """The autoregressive model of residuals, runs of equally spaced samples, by Burg's method over all of them.

    The order is Schwarz's, ``most`` at most (12). Its reflection coefficients are below 1, so the model is stationary.
    """
    n = sum(run.size for run in runs)
    most = min(_MOST if most is None else most, n // _SAMPLES_EACH, max((run.size for run in runs), default=1) - 1)
    power = sum(float(run @ run) for run in runs) / max(n, 1)
    predictors = [np.empty(0)]
    powers = [power]
    forward, backward = [run.copy() for run in runs], [run.copy() for run in runs]
    for _ in range(most):
        forward, backward = [f[1:] for f in forward], [b[:-1] for b in backward]
        cross = sum(float(f @ b) for f, b in zip(forward, backward, strict=True))
        size = sum(float(f @ f + b @ b) for f, b in zip(forward, backward, strict=True))
        if size <= 0.0:
            break
        k = float(np.clip(-2.0 * cross / size, -_EDGE, _EDGE))
        last = predictors[-1]
        predictors.append(np.r_[last + k * last[::-1], k])
        powers.append(powers[-1] * (1.0 - k * k))
        pairs = list(zip(forward, backward, strict=True))
        forward, backward = [f + k * b for f, b in pairs], [b + k * f for f, b in pairs]
    floor = np.finfo(float).tiny
    criterion = [n * np.log(max(v, floor)) + p * np.log(max(n, 2)) for p, v in enumerate(powers)]
    order = int(np.argmin(criterion))
    return Channel(tuple(predictors[: order + 1]), np.sqrt(np.maximum(powers[: order + 1], floor)))


def runs_of(times: _Array) -> list[slice]:
    """Runs of samples that are equally spaced: a gap, or another spacing, begins a new one."""
    if times.size < 3:
        return [slice(0, times.size)]
    steps = np.diff(times)
    usual = float(np.median(steps))
    breaks = np.flatnonzero(np.abs(steps - usual) > 0.1 * usual) + 1
    edges = [0, *breaks.tolist(), times.size]
    return [slice(a, b) for a, b in pairwise(edges)]


@dataclass(frozen=True, eq=False)
class Rows:
    """How rows of residuals hang together.

    runs      runs[i] the runs of equally spaced rows of output i.
    together  rows of the same time: for each set of outputs that are measured at the same times, these outputs and
              their rows, (times, outputs).
    """

    runs: Sequence[Sequence[slice]]
    together: Sequence[tuple[tuple[int, ...], NDArray[np.intp]]]


class Whitening:
    """Autoregressive models of all channels, and how their errors go together: what makes rows of residuals and
    sensitivities white.

    channels     the models, one an output.
    correlation  (n_y, n_y) of their errors at the same time; None where they are independent.
    rows         what it is applied to.
    """

    def __init__(self, channels: Sequence[Channel], rows: Rows, correlation: _Array | None = None) -> None:
        self.channels, self.rows, self.correlation = tuple(channels), rows, correlation
        self._roots: list[_Array] = []
        if correlation is not None:
            blocks = (correlation[np.ix_(which, which)] for which, _ in rows.together)
            self._roots = [np.asarray(np.linalg.cholesky(block)) for block in blocks]

    @classmethod
    def of(cls, residuals: _Array, rows: Rows) -> Whitening:
        """The models of residuals (n_rows,)."""
        channels = [burg([residuals[run] for run in line]) for line in rows.runs]
        alone = cls(channels, rows)
        return cls(channels, rows, _correlation(alone(residuals), rows, len(channels)))

    def on(self, rows: Rows) -> Whitening:
        """The same models on other rows."""
        return Whitening(self.channels, rows, self.correlation)

    def __call__(self, rows: _Array) -> _Array:
        """Rows (..., n_rows) as prediction errors in units of their standard deviations."""
        out = np.empty(rows.shape)
        flat, whitened = rows.reshape(-1, rows.shape[-1]), out.reshape(-1, rows.shape[-1])
        for k in range(0, flat.shape[0], _AT_ONCE):
            block, result = flat[k : k + _AT_ONCE], whitened[k : k + _AT_ONCE]
            for channel, line in zip(self.channels, self.rows.runs, strict=True):
                for run in line:
                    result[:, run] = channel.errors(block[:, run])
            for root, (_, at) in zip(self._roots, self.rows.together, strict=False):
                inverse = np.linalg.inv(root)
                columns = [result[:, at[:, j]] for j in range(at.shape[1])]
                for i in range(at.shape[1]):
                    result[:, at[:, i]] = sum(inverse[i, j] * columns[j] for j in range(i + 1))
        return out

    def log_densities(self, errors: _Array) -> _Array:
        """(n_rows,) log-likelihood of each row, given those before it, of errors (n_rows,) that were whitened; without
        the constant of the normal density."""
        out = -0.5 * errors**2
        for channel, line in zip(self.channels, self.rows.runs, strict=True):
            for run in line:
                out[run] -= channel.log_scales(run.stop - run.start)
        for root, (_, at) in zip(self._roots, self.rows.together, strict=False):
            out[at] -= np.log(np.diag(root))
        return out


def _correlation(errors: _Array, rows: Rows, n: int) -> _Array | None:
    """Of the errors of n channels at the same times, or None where their independence is the better model."""
    products, counts = np.zeros((n, n)), np.zeros((n, n))
    for which, at in rows.together:
        e = errors[at]
        products[np.ix_(which, which)] += e.T @ e
        counts[np.ix_(which, which)] += at.shape[0]
    size = np.sqrt(np.diag(products) / np.maximum(np.diag(counts), 1.0))
    c = products / np.maximum(counts, 1.0) / np.outer(size, size)
    np.fill_diagonal(c, 1.0)
    pairs = n * (n - 1) // 2
    smallest = float(np.linalg.eigvalsh(c)[0])
    if pairs == 0 or smallest <= 0.0:  # correlations from different times need not go together
        return None
    samples = counts[~np.eye(n, dtype=bool)].min()
    gain = -samples * float(np.linalg.slogdet(c)[1])
    return c if gain > pairs * np.log(max(samples, 2.0)) else None
