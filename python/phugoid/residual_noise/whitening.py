"""Coloured residuals made white, channel by channel or together: autoregressive models, and their prediction errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from .autoregression import Autoregression, burg
from .series import UniformSegment

__all__ = ["Filter", "MultivariateWhitening", "RowStructure", "Whitening"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RowStructure:
    """Which rows of residuals belong together: to one segment, or to one time.

    segments  segments[i] those of output i.
    together  rows of the same time: for each set of outputs that are measured at the same times, these outputs and
              their rows, (times, outputs).
    complete  runs of equally spaced times at which all outputs are measured: their rows, (times, n_y).
    """

    segments: Sequence[Sequence[UniformSegment]]
    together: Sequence[tuple[tuple[int, ...], NDArray[np.intp]]]
    complete: Sequence[NDArray[np.intp]] = ()

    @property
    def n(self) -> int:
        """Number of rows."""
        return sum(segment.places.size for line in self.segments for segment in line)


class Whitening:
    """Autoregressive models of all channels and the correlation of their errors, which whiten rows of residuals and
    sensitivities.

    channels     the models, one an output.
    correlation  (n_y, n_y) of their errors at the same time; None where they are independent.
    rows         what it is applied to.
    """

    def __init__(
        self, channels: Sequence[Autoregression], rows: RowStructure, correlation: _Array | None = None
    ) -> None:
        self.channels, self.rows, self.correlation = tuple(channels), rows, correlation
        models = [
            (c.predictors, c.sigmas, [(segment.rows.start, segment.places) for segment in line])
            for c, line in zip(self.channels, rows.segments, strict=True)
        ]
        mixings = []
        if correlation is not None:
            for which, at in rows.together:
                mixings.append((np.linalg.inv(np.linalg.cholesky(correlation[np.ix_(which, which)])), at))
        self._core = _core.Whitening(models, mixings)

    @classmethod
    def of(cls, residuals: _Array, rows: RowStructure) -> Whitening:
        """Fit the models of residuals (n_rows,)."""
        channels = [
            burg([residuals[segment.rows][run] for segment in line for run in segment.runs]) for line in rows.segments
        ]
        alone = cls(channels, rows)
        return cls(channels, rows, _correlation(alone(residuals), rows, len(channels)))

    @property
    def parameters(self) -> int:
        """Number of coefficients and correlations."""
        n = len(self.channels)
        return sum(c.order for c in self.channels) + (n * (n - 1) // 2 if self.correlation is not None else 0)

    def on(self, rows: RowStructure) -> Whitening:
        """Return the same models on other rows."""
        return Whitening(self.channels, rows, self.correlation)

    def __call__(self, rows: _Array) -> _Array:
        """Rows (..., n_rows) as prediction errors in units of their standard deviations."""
        return self._core.errors(np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]))).reshape(rows.shape)

    def products(self, columns: _Array, vectors: _Array, sizes: Sequence[int]) -> tuple[_Array, _Array]:
        """Return products of whitened columns (k, n_rows), without storing these: with vectors (m, n_rows), as (k, m);
        and with each other in groups of so many columns, as squares one after the other."""
        return self._core.products(columns, np.ascontiguousarray(vectors), sizes)

    def log_densities(self, errors: _Array) -> _Array:
        """Return the log-likelihood of each row given those before it, (n_rows,), from whitened errors (n_rows,),
        without the constant of the normal density."""
        return np.asarray(-0.5 * errors**2 - self._core.log_scales())


def _correlation(errors: _Array, rows: RowStructure, n: int) -> _Array | None:
    """Return the correlation of n channels' errors at the same times; None where independence is the better model."""
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


# The greatest order, and samples that there are to be for each coefficient of a channel.
_MOST, _SAMPLES_EACH = 4, 8


@dataclass(frozen=True, eq=False)
class _Order:
    """The best predictor from p samples: coefficients (n_y p, n_y), and the root of the covariance of its errors."""

    coefficients: _Array
    root: _Array


class MultivariateWhitening:
    """What makes rows of residuals and sensitivities white and independent of each other.

    orders  predictors from 0, 1, ..., p samples: the first samples of a run have none before them.
    rows    what it is applied to. Rows at times at which a channel is missing are only scaled.
    """

    def __init__(self, orders: tuple[_Order, ...], scale: _Array, rows: RowStructure) -> None:
        self.orders, self.scale, self.rows = orders, scale, rows

    @classmethod
    def fitted(cls, residuals: _Array, rows: RowStructure, order: int | None = None) -> list[MultivariateWhitening]:
        """Models of order 1, 2, ... of residuals (n_rows,), as many as the samples allow; or that of one order only."""
        n_y = len(rows.segments)
        runs = [residuals[run] for run in rows.complete]
        total = sum(run.shape[0] for run in runs)
        if n_y < 2 or total * n_y < 0.9 * rows.n:
            return []
        scale = np.sqrt(sum(np.sum(run**2, axis=0) for run in runs) / total)
        scale = np.maximum(scale, np.finfo(float).tiny)
        runs = [run / scale for run in runs]
        orders: list[_Order] = []
        for p in range((_MOST if order is None else order) + 1):
            if total < _SAMPLES_EACH * n_y * max(p, 1):
                break
            now, past = _regression(runs, p)
            coefficients = np.linalg.lstsq(past, now, rcond=1e-12)[0] if p else np.empty((0, n_y))
            e = now - past @ coefficients
            covariance = e.T @ e / e.shape[0] + 1e-12 * np.eye(n_y)
            orders.append(_Order(np.asarray(coefficients), np.asarray(np.linalg.cholesky(covariance))))
        return [cls(tuple(orders[: p + 1]), scale, rows) for p in range(1, len(orders)) if order in (None, p)]

    @property
    def parameters(self) -> int:
        """Number of coefficients and correlations."""
        n_y, p = len(self.scale), len(self.orders) - 1
        return n_y * n_y * p + n_y * (n_y - 1) // 2

    def on(self, rows: RowStructure) -> MultivariateWhitening:
        """Return the same model on other rows."""
        return MultivariateWhitening(self.orders, self.scale, rows)

    def __call__(self, rows: _Array) -> _Array:
        """Rows (..., n_rows) as independent prediction errors of unit size."""
        flat = rows.reshape(-1, rows.shape[-1])
        out = np.empty(flat.shape)
        for channel, line in enumerate(self.rows.segments):
            for segment in line:
                out[:, segment.rows] = flat[:, segment.rows] / self.scale[channel]
        whitened = out.copy()
        n_y, p = len(self.scale), len(self.orders) - 1
        inverses = [np.linalg.inv(order.root) for order in self.orders]
        for run in self.rows.complete:
            x = out[:, run.ravel()].reshape(-1, *run.shape)  # (k, times, n_y)
            e = np.empty_like(x)
            n = run.shape[0]
            for q in range(min(p, n)):  # the first samples, from the few before them
                past = x[:, q - 1 :: -1][:, :q].reshape(-1, q * n_y) if q else np.empty((x.shape[0], 0))
                e[:, q] = (x[:, q] - past @ self.orders[q].coefficients) @ inverses[q].T
            if n > p:
                a = self.orders[p].coefficients
                rest = x[:, p:].copy()
                for i in range(p):
                    rest -= x[:, p - 1 - i : n - 1 - i] @ a[i * n_y : (i + 1) * n_y]
                e[:, p:] = rest @ inverses[p].T
            whitened[:, run.ravel()] = e.reshape(x.shape[0], -1)
        return whitened.reshape(rows.shape)

    def log_densities(self, errors: _Array) -> _Array:
        """Return the log-likelihood of each row given those before it, (n_rows,), from whitened errors (n_rows,),
        without the constant of the normal density."""
        out = -0.5 * errors**2
        for channel, line in enumerate(self.rows.segments):
            for segment in line:
                out[segment.rows] -= np.log(self.scale[channel])
        logs = np.array([np.log(np.diag(order.root)) for order in self.orders])
        for run in self.rows.complete:
            out[run] -= logs[np.minimum(np.arange(run.shape[0]), len(logs) - 1)]
        return out


Filter: TypeAlias = Whitening | MultivariateWhitening


def _regression(runs: list[_Array], p: int) -> tuple[_Array, _Array]:
    """Return samples (times, n_y), and the p before each (times, n_y p), the latest first."""
    now = [run[p:] for run in runs if run.shape[0] > p]
    past = [
        np.hstack([np.empty((run.shape[0] - p, 0)), *(run[p - 1 - i : run.shape[0] - 1 - i] for i in range(p))])
        for run in runs
        if run.shape[0] > p
    ]
    return np.vstack(now), np.vstack(past)
