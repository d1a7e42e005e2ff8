"""Coloured residuals made white, channel by channel or together: autoregressive models, and their prediction errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ... import _core
from .colour import Channel, autoregressive

__all__ = ["Filter", "JointWhitening", "Rows", "Strand", "Whitening", "strands_of"]

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


# The greatest order, and samples that there are to be for each coefficient of a channel.
_MOST, _SAMPLES_EACH = 4, 8


@dataclass(frozen=True, eq=False)
class _Order:
    """The best predictor from p samples: coefficients (n_y p, n_y), and the root of the covariance of its errors."""

    coefficients: _Array
    root: _Array


class JointWhitening:
    """What makes rows of residuals and sensitivities white and independent of each other.

    orders  predictors from 0, 1, ..., p samples: the first samples of a run have none before them.
    rows    what it is applied to. Rows at times at which a channel is missing are only scaled.
    """

    def __init__(self, orders: tuple[_Order, ...], scale: _Array, rows: Rows) -> None:
        self.orders, self.scale, self.rows = orders, scale, rows

    @classmethod
    def fitted(cls, residuals: _Array, rows: Rows) -> list[JointWhitening]:
        """Models of order 1, 2, ... of residuals (n_rows,), as many as the samples allow."""
        n_y = len(rows.strands)
        runs = [residuals[run] for run in rows.complete]
        total = sum(run.shape[0] for run in runs)
        if n_y < 2 or total * n_y < 0.9 * rows.n:
            return []
        scale = np.sqrt(sum(np.sum(run**2, axis=0) for run in runs) / total)
        scale = np.maximum(scale, np.finfo(float).tiny)
        runs = [run / scale for run in runs]
        orders: list[_Order] = []
        for p in range(_MOST + 1):
            if total < _SAMPLES_EACH * n_y * max(p, 1):
                break
            now, past = _regression(runs, p)
            coefficients = np.linalg.lstsq(past, now, rcond=1e-12)[0] if p else np.empty((0, n_y))
            e = now - past @ coefficients
            covariance = e.T @ e / e.shape[0] + 1e-12 * np.eye(n_y)
            orders.append(_Order(np.asarray(coefficients), np.asarray(np.linalg.cholesky(covariance))))
        return [cls(tuple(orders[: p + 1]), scale, rows) for p in range(1, len(orders))]

    @property
    def parameters(self) -> int:
        """Number of coefficients and correlations."""
        n_y, p = len(self.scale), len(self.orders) - 1
        return n_y * n_y * p + n_y * (n_y - 1) // 2

    def on(self, rows: Rows) -> JointWhitening:
        """The same model on other rows."""
        return JointWhitening(self.orders, self.scale, rows)

    def __call__(self, rows: _Array) -> _Array:
        """Rows (..., n_rows) as independent prediction errors of unit size."""
        flat = rows.reshape(-1, rows.shape[-1])
        out = np.empty(flat.shape)
        for channel, line in enumerate(self.rows.strands):
            for strand in line:
                out[:, strand.rows] = flat[:, strand.rows] / self.scale[channel]
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
        """(n_rows,) log-likelihood of each row, given those before it, of errors (n_rows,) that were whitened; without
        the constant of the normal density."""
        out = -0.5 * errors**2
        for channel, line in enumerate(self.rows.strands):
            for strand in line:
                out[strand.rows] -= np.log(self.scale[channel])
        p, logs = len(self.orders) - 1, [np.log(np.diag(order.root)) for order in self.orders]
        for run in self.rows.complete:
            for t in range(run.shape[0]):
                out[run[t]] -= logs[min(t, p)]
        return out


Filter: TypeAlias = Whitening | JointWhitening


def _regression(runs: list[_Array], p: int) -> tuple[_Array, _Array]:
    """Samples, and the p before each, (times, n_y) and (times, n_y p), the latest first."""
    now = [run[p:] for run in runs if run.shape[0] > p]
    past = [
        np.hstack([np.empty((run.shape[0] - p, 0)), *(run[p - 1 - i : run.shape[0] - 1 - i] for i in range(p))])
        for run in runs
        if run.shape[0] > p
    ]
    return np.vstack(now), np.vstack(past)
