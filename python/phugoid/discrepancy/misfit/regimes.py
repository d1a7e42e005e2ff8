"""In which regime residuals are off, and what they follow: against states, inputs and their rates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..colour.colour import Colour, Memory
from ..colour.series import Series

__all__ = ["Bin", "Correlation", "Regime", "correlations_of", "regimes_of"]

_Array = NDArray[np.float64]

_BINS = 8
_LEAST = 8  # samples of a bin
_SMALLEST = 0.02  # part of all samples in a bin


@dataclass(frozen=True)
class Bin:
    """The residuals where a variable lies between ``low`` and ``high``.

    n           samples.
    mean        of the residuals there.
    std_error   of the mean, for residuals as coloured as these.
    stands_out  whether the mean differs from that of the whole record by more than chance explains, of all bins of all
                variables.
    """

    low: float
    high: float
    n: int
    mean: float
    std_error: float
    stands_out: bool


@dataclass(frozen=True)
class Regime:
    """Residuals binned over one state, input or rate.

    p_value  that they depend on it by chance, for all variables tried together; the better of two tests, which counts
             as two: of the means of the bins, and of a regression of the whitened residuals on the bins.
    share    part of their power in the means of the bins.
    """

    variable: str
    bins: tuple[Bin, ...]
    p_value: float
    share: float


@dataclass(frozen=True)
class Correlation:
    """Of the residuals with a state, an input or a rate (``q'``).

    r            Pearson's coefficient, plain.
    n_effective  samples that the record is worth for it: n / sum rho_residual rho_variable over all lags.
    p_value      that it is chance, for all variables tried together; by regression of whitened residuals on the
                 variable passed through the same filter.
    """

    variable: str
    r: float
    n_effective: float
    p_value: float


def regimes_of(series: Sequence[Series], colour: Colour, memory: Memory, rms: float, alpha: float) -> list[Regime]:
    """One for each variable, the least likely chance first; ``memory`` is that of the residuals, ``rms`` their size."""
    from scipy.special import stdtr

    names = [name for name in _shared(series) if name != "time"]  # when, say spans
    r = np.concatenate([s.r for s in series])
    freedom = max(memory.effective(r.size) - 1.0, 1.0)
    found = []
    for name in names:
        edges = _edges(np.concatenate([s.regressors[name] for s in series]))
        count = edges.size - 1
        if count < 2:
            continue
        # The last bin holds its upper edge too.
        which = [np.searchsorted(edges[1:-1], s.regressors[name], side="right") for s in series]
        several = 2.0 * len(names)  # two tests of each variable
        p_value = _chance(series, colour, [np.eye(count)[w] for w in which]) * several
        bins, power = [], 0.0
        for b in range(count):
            inside = [w == b for w in which]
            within = r[np.concatenate(inside)]
            m, mean = within.size, float(within.mean())
            error = rms * memory.spread([np.nan_to_num(s.on_grid(i / m)) for s, i in zip(series, inside, strict=True)])
            # A bias of the whole record is no matter of regimes.
            beside = [s.on_grid(i / m - 1.0 / r.size) for s, i in zip(series, inside, strict=True)]
            of_difference = rms * memory.spread([np.nan_to_num(w) for w in beside])
            off = abs(mean - float(r.mean())) / of_difference if of_difference > 0.0 else 0.0
            chance = 2.0 * float(stdtr(freedom, -off)) * count * several
            # Regression sees what jumps between regimes, means what lasts in one.
            p_value = min(p_value, chance)
            bins.append(Bin(float(edges[b]), float(edges[b + 1]), m, mean, error, chance < alpha))
            power += m * (mean - float(r.mean())) ** 2
        found.append(Regime(name, tuple(bins), min(p_value, 1.0), power / (r.size * rms**2)))
    return sorted(found, key=lambda regime: (regime.p_value, -regime.share))


def correlations_of(series: Sequence[Series], colour: Colour, memory: Memory) -> list[Correlation]:
    """One for each variable, the least likely chance first."""
    names = _shared(series)
    r = np.concatenate([s.r for s in series])
    n = r.size
    found = []
    for name in names:
        x = np.concatenate([s.regressors[name] for s in series])
        mean, size = x.mean(), float(np.std(x))
        if size == 0.0 or np.std(r) == 0.0:
            continue
        both = float(np.mean((x - mean) * (r - r.mean()))) / (size * float(np.std(r)))
        total = memory.spread([np.nan_to_num(s.on_grid((s.regressors[name] - mean) / size)) for s in series]) ** 2
        effective = float(np.clip(n * n / total, 1.0, n)) if total > 0.0 else float(n)
        p_value = _chance(series, colour, [s.regressors[name][:, None] for s in series])
        found.append(Correlation(name, both, effective, min(1.0, p_value * len(names))))
    return sorted(found, key=lambda c: (c.p_value, -abs(c.r)))


def _chance(series: Sequence[Series], colour: Colour, columns: Sequence[_Array]) -> float:
    """P-value of the regression of the residuals on columns, (n, m) each, beyond a constant.

    Both sides pass through the filter that whitens the residuals (generalised least squares, Cochrane and Orcutt 1949),
    so that the F-test holds for coloured ones.
    """
    from scipy.special import fdtrc

    rows = []
    for s, c in zip(series, columns, strict=True):
        # In units of the columns, for rates and angles differ by orders of magnitude.
        together = np.column_stack([np.ones(s.r.size), c, s.r])
        white = colour.whitened(s.on_grid(together))
        rows.append(white[np.isfinite(white).all(axis=1)])
    stacked = np.vstack(rows)
    size = np.linalg.norm(stacked, axis=0)
    stacked = stacked / np.where(size > 0.0, size, 1.0)
    y, one, full = stacked[:, -1], stacked[:, :1], stacked[:, :-1]
    base = _left(one, y)
    left = _left(full, y)
    rank = int(np.linalg.matrix_rank(full, tol=1e-8))
    more, freedom = rank - 1, y.size - rank
    if more < 1 or freedom < 3 or left <= 0.0:
        return 1.0
    return float(fdtrc(more, freedom, max(base - left, 0.0) / more / (left / freedom)))


def _left(columns: _Array, y: _Array) -> float:
    solution = np.linalg.lstsq(columns, y, rcond=1e-8)[0]
    rest = y - columns @ solution
    return float(rest @ rest)


def _shared(series: Sequence[Series]) -> list[str]:
    """Variables that move in some experiment, and are there in all."""
    return [name for name in series[0].regressors if all(name in s.regressors for s in series)]


def _edges(values: _Array) -> _Array:
    """Edges of bins of equal width, but for the ends, with small ones joined to their neighbour.

    Equal widths show excursions, which bins of equal count would hide; a few extreme samples belong to the end bins.
    """
    least = max(_LEAST, math.ceil(_SMALLEST * values.size))
    low, high = np.quantile(values, [0.01, 0.99])
    if not high > low:  # an input that rests nearly always
        low, high = float(values.min()), float(values.max())
    edges = np.linspace(low, high, min(_BINS, max(values.size // 15, 2)) + 1)
    edges[0], edges[-1] = values.min(), values.max()
    kept = [float(edges[0])]
    for edge in edges[1:-1]:
        inside = int(((values >= kept[-1]) & (values < edge)).sum())
        if inside >= least and int((values >= edge).sum()) >= least:
            kept.append(float(edge))
    return np.array([*kept, float(edges[-1])])
