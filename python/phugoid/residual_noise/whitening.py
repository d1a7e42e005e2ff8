"""Coloured residuals made white, channel by channel or together, and the colour of a fit's noise from its residuals.

Each channel is an autoregressive process, r_t = a_1 r_{t-1} + ... + a_p r_{t-p} + e_t, by Burg's recursion with
Schwarz's order; e of different channels may be correlated, also some lags apart. A fit follows its noise as far as the
model can: residuals hold less of it than the data do, least of all at low frequencies, where coloured noise has most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from . import UniformSegment
from .autoregression import Autoregression, burg

__all__ = [
    "Filter",
    "GridColumns",
    "Links",
    "MultivariateWhitening",
    "RowStructure",
    "Whitening",
    "cross_correlations",
    "restricted_autoregressions",
    "shared_covariance",
]

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
_MOST, _SAMPLES_PER_COEFFICIENT = 4, 8


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
            # Only samples with as many before them in their run say anything of that order.
            if sum(max(run.shape[0] - p, 0) for run in runs) < _SAMPLES_PER_COEFFICIENT * n_y * max(p, 1):
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


# Pairs of samples from which a correlation is estimated.
_SAMPLES_EACH = 10
# Passes, and the change of a variance that ends them. More would extrapolate: of noise so slow that they change much,
# a record has little information.
_PASSES, _SETTLED = 3, 5e-3
# Eigenvalues below this part of the greatest are rounding.
_NOTHING = 1e-12
# Lags between channels that are looked at.
_CROSS = 8


class GridColumns:
    """Columns of one output in one experiment on its grid, with their transform."""

    def __init__(self, segment: UniformSegment, columns: _Array) -> None:
        self.segment = segment
        self.columns = np.ascontiguousarray(segment.on_grid(columns[segment.rows], 0.0).T)  # (k, size)
        self.n = 1 << (2 * max(segment.size, 1) - 1).bit_length()
        self._transform = np.fft.rfft(self.columns, self.n)

    def times(self, process: Autoregression) -> _Array:
        """Return the columns times the covariance matrix of a process on the grid, (k, size)."""
        spectrum = process.spectrum(self.segment.size, self.n)
        return np.asarray(np.fft.irfft(self._transform * spectrum, self.n)[:, : self.segment.size])


def restricted_autoregressions(
    segments: Sequence[Sequence[UniformSegment]], values: _Array, columns: _Array
) -> list[Autoregression]:
    """Estimate the process of each channel by restricted maximum likelihood (Patterson & Thompson 1971).

    values   (n_rows,) residuals.
    columns  (n_rows, k) by which the fit may have moved them.

    By expectation and maximisation: given the processes, the noise is the residuals of generalised least squares, but
    for errors of that fit, whose covariance is known: a sum of squares of k sequences, which stand beside the residuals
    in the recursion that finds the processes. So the covariances are always those of a process.
    """
    rows = RowStructure(segments, [])
    found = [burg([values[s.rows][run] for s in line for run in s.runs]) for line in segments]
    for _ in range(_PASSES):
        white = Whitening(found, rows)
        seen = white(np.vstack([columns.T, values]))
        # The columns were orthonormal before they were made white: their products keep what there is to know.
        sizes, vectors = np.linalg.eigh(seen[:-1] @ seen[:-1].T)
        kept = sizes > _NOTHING * sizes[-1:]
        errors = columns @ (vectors[:, kept] / np.sqrt(sizes[kept]))
        share = (vectors[:, kept].T @ (seen[:-1] @ seen[-1])) / np.sqrt(sizes[kept])
        noise = np.vstack([values - errors @ share, errors.T])
        before = [m.powers[0] for m in found]
        found = [burg([noise[:, s.rows][:, run] for s in line for run in s.runs]) for line in segments]
        if all(abs(m.powers[0] - b) <= _SETTLED * b for m, b in zip(found, before, strict=True)):
            break
    return found


def _innovations(model: Autoregression, segment: UniformSegment, values: _Array) -> tuple[_Array, _Array]:
    """Return innovations (size,) in units of their standard deviation, 0 where a lag is missing, and where none is."""
    e = model.innovations(segment.on_grid(values[segment.rows]))
    known = np.isfinite(e)
    return np.where(known, e, 0.0) / math.sqrt(max(model.power, 1e-300)), known.astype(np.float64)


Links: TypeAlias = "dict[tuple[int, int, int], float]"


def cross_correlations(
    segments: Sequence[Sequence[UniformSegment]], processes: Sequence[Autoregression], values: _Array
) -> Links:
    """Correlations (i, j, lag) of channel i's innovations with those of channel j so many steps before.

    They count where they are more than chance gives among as many; outputs of different sampling are taken for
    independent.
    """
    alone = [[_innovations(p, s, values) for s in line] for p, line in zip(processes, segments, strict=True)]
    pairs = [(i, j) for i in range(len(segments)) for j in range(i)]
    lags = range(-_CROSS, _CROSS + 1)
    size = [
        math.sqrt(sum(float(x @ x) for x, _ in line) / max(sum(float(m.sum()) for _, m in line), 1.0)) for line in alone
    ]
    least = math.sqrt(2.0 * math.log(max(len(pairs) * len(lags), 2)))
    found = {}
    for i, j in pairs:
        if segments[i][0].step != segments[j][0].step:
            continue
        for lag in lags:
            product = count = 0.0
            for (x, mx), (y, my) in zip(alone[i], alone[j], strict=True):
                product += _shifted(x, y, lag)
                count += _shifted(mx, my, lag)
            rho = product / max(count * size[i] * size[j], 1e-300)
            if count >= _SAMPLES_EACH and abs(rho) > least / math.sqrt(count):
                found[i, j, lag] = rho
    return found


def _shifted(x: _Array, y: _Array, lag: int) -> float:
    """Sum of x[t + lag] y[t]."""
    x, y = x[max(lag, 0) :], y[max(-lag, 0) :]
    n = min(x.size, y.size)
    return float(x[:n] @ y[:n])


def shared_covariance(
    linked: Links, processes: Sequence[Autoregression], columns: Sequence[Sequence[GridColumns]]
) -> _Array:
    """Return what noise common to channels adds to the covariance (k, k) of its sums weighted by columns."""
    k = columns[0][0].columns.shape[0]
    total = np.zeros((k, k))
    for e in range(len(columns[0])):
        whole = max(line[e].segment.size for line in columns)
        size = 1 << (2 * (whole + _CROSS) - 1).bit_length()
        pulled: dict[int, NDArray[np.complex128]] = {}
        for i in {i for i, _, _ in linked} | {j for _, j, _ in linked}:
            # What each innovation does to the sums, those before the beginning too.
            h = np.fft.rfft(processes[i].response(whole) * math.sqrt(processes[i].power), size)
            pulled[i] = np.fft.rfft(columns[i][e].columns, size) * h.conj()
        both = np.full(size // 2 + 1, 2.0 / size)
        both[[0, -1]] = 1.0 / size
        turn = 2j * np.pi * np.arange(both.size) / size
        for i, j in dict.fromkeys((i, j) for i, j, _ in linked):
            weight = sum(r * np.exp(turn * lag) for (a, b, lag), r in linked.items() if (a, b) == (i, j))
            part = ((pulled[i] * (weight * both)) @ pulled[j].conj().T).real
            total += part + part.T
    return total
