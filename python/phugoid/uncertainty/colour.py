"""The colour of the noise of a fit, channel by channel and between channels, from residuals that the fit has bent.

Each channel is an autoregressive process, r_t = a_1 r_{t-1} + ... + a_p r_{t-p} + e_t, by Burg's recursion with
Schwarz's order; e of different channels may be correlated, also some lags apart. A fit follows its noise as far as the
model can: residuals hold less of it than the data do, least of all at low frequencies, where coloured noise has most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..discrepancy.colour.colour import Autoregression, Channel, burg
from ..discrepancy.colour.whitening import Rows, Strand, Whitening
from .grids import Grid

__all__ = ["Laid", "Links", "Process", "common", "fitted", "innovations", "links"]

_Array: TypeAlias = NDArray[np.float64]

# Pairs of samples that tell of a correlation.
_SAMPLES_EACH = 10
# Passes, and the change of a variance that ends them. More would extrapolate: of noise so slow that they change much,
# a record tells little.
_PASSES, _SETTLED = 3, 5e-3
# Eigenvalues below this part of the greatest are rounding.
_NOTHING = 1e-12
# Steps of a recursion that are taken at once.
_BLOCK = 64
# Lags between channels that are looked at.
_CROSS = 8


class Process:
    """An autoregressive process.

    coefficients  (p,) a_1 ... a_p.
    covariances   (p + 1,) of lags 0 to p.
    """

    def __init__(self, coefficients: _Array, covariances: _Array) -> None:
        self.coefficients, self.covariances = coefficients, covariances

    @property
    def order(self) -> int:
        """p."""
        return int(self.coefficients.size)

    @property
    def power(self) -> float:
        """Variance of e, of what cannot be predicted."""
        return max(float(self.covariances[0] - self.coefficients @ self.covariances[1:]), 0.0)

    def covariance(self, lags: int) -> _Array:
        """(lags,) autocovariance from lag 0 on, in the unit of the residuals squared."""
        return _continued(self.covariances, self.coefficients, lags)

    def response(self, lags: int) -> _Array:
        """(lags,) what becomes of e = 1: weights of e now and before in r."""
        p = self.order
        first = np.zeros(p + 1)
        first[0] = 1.0
        for i in range(1, p + 1):
            first[i] = self.coefficients[:i] @ first[i - 1 :: -1][:i]
        return _continued(first, self.coefficients, lags)

    def spectrum(self, lags: int, size: int) -> _Array:
        """Of the autocovariance up to so many lags, for `numpy.fft.rfft` of a size that is at least twice that."""
        c = self.covariance(lags)
        both = np.zeros(size)
        both[:lags] = c
        both[size - lags + 1 :] = c[:0:-1]
        return np.asarray(np.fft.rfft(both).real)


def _continued(first: _Array, a: _Array, n: int) -> _Array:
    """(n,) a sequence that goes on from its first values as x[t] = a_1 x[t-1] + ...: in blocks."""
    p = a.size
    out = np.zeros(n)
    out[: first.size] = first[:n]
    if not p or n <= first.size:
        return out
    block = np.zeros((p + min(_BLOCK, n), p))  # from the last p values to those that follow
    block[:p] = np.eye(p)
    for i in range(p, len(block)):
        block[i] = a[::-1] @ block[i - p : i]
    step = block[p:]
    at = first.size
    while at < n:
        size = min(len(step), n - at)
        out[at : at + size] = step[:size] @ out[at - p : at]
        at += size
    return out


class Laid:
    """Columns of one output in one experiment on its grid, with their transform."""

    def __init__(self, grid: Grid, columns: _Array) -> None:
        self.grid = grid
        self.columns = np.ascontiguousarray(grid.laid(columns[grid.rows]).T)  # (k, size)
        self.n = 1 << (2 * max(grid.size, 1) - 1).bit_length()
        self._transform = np.fft.rfft(self.columns, self.n)

    def times(self, process: Process) -> _Array:
        """(k, size) the columns times the covariance matrix of a process on the grid."""
        spectrum = process.spectrum(self.grid.size, self.n)
        return np.asarray(np.fft.irfft(self._transform * spectrum, self.n)[:, : self.grid.size])


def _process(model: Autoregression) -> Process:
    """With the covariances that the recursion implies, from lag to lag."""
    c = [float(model.powers[0])]
    for before, after, power in zip(model.predictors[:-1], model.predictors[1:], model.powers[:-1], strict=True):
        c.append(float(before @ np.array(c[:0:-1]) + after[-1] * power))
    return Process(model.predictors[-1], np.array(c))


def fitted(grids: Sequence[Sequence[Grid]], values: _Array, columns: _Array) -> list[Process]:
    """The process of each channel, by restricted maximum likelihood (Patterson & Thompson 1971).

    values   (n_rows,) residuals.
    columns  (n_rows, k) by which the fit may have moved them.

    By expectation and maximisation: given the processes, the noise is the residuals of generalised least squares, but
    for errors of that fit, whose covariance is known: a sum of squares of k sequences, which stand beside the residuals
    in the recursion that finds the processes. So the covariances are always those of a process.
    """
    rows = Rows([[Strand(g.rows, g.places) for g in line] for line in grids], [])
    found = [burg([values[g.rows][run] for g in line for run in g.runs]) for line in grids]
    for _ in range(_PASSES):
        white = Whitening([Channel(m.predictors, _roots(m)) for m in found], rows)
        seen = white(np.vstack([columns.T, values]))
        # The columns were orthonormal before they were made white: their products keep what there is to know.
        sizes, vectors = np.linalg.eigh(seen[:-1] @ seen[:-1].T)
        kept = sizes > _NOTHING * sizes[-1:]
        errors = columns @ (vectors[:, kept] / np.sqrt(sizes[kept]))
        share = (vectors[:, kept].T @ (seen[:-1] @ seen[-1])) / np.sqrt(sizes[kept])
        noise = np.vstack([values - errors @ share, errors.T])
        before = [m.powers[0] for m in found]
        found = [burg([noise[:, g.rows][:, run] for g in line for run in g.runs]) for line in grids]
        if all(abs(m.powers[0] - b) <= _SETTLED * b for m, b in zip(found, before, strict=True)):
            break
    return [_process(m) for m in found]


def _roots(model: Autoregression) -> _Array:
    return np.asarray(np.sqrt(np.maximum(model.powers, np.finfo(float).tiny)))


def innovations(process: Process, values: _Array, mask: _Array) -> tuple[_Array, _Array]:
    """(size,) what cannot be predicted of values on a grid from those before them, in units of its standard deviation,
    and where it is known, 1: all lags are there."""
    out, there = values.copy(), mask > 0.0
    known = there.copy()
    known[: process.order] = False
    for j, a in enumerate(process.coefficients, start=1):
        out[j:] -= a * values[:-j]
        known[j:] &= there[:-j]
    return np.where(known, out, 0.0) / math.sqrt(max(process.power, 1e-300)), known.astype(np.float64)


Links: TypeAlias = "dict[tuple[int, int, int], float]"


def links(grids: Sequence[Sequence[Grid]], processes: Sequence[Process], values: _Array) -> Links:
    """Correlations (i, j, lag) of channel i's innovations with those of channel j so many steps before.

    They count where they are more than chance gives among as many; outputs of different sampling are taken for
    independent.
    """
    alone = [
        [innovations(p, g.laid(values[g.rows]), g.mask) for g in line] for p, line in zip(processes, grids, strict=True)
    ]
    pairs = [(i, j) for i in range(len(grids)) for j in range(i)]
    lags = range(-_CROSS, _CROSS + 1)
    size = [
        math.sqrt(sum(float(x @ x) for x, _ in line) / max(sum(float(m.sum()) for _, m in line), 1.0)) for line in alone
    ]
    least = math.sqrt(2.0 * math.log(max(len(pairs) * len(lags), 2)))
    found = {}
    for i, j in pairs:
        if grids[i][0].step != grids[j][0].step:
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


def common(linked: Links, processes: Sequence[Process], columns: Sequence[Sequence[Laid]]) -> _Array:
    """(k, k) what noise that channels have in common adds to the covariance of sums of it weighted by columns."""
    k = columns[0][0].columns.shape[0]
    total = np.zeros((k, k))
    for e in range(len(columns[0])):
        whole = max(line[e].grid.size for line in columns)
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
