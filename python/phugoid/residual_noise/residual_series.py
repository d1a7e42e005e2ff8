"""The residuals of one channel in one experiment, on the grid of its own sampling."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..records import Record
from .uniform_segments import UniformSegment, sampled_segment

__all__ = ["Series", "autocorrelation_of", "channel_series", "residual_of", "same_rate"]

_Array = NDArray[np.float64]

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
    alike = np.abs(steps[:, None] - steps) < 0.01 * steps  # [i, j]: as the step of j has it
    most = int(np.argmax(np.array([s.r.size for s in series]) @ alike))
    pairs = list(zip(series, alike[:, most].tolist(), strict=True))
    return [s for s, same in pairs if same], [s for s, same in pairs if not same]


def _outliers(r: _Array) -> NDArray[np.bool_]:
    """Mark samples (n,) that are far off the median of their neighbours, and alone: many in a row are a misfit."""
    from scipy.ndimage import median_filter

    none = np.zeros(r.size, dtype=bool)
    if r.size < 2 * _ALONE:
        return none
    off = np.abs(r - median_filter(r, 5, mode="nearest"))
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

    The variance is that of residuals of which the size may change (Diebold 1986): a noisy stretch is no colour.
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
