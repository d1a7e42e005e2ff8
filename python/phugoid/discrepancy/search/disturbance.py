"""Causes that are not terms of the model: a random disturbance, a noisy input, a single event, or an unknown function
of one variable or two.

Each is a random time history at one place of the model, or a random function there, with a marginal likelihood about a
fit (`RandomEffects`); with white process noise that is the likelihood of the filter-error method, linearised. These
likelihoods, and that of the residuals as autoregressive noise of the sensors, are of the same data: they show which of
them it is, and at which place.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...modelling.model import Model
from ...residual_noise.whitening import Filter, Whitening
from ...sensitivities import Place, Points
from ...sensitivities.linearised import Linearised
from ...sensitivities.whitened import Marginal, RandomEffects, at_knots
from ...solvers import check_time
from ..candidates.scales import levels_of
from .refit import Refit

__all__ = [
    "LENGTH_SCALES",
    "Disturbance",
    "Disturbances",
    "disturbance_at",
    "functions",
    "functions_of",
    "functions_of_two",
    "hats",
    "histories_at",
    "likeliest_function",
    "noises_of",
    "powers_of",
]

_Array = NDArray[np.float64]

# Knots of a time history, over all records: first at all places, then at the likeliest ones.
_KNOTS, _FINER = 120, (240, 480)
# Places that are looked at more closely.
_LIKELY = 2
# Products of columns that are worth their time.
_PRODUCTS = 3e9
# Correlation times of a disturbance that are tried, in knots; 0 is white.
_CORRELATION = (0.0, 3.0, 12.0)
# Length scales over which a function of a variable changes, as parts of the variable's range: the first for all
# variables, the others for the likeliest; and nodes in each.
LENGTH_SCALES, _NODES = (0.25, 0.1, 0.04), 2.5
_SCALES_OF_TWO = 0.25, 0.15
_FEW_LEVELS = 3
# Part of the squares of a time history that an event holds, within this part of the time.
_EVENT, _SHORT = 0.7, 0.2
# Knots within the span of an event: those of the whole time history may be far apart beside it.
_IN_EVENT = (4, 8, 16, 32, 64)
# Parameters of a hypothesis beside the variances of the noise, which an autoregressive noise has too, by kind: a
# variance; a variance and a correlation time; a variance and two ends.
_Kind = Literal["noise", "event", "function"]


@dataclass(frozen=True, eq=False)
class Disturbance:
    """One hypothesis at its likeliest.

    kind        "noise": a stationary random time history; "event": one that is zero but for a span; "function": a
                smooth function of a variable, the same wherever the variable has a value again.
    place       what it is added to.
    variables   that a function depends on, one or two; else empty.
    merit       log-likelihood less the number of its parameters (Akaike).
    marginal    where that is.
    correlation s, correlation time of a disturbance; 0 for white.
    span        (record, begin, end) of an event, s.
    knots       (k,) values of time, records one after the other, or nodes of one variable.
    axes        nodes of each variable of a function; of two there are as many values as products of nodes.
    step        s, between knots.
    counts      knots of each record, of a random time history.
    """

    kind: _Kind
    place: Place
    variables: tuple[str, ...]
    merit: float
    marginal: Marginal
    correlation: float
    span: tuple[int, float, float] | None
    knots: _Array
    step: float
    counts: tuple[int, ...] = ()
    axes: tuple[_Array, ...] = ()

    @property
    def name(self) -> str:
        """Canonical, ``where:what``."""
        where = f"{self.place.name}'" if self.place.kind in ("equation", "state") else self.place.name
        return f"{where}:f({', '.join(self.variables)})" if self.kind == "function" else f"{where}:{self.kind}"

    @property
    def intensity(self) -> float:
        """Standard deviation of what is added to the place; of white noise the root of its density, so that the state
        has q √s as its standard deviation after s seconds."""
        if self.kind == "noise" and not self.correlation:
            return float(np.sqrt(self.marginal.variance * self.step))
        return float(np.sqrt(np.mean(self.values**2)))

    @property
    def values(self) -> _Array:
        """(k,) what is added to the place at the knots, in its unit."""
        return self.marginal.coefficients

    def marginal_on(self, axes: Sequence[_Array]) -> Marginal:
        """Return the values and deviations of a function at other nodes, between its own by broken lines."""

        def on_axes(found: _Array) -> _Array:
            found = found.reshape([nodes.size for nodes in self.axes])
            for k, (old, new) in enumerate(zip(self.axes, axes, strict=True)):
                lines = np.moveaxis(found, k, 0).reshape(old.size, -1)
                moved = np.stack([np.interp(new, old, line) for line in lines.T], axis=1)
                found = np.moveaxis(moved.reshape(new.size, *np.delete(found.shape, k)), 0, k)
            return found.ravel()

        m = self.marginal
        return replace(m, coefficients=on_axes(m.coefficients), deviations=on_axes(m.deviations))


class Disturbances:
    """Hypotheses about the fits of a search, each worked out once. ``base``: the model that was diagnosed; what a term
    adds to it, such as the state of a lag, is no place for a disturbance."""

    def __init__(self, base: Model) -> None:
        self.known = {*base.state_names, *base.declared_inputs, *base.quantity_names}
        self._best: dict[tuple[tuple[str, ...], bool], list[Disturbance]] = {}

    def ranked(self, at: Refit, white: bool = False) -> list[Disturbance]:
        """Return all hypotheses beside the terms of a refit, the likeliest first; none where there are too many
        samples.

        ``white``: the residuals are; they may still hold white noise of a state or an input, and nothing else is asked.
        """
        key = at.names, white
        if key not in self._best:
            self._best[key] = sorted(_hypotheses(at, self.known, white), key=lambda h: -h.merit)
        return self._best[key]


def _hypotheses(at: Refit, known: Collection[str], white: bool) -> Iterator[Disturbance]:
    linear = at.linear
    filter = Whitening.of(linear.residuals, linear.structure)
    noise = np.array([channel.power for channel in filter.channels])
    samples = max(len(np.unique(linear.times)), 2)
    if min(_KNOTS, samples) ** 2 * linear.n_rows > _PRODUCTS:
        return
    every = sorted((p for p in linear.places if p.name in known), key=lambda p: (p.kind, p.name))
    places = [p for p in every if p.kind in ("equation", "input", "state")]
    rough = []
    for place in places:
        found = _histories(linear, place, noise, min(_KNOTS, samples), times=(0.0,) if white else _CORRELATION)
        rough += found[:1]
        yield from found
    for best in sorted(rough, key=lambda h: -h.merit)[:_LIKELY]:
        finest = best
        for count in _FINER:
            if count >= 2 * samples or count**2 * linear.n_rows > _PRODUCTS:
                break
            found = _histories(linear, best.place, noise, min(count, samples), finest)
            yield from found
            finest = max([finest, *found], key=lambda h: h.merit)
        if white:
            continue
        event = _event(linear, finest, noise)
        if event is not None:
            yield event
    if not white:
        yield from functions_of(at, known)


def functions_of(at: Refit, known: Collection[str], only: Sequence[str] = ()) -> list[Disturbance]:
    """Random functions of states and inputs in equations and quantities, of those that are known, the likeliest of them
    bending more quickly, too. ``only``: variables, all where none is given."""
    model = at.linear.model
    variables = [n for n in (*model.state_names, *model.declared_inputs) if n in known and (not only or n in only)]
    places = [p for p in at.linear.places if p.kind in ("equation", "quantity") and p.name in known]
    places.sort(key=lambda p: (p.kind, p.name))
    found = sorted((h for p in places for h in functions(at, p, [(n,) for n in variables])), key=lambda h: -h.merit)
    quicker = [h for best in found[:_LIKELY] for h in functions(at, best.place, [best.variables], LENGTH_SCALES[1:])]
    return [*found, *quicker]


def functions_of_two(at: Refit, known: Collection[str], places: Sequence[Place]) -> list[Disturbance]:
    """Return random functions of two states or inputs each, of those that are known, at some places."""
    model = at.linear.model
    variables = [n for n in (*model.state_names, *model.declared_inputs) if n in known]
    return [h for p in places for h in functions(at, p, [*combinations(variables, 2)])]


def _histories(
    linear: Linearised,
    place: Place,
    noise: _Array,
    count: int,
    near: Disturbance | None = None,
    times: Sequence[float] = _CORRELATION,
) -> list[Disturbance]:
    """Return a random time history at a place, the likeliest first: of several correlation times; or, where one with
    wider knots is known, as quick as that and quicker."""
    check_time()
    knots, step = _knots(linear.points, count)
    answers = linear.answers(replace(place, shown=False), _signals(linear.points, knots))
    if not np.any(answers):
        return []
    found, effects = [], RandomEffects(linear, answers)
    flat = np.concatenate(knots)
    variance: float | None = None
    if near is not None:
        noise = near.marginal.noise
        same = near.correlation / step
        times = (same, same / 2.0) if same else _CORRELATION[:2]
    for tau in times:
        if near is not None:  # of white noise the density stays
            variance = near.marginal.variance * (1.0 if near.correlation else near.step / step)
        marginal = effects.with_correlation(_exponential(knots, tau)).maximised(noise, variance)
        merit = marginal.log_likelihood - (2.0 if tau else 1.0)
        counts = tuple(k.size for k in knots)
        found.append(Disturbance("noise", place, (), merit, marginal, tau * step, None, flat, step, counts))
    return sorted(found, key=lambda h: -h.merit)


def histories_at(at: Refit, place: Place) -> list[Disturbance]:
    """Return a random time history at a place beside the terms of a refit, of several correlation times, the likeliest
    first."""
    linear = at.linear
    noise = np.array([channel.power for channel in Whitening.of(linear.residuals, linear.structure).channels])
    samples = max(len(np.unique(linear.times)), 2)
    return _histories(linear, place, noise, min(_KNOTS, samples))


def _event(linear: Linearised, of: Disturbance, noise: _Array) -> Disturbance | None:
    """Return the shortest span that holds most of a time history, where it is short, as an event."""
    energy = of.values**2
    total, n = float(energy.sum()), energy.size
    sums = np.concatenate([[0.0], np.cumsum(energy)])
    ends = np.searchsorted(sums, sums[:-1] + _EVENT * total)
    lengths = np.where(ends <= n, ends - np.arange(n), n + 1)
    first = int(np.argmin(lengths))
    last = min(first + int(lengths[first]) + 1, n)
    first = max(first - 1, 0)
    ends_of = np.cumsum(of.counts)
    record = int(np.searchsorted(ends_of, first, side="right"))
    # A span goes over no end of a record.
    if last - first > max(_SHORT * n, 4) or last > ends_of[record]:
        return None
    begin, end = float(of.knots[first]), float(of.knots[last - 1])
    found: list[Disturbance] = []
    for count in _IN_EVENT:
        local = np.linspace(begin - of.step, end + of.step, count + 2)
        if found and local[1] - local[0] < 0.5 * _between_samples(linear, record, begin, end):
            break
        # It is zero outside.
        signals = [np.zeros((count, p.n)) for p in linear.points]
        signals[record] = at_knots(linear.points[record].t, local)[1:-1]
        marginal = RandomEffects(linear, linear.answers(replace(of.place, shown=False), signals)).maximised(noise)
        merit = marginal.log_likelihood - 3.0
        span = record, float(local[1]), float(local[-2])
        step = float(local[1] - local[0])
        found.append(Disturbance("event", of.place, (), merit, marginal, 0.0, span, local[1:-1], step))
    return max(found, key=lambda h: h.merit)


def _between_samples(linear: Linearised, record: int, begin: float, end: float) -> float:
    """Return the time between samples within a span, s."""
    times = np.unique(np.concatenate([linear.times[line[record]] for line in linear.rows]))
    inside = times[(times >= begin) & (times <= end)]
    return float(np.median(np.diff(inside))) if inside.size > 1 else end - begin


def functions(
    at: Refit,
    place: Place,
    over: Sequence[tuple[str, ...]],
    length_scales: Sequence[float] = LENGTH_SCALES[:1],
    white: bool = False,
) -> list[Disturbance]:
    """Smooth random functions of one variable each or of two at a place, beside noise that is white or, unless only
    ``white`` noise is asked for, has the autocorrelation of the residuals of the refit."""
    linear = at.linear
    noises = noises_of(at)[: 1 if white else None]
    found = []
    for names in over:
        check_time()
        for length_scale in length_scales:
            axes = tuple(_axis(linear.points, name, length_scale) for name in names)
            if not all(nodes.size for nodes in axes):
                break
            answers = linear.answers(place, [hats([p.values[n] for n in names], axes) for p in linear.points])
            if not np.any(answers):
                continue
            correlation: _Array = np.ones((1, 1))
            for nodes in axes:
                correlation = np.asarray(np.kron(correlation, _smooth(nodes.size)), dtype=np.float64)
            for filter, noise, cost in noises:
                marginal = RandomEffects(linear, answers, filter).with_correlation(correlation).maximised(noise)
                merit = marginal.log_likelihood - 2.0 - cost
                knots = axes[0] if len(axes) == 1 else np.empty(0)
                found.append(Disturbance("function", place, names, merit, marginal, 0.0, None, knots, 0.0, axes=axes))
    return found


def _axis(points: Sequence[Points], variable: str, length_scale: float) -> _Array:
    """Return nodes of a variable over its range, as many as a function of this length scale needs; none where
    the variable has too few values."""
    values = np.concatenate([p.values[variable] for p in points])
    low, high = float(values.min()), float(values.max())
    # Any function of two levels, as a relay has, is a constant and a linear part; three determine little more.
    if not high - low > 1e-9 * max(abs(low), abs(high)) or 0 < levels_of(values) <= _FEW_LEVELS:
        return np.empty(0)
    return np.linspace(low, high, round(_NODES / length_scale) + 1)


def hats(values: Sequence[_Array], axes: Sequence[_Array]) -> _Array:
    """Return the functions (k, n) that are 1 at one node and 0 at the others, and in between linear in each variable,
    along n values of each."""
    first, *others = (at_knots(each, nodes) for each, nodes in zip(values, axes, strict=True))
    for other in others:
        first = (first[:, None] * other).reshape(-1, other.shape[1])
    return first


def _smooth(size: int) -> _Array:
    """Return the correlation (size, size) of values of a smooth function at equally spaced nodes."""
    index = np.arange(size)
    return np.asarray(np.exp(-0.5 * ((index[:, None] - index) / _NODES) ** 2))


def likeliest_function(at: Refit, place: Place, variables: tuple[str, ...], white: bool = False) -> Disturbance | None:
    """Return the likeliest smooth function of one variable at a place, of any length scale, or of two, beside
    noise of either kind, or ``white`` noise; None where a variable has too few values, or nothing is seen of the
    place."""
    length_scales = LENGTH_SCALES if len(variables) == 1 else _SCALES_OF_TWO
    return max(functions(at, place, [variables], length_scales, white), key=lambda h: h.merit, default=None)


def noises_of(at: Refit) -> list[tuple[Filter | None, _Array, int]]:
    """Return the noise of the sensors beside random effects: white, or with the autocorrelation of the residuals of a
    refit. Each with variances to begin with and the number of its parameters beside these."""
    linear = at.linear
    white = Whitening.of(linear.residuals, linear.structure)
    powers = np.array([channel.power for channel in white.channels])
    coloured = (at.together or at.own).filter
    noises: list[tuple[Filter | None, _Array, int]] = [(None, powers, 0)]
    if coloured.parameters:
        noises.append((coloured, np.ones(len(powers)), coloured.parameters))
    return noises


def disturbance_at(linear: Linearised, of: Disturbance) -> float:
    """Return the log-likelihood of other records with a disturbance of the same kind, place and variances there."""
    return _effects_of(linear, of).at(of.marginal.variance, of.marginal.noise).log_likelihood


def components_of(linear: Linearised, of: Disturbance) -> _Array:
    """Return the independent components of a random time history that a record determines: standard normal if it is
    random (`RandomEffects.components`)."""
    return _effects_of(linear, of).components(of.marginal.variance, of.marginal.noise)


def _effects_of(linear: Linearised, of: Disturbance) -> RandomEffects:
    answers, correlation = _answers_of(linear, of)
    return RandomEffects(linear, answers).with_correlation(correlation)


def _answers_of(linear: Linearised, of: Disturbance) -> tuple[_Array, _Array | None]:
    """Return the responses (k, n_rows) to a time history at its knots, and the correlation of its values there."""
    knots, _ = _knots(linear.points, 0, of.step)
    answers = linear.answers(replace(of.place, shown=False), _signals(linear.points, knots))
    return answers, _exponential(knots, of.correlation / of.step)


def powers_of(linear: Linearised, of: Disturbance) -> _Array:
    """Return the mean square (n_y,) that a random time history is expected to give each output."""
    answers, correlation = _answers_of(linear, of)
    both = answers if correlation is None else correlation @ answers
    squares = of.marginal.variance * np.sum(answers * both, axis=0)
    return np.array([float(squares[line[0].start : line[-1].stop].mean()) for line in linear.rows])


def _knots(points: Sequence[Points], count: int, step: float = 0.0) -> tuple[list[_Array], float]:
    """Knots of each record, so many in all, equally spaced; or at a given step. And the step, s."""
    spans = [float(p.t[-1] - p.t[0]) for p in points]
    step = step or sum(spans) / max(count - len(spans), 1)
    counts = [max(int(np.ceil(s / step - 1e-6)), 1) + 1 for s in spans]
    return [np.linspace(p.t[0], p.t[-1], n) for p, n in zip(points, counts, strict=True)], step


def _signals(points: Sequence[Points], knots: Sequence[_Array]) -> list[_Array]:
    """Return broken lines (k, n) of all knots along each record: zero in the others."""
    ends = np.cumsum([0, *(k.size for k in knots)])
    found = []
    for e, p in enumerate(points):
        signals = np.zeros((int(ends[-1]), p.n))
        signals[ends[e] : ends[e + 1]] = at_knots(p.t, knots[e])
        found.append(signals)
    return found


def _exponential(knots: Sequence[_Array], tau: float) -> _Array | None:
    """Return the correlation (k, k) of a first-order process with a correlation time of ``tau`` knots; None for white
    noise."""
    if not tau:
        return None
    out = np.zeros((sum(k.size for k in knots),) * 2)
    first = 0
    for k in knots:
        index = np.arange(k.size)
        out[first : first + k.size, first : first + k.size] = np.exp(-np.abs(index[:, None] - index) / tau)
        first += k.size
    return out
