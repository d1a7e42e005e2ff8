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

from .autoregression import Autoregression, burg
from .series import UniformSegment
from .whitening import RowStructure, Whitening

__all__ = ["GridColumns", "Links", "cross_correlations", "restricted_autoregressions", "shared_covariance"]

_Array: TypeAlias = NDArray[np.float64]

# Pairs of samples that tell of a correlation.
_SAMPLES_EACH = 10
# Passes, and the change of a variance that ends them. More would extrapolate: of noise so slow that they change much,
# a record tells little.
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
