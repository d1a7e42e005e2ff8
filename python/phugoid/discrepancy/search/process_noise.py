"""A random disturbance at a place of a model by the filter-error method, white or through a shaping filter; and
whether it is one event, of which the rest of the records, and data held out, are free.

A random time history about a fit is linear in what it does. Where gusts move the vehicle far from the path that the
model simulates without them, and bias its parameters, that is no approximation: the filter-error method follows the
measured path. Gusts are not white: w' = -w / tau + q n with white noise n is added to an equation, to an input, or to a
state as the forces have it (Jategaonkar 2015, ch. 5; Dryden's spectra begin so).

An event and a stationary disturbance both explain a short burst. An event biases all parameters of the fit, so that
neither its own likelihood about that fit nor that of the noise says which of them it is. The parameters are
re-estimated from the records without the span instead: of an event nothing is left in them, of process noise all but
the span.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..._core import Expr
from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...estimation import estimate
from ...filter_error import FilterError
from ...fit_result import FitResult, dataset
from ...frozen_model import freeze_model, freeze_noise
from ...modelling.model import Model
from ...parameters import Parameter
from ...sensitivities import Place
from ...solvers import Deadline, check_time
from ...solvers.newton import Newton
from ..candidates.candidate import taken_names, unused
from .disturbance import Disturbance, histories_at
from .free_run import Misfitting
from .refit import Refit, fitted_to, is_structured, on_other_data, values_of
from .refit_cache import RefitCache

__all__ = [
    "FilterErrorRefit",
    "filtered",
    "filtered_elsewhere",
    "is_disturbed",
    "single_event",
    "through_shaping_filter",
]

# Correlation times from the start value on, in times of it; white noise is begun as noise of so many knots.
_SHORTER, _LONGER, _BEGUN = 0.1, 30.0, 2.0
# Log-likelihood by which the filter-error method is beyond a linearisation, and by which that is far behind.
_BETTER, _FAR = 8.0, 200.0


@dataclass(frozen=True, eq=False)
class FilterErrorRefit:
    """A fit by the filter-error method.

    fit       its parameters have the intensity of the noise, ``q_<state>``.
    state     that white noise drives: one of the model, or that of the shaping filter.
    tau       name of the correlation time; "" without a shaping filter.
    """

    fit: FitResult
    state: str
    tau: str = ""

    @property
    def merit(self) -> float:
        """Log-likelihood less the number of parameters of the disturbance (Akaike)."""
        return self.fit.log_likelihood - (2.0 if self.tau else 1.0)

    @property
    def intensity(self) -> tuple[float, float]:
        """Standard deviation of what is added, or q of white noise; and its standard error."""
        q = self.fit.parameters[f"q_{self.state}"]
        if not self.tau:
            return q.value, q.std_error
        tau = self.fit.parameters[self.tau]
        size = q.value * float(np.sqrt(tau.value / 2.0))
        # A size that is q sqrt(tau / 2) is known better than either: their estimates go together.
        names = list(self.fit.parameters)
        at = [names.index(e.name) for e in (q, tau)]
        slopes = size * np.array([1.0 / q.value, 0.5 / tau.value])
        return size, float(np.sqrt(slopes @ self.fit.covariance[np.ix_(at, at)] @ slopes))

    @property
    def correlation(self) -> float:
        """Correlation time, s; 0 of white noise."""
        return self.fit.parameters[self.tau].value if self.tau else 0.0


def through_shaping_filter(model: Model, place: Place, tau: float) -> tuple[Model, str, str]:
    """Return the model with a first-order shaping filter whose state is added to a place; the names of that state and
    of its correlation time, which starts at ``tau``, s."""
    taken = taken_names(model)
    state, time = unused(f"{place.name}_gust", taken), unused(f"tau_{place.name}_gust", taken)
    equations, x, w = model._right_hand_sides(), Expr.symbol(place.name), Expr.symbol(state)
    if place.kind == "equation":
        equations["equation", place.name] = Expr(equations["equation", place.name] + w)
    else:
        of_forces = any(kind == "quantity" and place.name in e.symbols for (kind, _), e in equations.items())
        for key, e in list(equations.items()):
            acts = place.kind == "input" or key[0] == "quantity" or (key[0] == "equation" and not of_forces and e != x)
            if acts and place.name in e.symbols:
                equations[key] = Expr(e.substitute({place.name: x + w}))
    declared = Parameter(tau, bounds=(_SHORTER * tau, _LONGER * tau), unit=model.time_unit, transform="log")
    shaped = model._changed(
        parameters={time: declared},
        equations=equations,
        states={state: ("", Expr(-w / Expr.symbol(time)), None)},
    )
    return shaped, state, time


def filtered(at: Refit, of: Disturbance, seconds: float) -> FilterErrorRefit | None:
    """Return the fit by the filter-error method with a disturbance at the place of one; None where it fails.

    White noise of an equation is tried where the disturbance is white, and a shaping filter where that is not likelier
    than coloured noise of the sensors. Initial states are parameters, so that without noise the likelihood is that of
    output error.
    """
    check_time()
    model, fit = at.fit.model, at.fit
    if model.delays or any(p.per_experiment for p in model.declared_parameters.values()):
        return None
    initial: dict[str, tuple[float, float] | None] = dict.fromkeys(model.state_names)
    white: FilterErrorRefit | None = None
    if of.place.kind == "equation" and not of.correlation:
        method = FilterError(of.place.name, initial=initial, time_limit=seconds)
        found = _estimated(model, dataset(fit), method, fit, fit, seconds)
        white = FilterErrorRefit(found, of.place.name) if found is not None else None
        # Far behind, and no likelier than the linearisation: that has tried coloured histories as well.
        hopeless = white is not None and white.merit < of.merit + _BETTER and of.merit < at.merit - _FAR
        if white is not None and (white.merit > at.merit or hopeless):
            return white
    tau = of.correlation or _BEGUN * of.step
    size = float(np.sqrt(np.mean(of.values**2)))
    shaped, state, time = through_shaping_filter(model, of.place, tau)
    if not size > 0.0:
        return white
    method = FilterError(state, initial={**initial, state: (0.0, size)}, time_limit=seconds)
    start = {**fit.as_start(fit.noise), f"q_{state}": size * float(np.sqrt(2.0 / tau))}
    found = _estimated(shaped, dataset(fit), method, fit, start, seconds)
    coloured = FilterErrorRefit(found, state, time) if found is not None else None
    return max((f for f in (white, coloured) if f is not None), key=lambda f: f.merit, default=None)


def filtered_elsewhere(of: FilterErrorRefit, data: Sequence[Experiment], free: Sequence[str], seconds: float) -> float:
    """Return the log-likelihood of other records with the model and the disturbance as fitted, but for initial states
    and ``free`` parameters; NaN where there is no such fit."""
    fit, name = of.fit, f"q_{of.state}"
    values = {n: e.value for n, e in fit.parameters.items()}
    model, known = freeze_model(fit.model, values, free), {of.state: values[name]}
    initial: dict[str, tuple[float, float] | None] = dict.fromkeys(model.state_names)
    if of.tau:
        initial[of.state] = (0.0, of.intensity[0])
    method = FilterError(of.state, initial=initial, intensities=known, time_limit=seconds)
    found = _estimated(model, data, method, fit, None, seconds)
    return found.log_likelihood if found is not None else float("nan")


def _estimated(
    model: Model,
    data: Sequence[Experiment],
    method: FilterError,
    of: FitResult,
    start: FitResult | dict[str, float] | None,
    seconds: float,
) -> FitResult | None:
    """Return an estimation that converged; None else. Of other records than those of a fit its noise is known."""
    noise = of.noise if start is not None else freeze_noise(of)[0]
    try:
        with Deadline(seconds).in_force():
            found = estimate(model, list(data), transcription=method, noise=noise, start=start)
    except (PhugoidError, np.linalg.LinAlgError):
        return None
    return found if found.status == "converged" else None


# Parts of the squares of a time history that a span holds, of which the first that leaves nothing is the event; and the
# part of all time that it may take.
_PARTS, _LONGEST = (0.7, 0.85, 0.95), 0.15
# Part of the misfit that the records without the span may have: an event is most of what is wrong with them.
_LEFT = 0.5
# Samples of a record before or after the span that are worth an estimation of initial states, and iterations of it.
_SAMPLES, _ITERATIONS = 30, 60
# Seconds that a fit by the filter-error method may take.
_SECONDS = 10.0


def single_event(
    cache: RefitCache, at: Refit, of: Disturbance, structure: float, margin: float
) -> tuple[Disturbance | None, bool]:
    """Return a disturbance as an event, None where it is none or happens all the time; and whether that is known, from
    records without the span of the event.

    ``structure``, ``margin``: what a disturbance must explain, and gain over coloured noise, to be one.
    """
    known = False
    for part in _PARTS:
        event = _shortest(of, part)
        if event is None or event.span is None or not _is_short(event.span, at):
            break
        without = _without(at, event.span)
        if without is None:
            continue
        known = True
        if is_disturbed(without, of, structure, margin) or _misfit(without, at) > _LEFT * _misfit(at, at):
            continue
        if not cache.validation or not _in_validation(cache, without, of, structure, margin):
            return event, True
    return None, known


def _misfit(of: Refit, at: Refit) -> float:
    """Return the mean squares of residuals that are not noise, in units of the noise that they had at a refit, summed
    over the outputs."""
    mine, noise = Misfitting.of(of.linear), Misfitting.of(at.linear)
    return float(np.sum(mine.powers * mine.parts / np.maximum(noise.powers * (1.0 - noise.parts), 1e-300)))


def is_disturbed(at: Refit, of: Disturbance, structure: float, margin: float) -> bool:
    """Return whether residuals have structure, and more as a disturbance there than as coloured noise, to first
    order or by the filter-error method."""
    histories = histories_at(at, of.place) if is_structured(at, structure) else []
    if not histories:
        return False
    if histories[0].merit > at.merit + margin:
        return True
    asked = filtered(at, histories[0], _SECONDS) if at.together is not None else None
    return asked is not None and asked.merit > at.merit + margin


def _in_validation(cache: RefitCache, without: Refit, of: Disturbance, structure: float, margin: float) -> bool:
    """Return whether data held out have the disturbance, too, by the parameters of records without the event."""
    try:
        linear = on_other_data(without, cache.validation, None, cache.biases)
    except PhugoidError:
        return False
    return is_disturbed(Refit(without.candidates, linear.fit), of, structure, margin)


def _shortest(of: Disturbance, part: float) -> Disturbance | None:
    """Return a disturbance within the shortest span of one record that holds a part of its squares, a knot more on
    either side."""
    best: tuple[int, int, int] | None = None
    total, first = part * float(np.sum(of.values**2)), 0
    for record, n in enumerate(of.counts):
        sums = np.concatenate([[0.0], np.cumsum(of.values[first : first + n] ** 2)])
        ends = np.searchsorted(sums, sums[:-1] + total)
        lengths = np.where(ends <= n, ends - np.arange(n), 2 * of.knots.size)
        k = int(np.argmin(lengths))
        if lengths[k] < 2 * of.knots.size and (best is None or lengths[k] < best[2] - best[1]):
            best = record, first + k, first + k + int(lengths[k])
        first += n
    if best is None:
        return None
    record, begin, end = best
    ends_of = np.cumsum(of.counts)
    begin = max(begin - 1, int(ends_of[record] - of.counts[record]))
    end = min(end + 1, int(ends_of[record]))
    span = record, float(of.knots[begin]), float(of.knots[end - 1])
    marginal = replace(
        of.marginal,
        coefficients=of.marginal.coefficients[begin:end],
        deviations=of.marginal.deviations[begin:end],
    )
    return replace(of, kind="event", span=span, knots=of.knots[begin:end], marginal=marginal, counts=())


def _is_short(span: tuple[int, float, float], at: Refit) -> bool:
    return span[2] - span[1] < _LONGEST * sum(float(p.t[-1] - p.t[0]) for p in at.linear.points)


def _without(at: Refit, span: tuple[int, float, float]) -> Refit | None:
    """Return the model estimated from the records without a span, each with initial states of its own; None where that
    is not possible."""
    check_time()
    fit, (record, begin, end) = at.fit, span
    if fit.model.end_conditions or any(p.per_experiment for p in fit.model.declared_parameters.values()):
        return None
    records: list[Experiment] = list(dataset(fit))
    records[record : record + 1] = _parts(records[record], begin, end)
    return fitted_to(at, records, start=values_of(fit), solver=Newton(max_iterations=_ITERATIONS))


def _parts(e: Experiment, begin: float, end: float) -> Sequence[Experiment]:
    """Return what a record has before a span and after it, where that is long enough."""
    before, after = e.t[e.t < begin], e.t[e.t > end]
    parts = [(p, name) for p, name in ((before, "before"), (after, "after")) if p.size >= _SAMPLES]
    return [e.window(p[0], p[-1], name=f"{e.name}, {name}") for p, name in parts]
