"""The colour of the noise of a fit, channel by channel and between channels, from residuals that the fit has bent.

Each channel is an autoregressive process, r_t = a_1 r_{t-1} + ... + a_p r_{t-p} + e_t; e of different channels may be
correlated, also some lags apart. A fit follows its noise as far as the model can: residuals hold less of it than the
data do, least of all at low frequencies, where coloured noise has most. What sums of lagged products lack by that
follows from the noise and the tangents, so both are found in turn until they agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .grids import Grid

__all__ = ["Laid", "Links", "Process", "common", "fitted", "innovations", "levinson", "links"]

_Array: TypeAlias = NDArray[np.float64]

# The greatest order, samples for each coefficient, and a reflection that is as good as a unit root.
_LONGEST, _SAMPLES_EACH, _EDGE = 12, 10, 1.0 - 1e-4
# Passes of correcting for what the fit took, and the change of a variance that ends them. More would extrapolate: of
# noise so slow that they change much, a record tells little.
_PASSES, _SETTLED = 3, 5e-3
# Of all samples, the part whose lags are to be there: of a record in tatters little can be said.
_TATTERS = 4
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


def levinson(covariances: _Array, count: float, most: int) -> Process:
    """The process with given covariances (m + 1,), of the order that has the least BIC (Schwarz 1978) for so many
    samples; a sequence that is none of a process is followed as far as it is."""
    total = float(covariances[0])
    a, power = np.empty(0), total
    best, best_bic, bic = a, 0.0, 0.0
    for p in range(1, most + 1):
        if not power > 0.0:
            break
        k = float(covariances[p] - a @ covariances[p - 1 : 0 : -1]) / power
        edge = not abs(k) < _EDGE
        k = float(np.clip(k, -_EDGE, _EDGE))
        a = np.r_[a - k * a[::-1], k]
        power *= 1.0 - k * k
        bic += count * math.log1p(-k * k) + math.log(count)
        if bic < best_bic:
            best, best_bic = a, bic
        if edge:
            break
    return Process(best, _implied(best, total))


def _implied(a: _Array, variance: float) -> _Array:
    """(p + 1,) covariances of the process with these coefficients and this variance."""
    p = a.size
    matrix = np.eye(p + 1)
    for row in range(1, p + 1):
        for j in range(1, p + 1):
            matrix[row, abs(row - j)] -= a[j - 1]
    matrix[0] = np.eye(p + 1)[0]
    return np.asarray(np.linalg.solve(matrix, np.r_[variance, np.zeros(p)]))


def _lagged(x: _Array, y: _Array, lags: int) -> _Array:
    """(lags + 1,) sums of x[..., t] y[..., t + m]."""
    n = x.shape[-1]
    x, y = np.atleast_2d(x), np.atleast_2d(y)
    return np.array([float(np.einsum("kt,kt->", x[:, : max(n - m, 0)], y[:, m:])) for m in range(lags + 1)])


def fitted(
    grids: Sequence[Sequence[Grid]], values: _Array, columns: Sequence[Sequence[Laid]], taken: Sequence[Sequence[Laid]]
) -> list[Process]:
    """The process of each channel.

    values   (n_rows,) residuals.
    columns  A on the grids, and ``taken`` G: residuals are noise less G A' of it.
    """
    masks = [[g.mask for g in line] for line in grids]
    laid = [[g.laid(values[g.rows]) for g in line] for line in grids]
    samples = [sum(float(m.sum()) for m in line) for line in masks]
    most = [
        max(min(_LONGEST, int(n // _SAMPLES_EACH), max(g.size for g in line) - 1), 0)
        for n, line in zip(samples, grids, strict=True)
    ]
    counts = [sum((_lagged(m, m, p) for m in line), np.zeros(p + 1)) for line, p in zip(masks, most, strict=True)]
    for i, c in enumerate(counts):  # lags that few pairs of samples have are not used
        few = np.flatnonzero(c < max(samples[i] / _TATTERS, _SAMPLES_EACH))
        most[i] = max(int(few[0]) - 1, 0) if few.size else most[i]
    seen = [sum((_lagged(x, x, p) for x in line), np.zeros(p + 1)) for line, p in zip(laid, most, strict=True)]

    def processes(lacking: Sequence[_Array]) -> list[Process]:
        return [
            levinson((s + lack) / np.maximum(c[: p + 1], 1.0), max(n, 2.0), p)
            for s, lack, c, n, p in zip(seen, lacking, counts, samples, most, strict=True)
        ]

    found = processes([np.zeros(p + 1) for p in most])
    for _ in range(_PASSES):
        times = [[a.times(p) for a in line] for p, line in zip(found, columns, strict=True)]
        inner = sum(a.columns @ t.T for la, lt in zip(columns, times, strict=True) for a, t in zip(la, lt, strict=True))
        lacking = []
        for i, line in enumerate(taken):
            lack = np.zeros(most[i] + 1)
            for g, t, m in zip(line, times[i], masks[i], strict=True):
                both = t * m
                lack += _lagged(g.columns, both, most[i]) + _lagged(both - inner @ g.columns, g.columns, most[i])
            lacking.append(lack)
        before = [p.covariances[0] for p in found]
        found = processes(lacking)
        if all(abs(p.covariances[0] - b) <= _SETTLED * b for p, b in zip(found, before, strict=True)):
            break
    return found


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
            if count >= _SAMPLES_EACH and abs(product) > least * math.sqrt(count):
                found[i, j, lag] = product / count
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
        size = 1 << (4 * max(whole, _CROSS) - 1).bit_length()
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
