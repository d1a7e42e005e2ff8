"""When residuals stand out: spans of a record where their running RMS is too large for chance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..colour.series import Series

__all__ = ["Running", "Span", "spans_of"]

_Array = NDArray[np.float64]

_SHORTEST = 10  # samples of a window
_WINDOWS = 40  # that a record is divided into
_CLIP = 2.5  # robust standard deviations
_NEIGHBOURS = 5  # samples whose median an outlier does not move
_MOST = 5  # spans that are told of


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
    """Running RMS by experiment, its usual level, and the spans that stand out, the strongest first.

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
        running[s.experiment] = Running(s.t, np.sqrt(_moving_mean(s.r**2, short)), float(short * s.dt))
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
    """(n,) mean over the samples within half a width of each, fewer at the ends."""
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
    """1 + 2 sum rho_k^2 within a window."""
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
