"""Inputs that act otherwise than they are recorded: held between their samples, smooth there, without the noise that
their records have, by another clock, or changing faster than they are sampled.

The output-error method takes inputs as known. Noise on a recorded input acts like process noise in the model's response
and biases the estimates (Jategaonkar 2015, ch. 5): where the data say so, the noise is filtered out of the record.

A step that happens between two samples is recorded as a ramp over the whole of that interval. Its area is wrong by as
much as the step times half the interval, which the outputs show, and which no term of the physics explains. What an
input was halfway through such an interval is a random effect with a marginal likelihood, as a disturbance is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...fit_result import dataset
from ...residual_noise.whitening import Filter
from ...sensitivities import Place
from ...sensitivities.linearised import Linearised
from ...sensitivities.whitened import Marginal, RandomEffects, Whitened, at_knots
from .clock import Clock, alike, other_clock
from .disturbance import noises_of
from .evidence import AssessmentSettings
from .free_run import Explained, Misfitting, Simulated
from .refit import HeldOut, Refit, fitted_to, gain_on_other_data, is_structured, on_other_data
from .refit_cache import RefitCache

__all__ = [
    "ALIKE_GAIN",
    "RecordedInput",
    "SampledInputs",
    "noise_of",
    "recorded_input",
    "sampled_inputs",
]

_Array = NDArray[np.float64]
_Kind = Literal["hold", "cubic", "noise", "clock"]
_OF_ONE: tuple[Literal["hold", "cubic", "noise"], ...] = ("hold", "cubic", "noise")

# Log-likelihood by which another input must be ahead of the one recorded, joined by straight lines.
_MARGIN = 8.0
# Filters that take noise away and leave steps and doublets of the pilot, in samples: running medians, and means whose
# weights fall with the distance in time and, within a part of the noise, in the filtered value.
_MEDIANS, _MEANS = (5, 11), (8, 20, 60)
# Widths of plain means, in samples, for an input that is a random walk.
_SMOOTH = (1.5, 3.0)
_FIRST, _ALIKE = 5, 1.5
# Part of the misfit that another clock must explain.
_MOST_OF_IT = 0.5
# Log-likelihood by which another cause may be behind and still not be distinguished.
ALIKE_GAIN = 5.0
# To first order the data ask for so much of what the filter takes away: about all of it.
_ALL = (0.4, 1.6)


@dataclass(frozen=True, eq=False)
class RecordedInput:
    """How an input acts, where it acts otherwise than it is recorded.

    name        of the input; of a clock, of the output, or "inputs" or "outputs" where it is of several.
    kind        "hold": constant until the next sample; "cubic": smooth between samples; "noise": without the noise that
                is on the record; "clock": by another clock than that of the record.
    refit       the fit with it so.
    validation  the other records with it so; those that are no better so as they are.
    gain        in log-likelihood, coloured noise.
    held_out    the same on the other records; None without any.
    explained   what it explains of their misfit in free simulation; without other records, of that of the fit's own.
    noise       RMS of the noise, in the input's unit; 0 for the other kinds.
    clock       that by which channels were recorded; None for the other kinds.
    alternatives      others that the data do not distinguish from it, as a late output and an early input: cause ->
                      gain.
    """

    name: str
    kind: _Kind
    refit: Refit
    validation: Sequence[Experiment]
    gain: float
    held_out: HeldOut | None
    explained: Explained | None
    noise: float = 0.0
    clock: Clock | None = None
    alternatives: Mapping[str, float] = field(default_factory=dict)

    @property
    def cause(self) -> str:
        """Canonical name."""
        return f"{self.name}:{self.kind}"


def recorded_input(search: RefitCache) -> RecordedInput | None:
    """Return the input that the data say is held between its samples, smooth there, recorded with noise, or by another
    clock, the clearest of them; None where there is none.

    A delay of half a sample does nearly the same as an input that is held: where that predicts other data better than
    straight lines do, it is named first, since it has no parameter.
    """
    base, validation = search.base, search.validation
    data, found = dataset(base.fit), None
    try:
        before = search.on_validation(base)
    except PhugoidError:
        return None
    for name in base.fit.model.declared_inputs:
        if any(e.interpolation_of(name) != "linear" or e.signal(name) is not None for e in data):
            continue
        noise = _without_noise(base.own, name)
        least = max(_MARGIN, found.gain if found else 0.0)
        for kind in _OF_ONE:
            treated = noise if kind == "noise" else [e.with_interpolation({name: kind}) for e in data]
            refit = fitted_to(base, treated) if treated else None
            if refit is None or refit.merit - base.merit < least:
                continue
            one = RecordedInput(name, kind, refit, validation, refit.merit - base.merit, None, None)
            one = replace(one, noise=_rms(data, treated, name)) if kind == "noise" else one
            confirmed = _confirmed(one, before, base, search.biases) if before is not None else _explaining(one, base)
            if confirmed is not None:
                found, least = confirmed, confirmed.gain
    clock = _by_another_clock(search, data, before)
    return max((one for one in (found, clock) if one is not None), key=lambda one: one.gain, default=None)


def _by_another_clock(
    search: RefitCache, data: Sequence[Experiment], before: Linearised | None
) -> RecordedInput | None:
    """Return the channels that were recorded by another clock than the rest, one input or all of them, or some outputs,
    where that explains most of the misfit: what changes slowly in a record looks a little like it."""
    base, found = search.base, list[RecordedInput]()
    if not is_structured(base, _MOST_OF_IT):
        return None
    inputs, outputs = list(base.fit.model.declared_inputs), base.fit.model.output_names
    clocks = [Clock("input", (n,)) for n in inputs]
    if len(inputs) > 1:
        clocks.append(Clock("input", tuple(inputs)))
    same = alike(base, outputs, data)
    groups = dict.fromkeys([*((n,) for n in same), tuple(same)])
    clocks += [Clock("output", group) for group in groups if group]
    for clock in clocks:
        best = other_clock(base, clock, data, _MARGIN)
        if best is None:
            continue
        clock, refit, gain = best
        name = clock.names[0] if len(clock.names) == 1 else f"{clock.kind}s"
        one = RecordedInput(name, "clock", refit, search.validation, gain, None, None, clock=clock)
        confirmed = _confirmed(one, before, base, search.biases) if before is not None else _explaining(one, base)
        if confirmed is not None and confirmed.explained is not None and confirmed.explained.part > _MOST_OF_IT:
            found.append(confirmed)
    first = max(found, key=lambda one: one.gain, default=None)
    alternatives = {o.cause: o.gain for o in found if o is not first and first and o.gain > first.gain - ALIKE_GAIN}
    return replace(first, alternatives=alternatives) if first else None


def _explaining(one: RecordedInput, base: Refit) -> RecordedInput | None:
    """Return what the records themselves say of it, where none are held out; None where it explains next to nothing of
    their misfit, however likely it is."""
    # By another clock outputs lack samples at an end of the records.
    same = fitted_to(base, one.clock.known(dataset(base.fit))) if one.clock is not None else base
    if same is None:
        return None
    explained = Simulated.of(one.refit.linear).explained(Simulated.of(same.linear), Misfitting.of(same.linear))
    return replace(one, explained=explained) if one.kind == "cubic" or _counts(explained) else None


def _counts(explained: Explained) -> bool:
    """Return whether it explains more than a minor finding does, and more than chance."""
    return explained.significant and explained.part >= AssessmentSettings().minor


def _confirmed(one: RecordedInput, before: Linearised, base: Refit, free: Sequence[str] | None) -> RecordedInput | None:
    """Return the input with its gain on held-out data; None where they contradict it."""
    name, kind = one.name, one.kind
    if kind == "noise":
        other = _without_noise(Whitened(before, base.own.filter.on(before.structure)), name)
    elif kind == "clock":
        other = one.clock.on(one.validation) if one.clock is not None else []
    else:
        other = [e.with_interpolation({name: kind}) for e in one.validation]
    if not other:
        return None
    try:
        after = on_other_data(one.refit, other, None, free)
        if one.clock is not None and one.clock.kind == "output":
            before = on_other_data(base, one.clock.known(one.validation), before, free)
    except PhugoidError:
        return None
    gain = gain_on_other_data(before, after)
    explained = Simulated.of(after).explained(Simulated.of(before), Misfitting.of(before))
    if kind != "cubic" and not (gain.gain > 0.0 and _counts(explained)):
        return None
    if gain.gain <= 0.0:  # of another manoeuvre inputs may not be smooth
        other = list(one.validation)
    return replace(one, validation=other, held_out=gain, explained=explained)


def _without_noise(at: Whitened, name: str) -> list[Experiment]:
    """Return the records of a fit with an input filtered as it fits best to first order; none where the data do not ask
    for about all that any filter takes away."""
    linear, data, place = at.linear, at.linear.experiments, Place("input", name)
    inputs = [e.input(name) for e in data]
    if place not in linear.places or any(noise_of(u) == 0.0 for u in inputs):
        return []
    filtered = [
        [_median(u, size) for size in _MEDIANS]
        + [_edge_preserving(u, width) for width in _MEANS]
        + [_smooth(u, width) for width in _SMOOTH]
        for u in inputs
    ]
    signals = [
        np.stack([np.interp(p.t, e.t, row - u) for row in rows])
        for p, e, u, rows in zip(linear.points, data, inputs, filtered, strict=True)
    ]
    columns = at.filter(linear.answers(place, signals))
    columns = columns - (columns @ at.basis) @ at.basis.T
    power = np.maximum(np.sum(columns**2, axis=1), 1e-300)
    asked = columns @ at.errors / power
    gain = np.where((asked >= _ALL[0]) & (asked <= _ALL[1]), 0.5 * power * asked**2, 0.0)
    best = int(np.argmax(gain))
    if gain[best] <= _MARGIN:
        return []
    return [e.with_channels({name: rows[best]}) for e, rows in zip(data, filtered, strict=True)]


def _rms(data: Sequence[Experiment], treated: Sequence[Experiment], name: str) -> float:
    taken = np.concatenate([a.input(name) - b.input(name) for a, b in zip(data, treated, strict=True)])
    return float(np.sqrt(np.mean(taken**2)))


def noise_of(u: _Array) -> float:
    """Return the standard deviation of white noise on a signal that is smooth in most places, by second differences."""
    return float(np.median(np.abs(np.diff(u, 2))) / (0.6745 * np.sqrt(6.0))) if u.size > 2 else 0.0


def _median(u: _Array, size: int) -> _Array:
    from scipy.ndimage import median_filter  # not at import: it takes its time

    return np.asarray(median_filter(u, size, mode="nearest"))


def _smooth(u: _Array, width: float) -> _Array:
    """Filter by means with the weights of a normal density: a random walk has no steps to keep."""
    reach = int(np.ceil(4.0 * width))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    return np.convolve(np.pad(u, reach, mode="edge"), weights / weights.sum(), mode="valid")


def _edge_preserving(u: _Array, width: int) -> _Array:
    """Filter by means over samples that are near in time and alike in value (bilateral filter, Tomasi and Manduchi
    1998)."""
    alike = _ALIKE * max(noise_of(u), 1e-300)
    reach = 3 * width
    rough, padded = np.pad(_median(u, _FIRST), reach, mode="edge"), np.pad(u, reach, mode="edge")
    n, middle = u.size, rough[reach : reach + u.size]
    total, weights = np.zeros(n), np.zeros(n)
    for shift in range(2 * reach + 1):
        away = (rough[shift : shift + n] - middle) / alike
        weight = np.exp(-0.5 * (((shift - reach) / width) ** 2 + away**2))
        total += weight * padded[shift : shift + n]
        weights += weight
    return total / weights


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
    """Inputs between samples, estimated from the outputs.

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
        """The records with inputs estimated from the outputs."""
        data = dataset(self.at.fit)
        return _corrected(data, self.intervals, self.marginal.coefficients)

    def on(self, data: Sequence[Experiment], free: Sequence[str] | None) -> list[Experiment]:
        """Other records with inputs estimated from their outputs; as they are where the model does not fit them."""
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
    """Return what inputs were between samples where they jump, from the outputs of a refit; None where none jumps
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
        span = float(np.ptp(np.concatenate([e.input(name) for e in data]))) if data else 0.0
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
        e._stepped("inputs between samples, estimated from the outputs", e._columns_of(), s)
        for e, s in zip(data, signals, strict=True)
    ]
