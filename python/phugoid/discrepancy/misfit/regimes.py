"""When and in which regime residuals are off, and what they follow: spans of a record, states, inputs and rates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...residual_noise import Series
from ...residual_noise.autoregression import Autoregression, CorrelatedNoise

__all__ = ["Bin", "Dependence", "Regime", "Running", "Span", "correlations_of", "regimes_of", "spans_of"]

_Array = NDArray[np.float64]

_SHORTEST = 10  # samples of a window
_WINDOWS = 40  # that a record is divided into
_CLIP = 2.5  # robust standard deviations
_NEIGHBOURS = 5  # samples whose median an outlier does not move
_MOST = 5  # spans that are reported


@dataclass(frozen=True)
class Span:
    """From ``start`` to ``end`` (s) of an experiment the residual has ``rms``, ``times`` the usual, with ``share`` of
    the power of all residuals of the channel."""

    experiment: str
    start: float
    end: float
    rms: float
    times: float
    share: float


@dataclass(frozen=True, eq=False, repr=False)
class Running:
    """The running RMS of the residuals: (n,) ``rms`` at times ``t``, in windows of ``width`` s."""

    t: _Array
    rms: _Array
    width: float


def spans_of(series: Sequence[Series], alpha: float) -> tuple[dict[str, Running], float, list[Span]]:
    """Return the running RMS by experiment, its usual level, and the spans that stand out, the strongest first.

    A window stands out where its mean square exceeds the median of all windows by more than the F-distribution allows,
    at ``alpha`` for all windows together. Coloured residuals swing as one: a window of w samples counts as
    w / (1 + 2 sum rho_k^2), since rho_k^2 is what squares of Gaussian values have for autocorrelation. For the test,
    what stands out from its neighbours is clipped: a few outliers are no span.
    """
    from scipy.special import chdtri, fdtri

    n = sum(s.r.size for s in series)
    width = max(_SHORTEST, n // _WINDOWS)
    running: dict[str, Running] = {}
    for s in series:
        short = min(width, s.r.size)
        running[s.experiment] = Running(s.t, np.sqrt(_moving_mean(s.r**2, short)), float(short * s.segment.step))
    clipped = _clipped(series)
    squares = {name: _moving_mean(x**2, min(width, x.size)) for name, x in clipped.items()}
    freedom = width / _clumping(clipped, width)
    typical = float(np.median(np.concatenate(list(squares.values()))))
    # Median and mean of a chi-squared variable differ.
    level = typical / (float(chdtri(freedom, 0.5)) / freedom)
    windows = max(n / width, 1.0)
    if windows < 4.0 or typical == 0.0:
        return running, float(np.sqrt(level)), []
    # Windows overlap: twice as many as fit side by side. The level itself is known from the others, by a median.
    limit = level * fdtri(freedom, max(0.6 * freedom * (windows - 1.0), 2.0), 1.0 - alpha / (2.0 * windows))
    total = sum(float(s.r @ s.r) for s in series)
    found = []
    for s in series:
        over = np.flatnonzero(squares[s.experiment] > limit)
        for first, last in _runs(over, width):
            # Windows reach to half their width round a burst: its ends are where residuals themselves are large.
            inner = np.arange(max(first - width // 2, 0), min(last + width // 2 + 1, s.r.size))
            large = inner[s.r[inner] ** 2 > 4.0 * level]
            begin, end = (int(large[0]), int(large[-1])) if large.size else (first, last)
            r = s.r[begin : end + 1]
            rms = float(np.sqrt(np.mean(r**2)))
            share = float(r @ r) / total
            found.append(
                Span(s.experiment, float(s.t[begin]), float(s.t[end]), rms, rms / float(np.sqrt(level)), share)
            )
    found.sort(key=lambda span: -span.share)
    return running, float(np.sqrt(level)), found[:_MOST]


def _moving_mean(x: _Array, width: int) -> _Array:
    """Return (n,) mean over the samples within half a width of each, fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    middle = np.arange(x.size)
    # Windows at the ends stay as wide, and lean inwards: a narrow one would stand out by chance.
    low = np.clip(middle - width // 2, 0, x.size - width)
    return np.asarray((total[low + width] - total[low]) / width)


def _clipped(series: Sequence[Series]) -> dict[str, _Array]:
    """Residuals of which what stands out from both neighbours is clipped, and what is slow is not."""
    from scipy.ndimage import median_filter

    smooth = {s.experiment: median_filter(s.r, min(_NEIGHBOURS, s.r.size), mode="nearest") for s in series}
    rest = {s.experiment: s.r - smooth[s.experiment] for s in series}
    every = np.abs(np.concatenate(list(rest.values())))
    limit = _CLIP * (float(np.median(every[every > 0.0])) / 0.6745 if every.any() else 0.0)
    return {name: smooth[name] + np.clip(x, -limit, limit) for name, x in rest.items()}


def _clumping(clipped: Mapping[str, _Array], width: int) -> float:
    """Return 1 + 2 sum rho_k^2 within a window."""
    # Bursts are no colour.
    every = np.abs(np.concatenate(list(clipped.values())))
    limit = _CLIP * float(np.median(every)) / 0.6745 or math.inf
    clipped = {name: np.clip(x, -limit, limit) for name, x in clipped.items()}
    power = sum(float(x @ x) for x in clipped.values())
    n = sum(x.size for x in clipped.values())
    total = 1.0
    for k in range(1, width):
        pairs = [(x[:-k], x[k:]) for x in clipped.values() if x.size > k]
        count = sum(a.size for a, _ in pairs)
        if count == 0:
            break
        rho = sum(float(a @ b) for a, b in pairs) / count * n / power
        # What an estimate of zero would have for its square is no correlation.
        total += 2.0 * (1.0 - k / width) * max(rho * rho - 1.0 / count, 0.0)
    return min(total, 0.8 * width)


def _runs(indices: NDArray[np.int64], width: int) -> list[tuple[int, int]]:
    """First and last of each group of indices that are less than a window apart."""
    if indices.size == 0:
        return []
    groups = np.split(indices, np.flatnonzero(np.diff(indices) > width) + 1)
    return [(int(g[0]), int(g[-1])) for g in groups]


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
class Dependence:
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


def regimes_of(
    series: Sequence[Series], colour: Autoregression, memory: CorrelatedNoise, rms: float, alpha: float
) -> list[Regime]:
    """Return a regime for each variable, the least likely chance first; ``memory`` is that of the residuals, ``rms``
    their size."""
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
            error = rms * memory.spread(
                [np.nan_to_num(s.segment.on_grid(i / m)) for s, i in zip(series, inside, strict=True)]
            )
            # A bias of the whole record is no matter of regimes.
            beside = [s.segment.on_grid(i / m - 1.0 / r.size, 0.0) for s, i in zip(series, inside, strict=True)]
            of_difference = rms * memory.spread(beside)
            off = abs(mean - float(r.mean())) / of_difference if of_difference > 0.0 else 0.0
            chance = 2.0 * float(stdtr(freedom, -off)) * count * several
            # Regression sees what jumps between regimes, means what lasts in one.
            p_value = min(p_value, chance)
            bins.append(Bin(float(edges[b]), float(edges[b + 1]), m, mean, error, chance < alpha))
            power += m * (mean - float(r.mean())) ** 2
        found.append(Regime(name, tuple(bins), min(p_value, 1.0), power / (r.size * rms**2)))
    return sorted(found, key=lambda regime: (regime.p_value, -regime.share))


def correlations_of(series: Sequence[Series], colour: Autoregression, memory: CorrelatedNoise) -> list[Dependence]:
    """Return a correlation for each variable, the least likely chance first."""
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
        total = memory.spread([s.segment.on_grid((s.regressors[name] - mean) / size, 0.0) for s in series]) ** 2
        effective = float(np.clip(n * n / total, 1.0, n)) if total > 0.0 else float(n)
        p_value = _chance(series, colour, [s.regressors[name][:, None] for s in series])
        found.append(Dependence(name, both, effective, min(1.0, p_value * len(names))))
    return sorted(found, key=lambda c: (c.p_value, -abs(c.r)))


def _chance(series: Sequence[Series], colour: Autoregression, columns: Sequence[_Array]) -> float:
    """P-value of the regression of the residuals on columns, (n, m) each, beyond a constant.

    Both sides pass through the filter that whitens the residuals (generalised least squares, Cochrane and Orcutt 1949),
    so that the F-test holds for coloured ones.
    """
    from scipy.special import fdtrc

    rows = []
    for s, c in zip(series, columns, strict=True):
        # In units of the columns, for rates and angles differ by orders of magnitude.
        together = np.column_stack([np.ones(s.r.size), c, s.r])
        white = colour.innovations(s.segment.on_grid(together))
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
