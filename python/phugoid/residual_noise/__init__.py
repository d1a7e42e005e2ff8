"""Evenly sampled segments of records, the residuals of channels on them, and the resolution of their samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..records import Record

__all__ = [
    "ROUNDED",
    "WITHIN",
    "Series",
    "UniformSegment",
    "autocorrelation_of",
    "channel_series",
    "output_segments",
    "residual_of",
    "resolution_of",
    "same_rate",
    "sampled_segment",
    "uniform_segments",
]


_Array: TypeAlias = NDArray[np.float64]
_Indices: TypeAlias = NDArray[np.intp]

# Part of the spacing by which a step may differ from whole ones and still determine the spacing.
_OFF = 0.1
# Segments with fewer samples than this, in the mean, are what jitter leaves of even times.
_SHORT = 3
# Usual steps that jitter as little as this part of them from record to record are the same.
_ALIKE = 0.05
# A gap counts at most so many steps where samples are placed one after the other: no noise is correlated across more.
_LONGEST_GAP = 64


@dataclass(frozen=True, eq=False)
class UniformSegment:
    """Samples on an even grid of time.

    rows    where they are among the rows of residuals.
    places  (n,) of the grid points, increasing from 0: more than 1 between two is a gap.
    step    between grid points, s.
    """

    rows: slice
    places: _Indices
    step: float = 1.0

    @property
    def size(self) -> int:
        """Number of grid points, up to the last sample."""
        return int(self.places[-1]) + 1 if self.places.size else 0

    @cached_property
    def runs(self) -> list[slice]:
        """Samples without a gap between them, counted from the first."""
        breaks = np.flatnonzero(np.diff(self.places) > 1) + 1
        return [slice(a, b) for a, b in pairwise([0, *breaks.tolist(), self.places.size])]

    @property
    def mask(self) -> _Array:
        """(size,) 1 where there is a sample, else 0."""
        return self.on_grid(np.ones(self.places.size), 0.0)

    def on_grid(self, values: _Array, missing: float = np.nan) -> _Array:
        """Values at the samples (n, ...) on the grid, (size, ...), ``missing`` where there is no sample."""
        grid = np.full((self.size, *values.shape[1:]), missing)
        grid[self.places] = values
        return grid

    def from_row(self, first: int) -> UniformSegment:
        """Return the same segment where rows are counted from another one."""
        return UniformSegment(slice(self.rows.start + first, self.rows.stop + first), self.places, self.step)


def uniform_segments(times: _Array) -> Sequence[UniformSegment]:
    """Return the segments of increasing times (n,): where a step is not a multiple of the usual one, another begins.

    The usual step is the median; where too many samples are missing for that, a lesser one that leaves fewer
    segments. Where times jitter so much that hardly any two are so far apart, all samples are one segment: that each
    follows the one before describes noise with a correlation time better than that none does.
    """
    if times.size < 2:
        return [UniformSegment(slice(0, 1), np.zeros(1, dtype=np.intp))] if times.size else []
    steps = np.diff(times)
    # Steps that there are: of two that alternate the median is the mean.
    typical = np.quantile(steps, [0.5, 0.1], method="lower")
    found = min((_split(steps, float(step)) for step in typical), key=len)
    return found if len(found) * _SHORT <= times.size else [sampled_segment(times)]


def _split(steps: _Array, usual: float) -> list[UniformSegment]:
    usual = float(np.median(steps[np.abs(steps - usual) <= 2.0 * _OFF * usual]))  # where times are rounded
    numbers = np.maximum(np.rint(steps / usual), 1.0)
    # After a long gap a part of a step does not matter.
    breaks = np.flatnonzero(np.abs(steps / numbers - usual) > _OFF * usual) + 1
    places = np.r_[0, np.cumsum(numbers)].astype(np.intp)
    edges = [0, *breaks.tolist(), places.size]
    return [UniformSegment(slice(a, b), places[a:b] - places[a], usual) for a, b in pairwise(edges)]


def sampled_segment(times: _Array) -> UniformSegment:
    """Return one segment of all times (n,), two or more: each sample follows the one before after so many median steps,
    whatever the jitter of its time."""
    steps = np.diff(times)
    step = float(np.median(steps))
    numbers = np.clip(np.rint(steps / step), 1, _LONGEST_GAP).astype(np.intp)
    return UniformSegment(slice(0, times.size), np.r_[0, np.cumsum(numbers)].astype(np.intp), step)


def output_segments(times: _Array, rows: Sequence[Sequence[slice]]) -> list[list[UniformSegment]]:
    """Return segments[i][e] of output i in experiment e, whose samples at ``times`` are ``rows[i][e]``.

    A sample stands on the nearest grid point; of samples that are nearer to each other than a step, later ones stand
    on the next. Outputs that are sampled alike have the same grid points.
    """
    steps = [_usual_step([times[own] for own in line if own.stop > own.start]) for line in rows]
    # Steps that differ by rounding only are one.
    for i, step in enumerate(steps):
        same = [s for s in steps[:i] if abs(s - step) <= 1e-3 * step]
        steps[i] = same[0] if same else step
    found: list[list[UniformSegment]] = []
    for line, step in zip(rows, steps, strict=True):
        found.append([])
        for e, own in enumerate(line):
            begin = min(times[other[e].start] for other in rows if other[e].stop > other[e].start)
            places = np.rint((times[own] - begin) / step).astype(np.intp)
            order = np.arange(places.size)
            places = np.maximum.accumulate(places - order) + order
            found[-1].append(UniformSegment(own, places, step))
    return found


def _usual_step(times: list[_Array]) -> float:
    """Return the usual spacing: the mean of those steps that are nearly a whole number of median ones."""
    steps = np.concatenate([np.diff(t) for t in times]) if times else np.empty(0)
    if not steps.size:
        return 1.0
    usual = float(np.median(steps))
    numbers = np.rint(steps / usual)
    even = (np.abs(steps - numbers * usual) <= _OFF * usual) & (numbers >= 1.0)
    return float(steps[even].sum() / numbers[even].sum()) if even.any() else usual


_FAR = 8.0  # robust standard deviations of an outlier
_ALONE = 11  # samples of which two at most are outliers
_SAME = 0.9999  # correlation from which on two variables are one


@dataclass(frozen=True, eq=False, repr=False)
class Series:
    """Residuals of one channel in one experiment; n samples present, G places on their grid.

    experiment  its name.
    outliers    times of samples far off their neighbours, s, which are left out of the others.
    t           (n,) times of the samples that are there, s.
    r           (n,) residuals, as `residual_of` gives them.
    segment     their places on a grid, whose step is the median spacing: of a channel slower than others, its own.
    regressors  name -> (n,): states (with process noise those predicted from the samples before), inputs, and their
                rates (with a prime: ``q'``), which change in this experiment; and ``time`` since its first sample.
    """

    experiment: str
    outliers: _Array
    t: _Array
    r: _Array
    segment: UniformSegment
    regressors: Mapping[str, _Array]


def channel_series(records: Sequence[Record], channel: str) -> list[Series]:
    """Return one series for each experiment where the channel has two samples or more."""
    found = []
    for record in records:
        r = residual_of(record, channel)
        if r is None:
            continue
        there = np.flatnonzero(np.isfinite(r))
        if there.size < 2:
            continue
        out = _outliers(r[there])
        outliers, there = record.t[there[out]], there[~out]
        t = record.t[there]
        found.append(Series(record.name, outliers, t, r[there], sampled_segment(t), _regressors(record, there)))
    return found


def residual_of(record: Record, channel: str) -> _Array | None:
    """Return the residuals of a channel, (N,), NaN where missing; None where there are none.

    With process noise they are the innovations, each divided by its own standard deviation: after a gap, or where few
    sensors are read, a right model predicts less well, and says so. They keep their root mean square in the record.
    """
    r = record.innovations.get(channel, record.residuals.get(channel))
    std = record.innovation_std.get(channel)
    if r is None or std is None:
        return r
    there = np.isfinite(r) & (std > 0.0)
    alike = np.full(r.shape, np.nan)
    alike[there] = r[there] / std[there]
    size = float(np.linalg.norm(alike[there]))
    return alike * (float(np.linalg.norm(r[there])) / size) if size > 0.0 else alike


def same_rate(series: Sequence[Series]) -> tuple[list[Series], list[Series]]:
    """Split series into those sampled at the rate that most samples have, and the others."""
    steps = np.array([s.segment.step for s in series])
    alike = np.abs(steps[:, None] - steps) < _ALIKE * steps  # [i, j]: as the step of j has it
    most = int(np.argmax(np.array([s.r.size for s in series]) @ alike))
    pairs = list(zip(series, alike[:, most].tolist(), strict=True))
    return [s for s, same in pairs if same], [s for s, same in pairs if not same]


def _outliers(r: _Array) -> NDArray[np.bool_]:
    """Mark samples (n,) that are far off the median of their neighbours, and alone: many in a row are a misfit."""
    none = np.zeros(r.size, dtype=bool)
    if r.size < 2 * _ALONE:
        return none
    neighbours = np.lib.stride_tricks.sliding_window_view(np.pad(r, 2, "edge"), 5)
    off = np.abs(r - np.median(neighbours, axis=1))
    scale = float(np.median(off[off > 0.0])) / 0.6745 if off.any() else 0.0
    if float(np.mean(off > 0.0)) < 0.5:  # quantised: the median says nothing of the scatter
        return none
    far = off > _FAR * scale
    return np.asarray(far & (np.convolve(far, np.ones(_ALONE), "same") < 2.5))


def _regressors(record: Record, there: NDArray[np.int64]) -> dict[str, _Array]:
    # The smoothed states of a filter follow the innovations at the same sample and after it: a right model would seem
    # to err where they move. What is predicted from the samples before is independent of them.
    states = record.predicted_states if record.innovations else record.states
    own = {"time": record.t - record.t[0], **states, **record.inputs}
    rates = {f"{name}'": _backward(values, record.t) for name, values in record.predicted_states.items()}
    # States run smoothly along the fitted path, so central differences of it are rates without noise.
    smooth = record.inputs if record.innovations else {**states, **record.inputs}
    rates |= {f"{name}'": np.gradient(values, record.t) for name, values in smooth.items()}
    # The rate of what rests is rounding.
    rates = {name: values for name, values in rates.items() if _moves(own[name.removesuffix("'")])}
    found: dict[str, _Array] = {}
    for name, values in (own | rates).items():
        x = values[there]
        # The rate of an angle is often a state itself, and is listed once.
        if _moves(x) and not any(abs(np.corrcoef(x, y)[0, 1]) > _SAME for y in found.values()):
            found[name] = x
    return found


def _backward(values: _Array, t: _Array) -> _Array:
    """Backward differences, which no later sample enters."""
    slopes = np.diff(values) / np.diff(t)
    return np.concatenate([slopes[:1], slopes])


def _moves(values: _Array) -> bool:
    return bool(np.isfinite(values).all() and np.ptp(values) > 1e-9 * np.abs(values).max())


_LAGS = 100


def autocorrelation_of(series: Sequence[Series]) -> tuple[_Array, _Array, _Array]:
    """Lags in s, autocorrelation about zero, and its variance if residuals are white, of all experiments together.

    The variance is that of residuals of which the size may change (Diebold 1986): a noisy stretch is not colour.
    """
    grids = [s.segment.on_grid(s.r) for s in series]
    n = sum(s.r.size for s in series)
    power = sum(float(s.r @ s.r) for s in series) / n
    longest = max(g.size for g in grids)  # of many short records no lag is as long as one of them
    lags = range(min(_LAGS, n // 4, longest - 1) + 1)
    rho, scatter = [], []
    for k in lags:
        products = np.concatenate([g[k:] * g[: g.size - k] for g in grids if g.size > k])
        products = products[np.isfinite(products)]
        rho.append(float(products.mean()) / power if products.size else 0.0)
        squares = float(np.mean(products**2)) if products.size else 0.0
        scatter.append(squares / power**2 / products.size if squares > 0.0 else np.inf)
    return np.array(lags) * series[0].segment.step, np.array(rho), np.array(scatter)


ROUNDED = 1.0 / 12.0
"""Variance of what rounding takes away, in squares of the resolution (Widrow and Kollar 2008, chapter 1)."""

WITHIN = 0.5
"""Residuals of this many steps, RMS, or less are within the resolution: rounding alone gives 0.29, and a sensor has
some noise of its own."""

# Samples that there are to be for each value that occurs, and part of a step by which values may lie off the grid.
_REPEATED, _UNEVEN = 3.0, 1e-3


def resolution_of(samples: Sequence[_Array]) -> float:
    """Return the step of the grid on which all samples of some records (n,) lie; 0 where there is none.

    A grid differs from fine digits of a text file in its values, which are few and recur.

    >>> resolution_of([np.array([0.0, 0.5, 0.5, 1.0, 0.5, 0.0, 0.0, 0.5, 1.0, 1.5, 1.0, 1.0])])
    0.5
    """
    every = np.concatenate([np.zeros(0), *(z[np.isfinite(z)] for z in samples)])
    values = np.unique(every)
    if values.size < 2 or every.size < _REPEATED * values.size:
        return 0.0
    gaps = np.diff(values)
    step = float(gaps[gaps > _UNEVEN * float(np.median(gaps))].min())
    steps = (values - values[0]) / step
    return step if float(np.abs(steps - np.round(steps)).max()) < _UNEVEN * max(1.0, float(steps[-1]) * 1e-3) else 0.0
