"""Inputs that change faster than their samples tell, so that straight lines between two samples are wrong.

A step that happens between two samples is recorded as a ramp over the whole of that interval. Its area is wrong by as
much as the step times half the interval, which the outputs show, and which no term of the physics explains. What an
input was halfway through such an interval is a random effect with a marginal likelihood, as a disturbance is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...fit_result import dataset
from ...residual_noise.whitening import Filter
from ...sensitivities.linearised import Linearised
from ...sensitivities.trajectory import Place
from ...sensitivities.whitened import Marginal, RandomEffects, at_knots
from .disturbance import noises_of
from .refit import Refit, fitted_to, on_other_data

__all__ = ["SampledInputs", "sampled_inputs"]

_Array = NDArray[np.float64]
_Indices = NDArray[np.intp]

# Part of an input's range that it must change by between two samples, out of line with those before and after; the part
# of all intervals in which inputs do so seldom; and how many intervals are asked, those of the largest changes.
_JUMP, _SELDOM, _MOST = 0.08, 0.6, 120
# A step at one end of the interval has this times its size halfway, beside a straight line.
_WHOLE = 1.0
# Variance of that, in squares of the step, beyond which something else happens there; 1/3 where steps come at any time.
_WIDEST = 1.0

# Input -> intervals, by the sample that they begin with, for each record.
_Intervals = Sequence[Mapping[str, _Indices]]


@dataclass(frozen=True, eq=False)
class SampledInputs:
    """Inputs between samples, as the outputs tell.

    at        the refit, with inputs that have a sample halfway through each interval in question.
    jumps     input -> number of these intervals.
    step      s, the longest of them.
    marginal  where the likelihood is largest.
    merit     that log-likelihood, less the number of parameters of the variance and the noise.
    filter    of coloured noise; None for white.
    """

    at: Refit
    jumps: Mapping[str, int]
    step: float
    merit: float
    marginal: Marginal
    filter: Filter | None
    intervals: _Intervals

    @property
    def records(self) -> list[Experiment]:
        """The records with inputs as the outputs tell."""
        data = dataset(self.at.fit)
        return _corrected(data, self.intervals, self.marginal.coefficients)

    def on(self, data: Sequence[Experiment], free: Sequence[str] | None) -> list[Experiment]:
        """Other records with inputs as their outputs tell; as they are where the model does not fit them."""
        intervals = _intervals(data, list(self.jumps))
        if intervals is None:
            return list(data)
        finer = [_finer(e, own) for e, own in zip(data, intervals, strict=True)]
        try:
            other = on_other_data(self.at, finer, None, free)
        except PhugoidError:
            return list(data)
        filter = self.filter.on(other.structure) if self.filter else None
        effects = RandomEffects(other, _answers(other, finer, intervals), filter)
        found = effects.at(self.marginal.variance, self.marginal.noise)
        return _corrected(finer, intervals, found.coefficients)


def sampled_inputs(at: Refit) -> SampledInputs | None:
    """Return what inputs were between samples where they jump, as the outputs of a refit tell; None where none jumps
    or such a model cannot be fitted."""
    data = dataset(at.fit)
    intervals = _intervals(data, list(at.fit.model.declared_inputs))
    if intervals is None:
        return None
    finer = [_finer(e, own) for e, own in zip(data, intervals, strict=True)]
    refit = fitted_to(at, finer)
    if refit is None:
        return None
    linear = refit.linear
    answers = _answers(linear, finer, intervals)
    if not np.any(answers):
        return None
    found = []
    for filter, noise, cost in noises_of(refit):
        marginal = RandomEffects(linear, answers, filter).maximised(noise)
        found.append((marginal.log_likelihood - 1.0 - cost, filter, marginal))
    merit, filter, marginal = max(found, key=lambda each: each[0])
    if marginal.variance > _WIDEST:
        return None
    jumps = {n: sum(own[n].size for own in intervals) for n in intervals[0]}
    each = [np.diff(e.t)[k] for e, own in zip(data, intervals, strict=True) for k in own.values()]
    step = float(np.concatenate(each).max())
    return SampledInputs(refit, jumps, step, merit, marginal, filter, intervals)


def _intervals(data: Sequence[Experiment], names: Sequence[str]) -> _Intervals | None:
    """Return the intervals in which inputs jump; None where there are none."""
    found: dict[str, list[_Array]] = {}
    for name in names:
        if any(e.interpolation_of(name) != "linear" or e.signal(name) is not None for e in data):
            continue
        span = max(float(e.input(name).max()) for e in data) - min(float(e.input(name).min()) for e in data)
        if span > 0.0:
            sizes = [_jumps(e.input(name)) / span for e in data]
            count = sum(int((s > _JUMP).sum()) for s in sizes)
            if 0 < count <= _SELDOM * sum(s.size for s in sizes):
                found[name] = sizes
    if not found:
        return None
    every = np.sort(np.concatenate([s for sizes in found.values() for s in sizes]))[::-1]
    least = max(_JUMP, float(every[_MOST]) if every.size > _MOST else 0.0)
    return [{n: np.flatnonzero(sizes[e] > least) for n, sizes in found.items()} for e in range(len(data))]


def _jumps(u: _Array) -> _Array:
    """Return (n - 1,) by how much an input changes between two samples, out of line with the samples on both sides."""
    bent = np.abs(np.diff(u, 2, prepend=u[:1], append=u[-1:]))
    return np.minimum(np.minimum(bent[:-1], bent[1:]), np.abs(np.diff(u)))


def _halfway(e: Experiment, k: _Indices) -> _Array:
    return np.asarray(0.5 * (e.t[k] + e.t[k + 1]))


def _finer(e: Experiment, own: Mapping[str, _Indices]) -> Experiment:
    """Return the same record, with samples of inputs halfway through intervals, on the line, and a mesh that has
    them."""
    signals = dict(e._signals_of())
    for name, k in own.items():
        if k.size:
            u = e.input(name)
            halfway = 0.5 * (u[k] + u[k + 1])
            signals[name] = np.insert(e.t, k + 1, _halfway(e, k)), np.insert(u, k + 1, halfway), 0.0, 0
    times = [e.t if e.mesh_times is None else e.mesh_times, *(_halfway(e, k) for k in own.values())]
    same = e._stepped("inputs sampled between samples, too", e._columns_of(), signals)
    return same._sampled(signals, np.unique(np.concatenate(times)))


def _sizes(e: Experiment, own: Mapping[str, _Indices]) -> dict[str, _Array]:
    return {name: np.abs(np.diff(e.input(name)))[k] for name, k in own.items()}


def _answers(linear: Linearised, data: Sequence[Experiment], intervals: _Intervals) -> _Array:
    """Return (k, n_rows) answers of the outputs to inputs halfway through intervals, each in units of the jump
    there."""
    found = []
    for name in intervals[0]:
        counts = [own[name].size for own in intervals]
        ends = np.cumsum([0, *counts])
        signals = []
        for i, (e, own, p) in enumerate(zip(data, intervals, linear.points, strict=True)):
            signal = np.zeros((int(ends[-1]), p.n))
            for row, (k, size) in enumerate(zip(own[name], _sizes(e, own)[name], strict=True), int(ends[i])):
                t = e.t[[k, k, k + 1]]
                t[1] = 0.5 * (t[0] + t[2])
                signal[row] = size * at_knots(p.t, t)[1]
            signals.append(signal)
        found.append(linear.answers(Place("input", name), signals))
    return np.vstack(found)


def _corrected(data: Sequence[Experiment], intervals: _Intervals, coefficients: _Array) -> list[Experiment]:
    """Finer records with what random effects, input by input, add halfway through intervals."""
    signals = [dict(e._signals_of()) for e in data]
    first = 0
    for name in intervals[0]:
        for e, own, mine in zip(data, intervals, signals, strict=True):
            k = own[name]
            if k.size:
                t, u, delay, order = mine[name]
                change = np.clip(coefficients[first : first + k.size], -_WHOLE, _WHOLE) * _sizes(e, own)[name]
                u = u.copy()
                u[np.searchsorted(t, _halfway(e, k))] += change
                mine[name] = t, u, delay, order
            first += k.size
    return [
        e._stepped("inputs between samples as the outputs tell", e._columns_of(), s)
        for e, s in zip(data, signals, strict=True)
    ]
