"""Tests whether a disturbance is one event, of which the rest of the records, and data held out, are free.

An event and a stationary disturbance both explain a short burst. An event biases all parameters of the fit, so that
neither its own likelihood about that fit nor that of the noise says which of them it is. The parameters are
re-estimated from the records without the span instead: of an event nothing is left in them, of process noise all but
the span.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...fit_result import dataset
from ...solvers import Newton
from ...solvers.solution import check_time
from .disturbance import Disturbance, histories_at
from .evidence import is_structured
from .process_noise import filtered
from .refit import Refit, fitted_to, on_other_data, values_of
from .refit_cache import RefitCache

__all__ = ["is_disturbed", "single_event"]

# Parts of the squares of a time history that a span holds, of which the first that leaves nothing is the event; and the
# part of all time that it may take.
_PARTS, _LONGEST = (0.7, 0.85, 0.95), 0.15
# Samples of a record before or after the span that are worth an estimation of first states, and iterations of it.
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
        if is_disturbed(without, of, structure, margin):
            continue
        if not cache.validation or not _in_validation(cache, without, of, structure, margin):
            return event, True
    return None, known


def is_disturbed(at: Refit, of: Disturbance, structure: float, margin: float) -> bool:
    """Tell whether residuals have structure, and more as a disturbance there than as coloured noise, to first
    order or by the filter-error method."""
    histories = histories_at(at, of.place) if is_structured(at, structure) else []
    if not histories:
        return False
    if histories[0].merit > at.merit + margin:
        return True
    asked = filtered(at, histories[0], _SECONDS) if at.together is not None else None
    return asked is not None and asked.merit > at.merit + margin


def _in_validation(cache: RefitCache, without: Refit, of: Disturbance, structure: float, margin: float) -> bool:
    """Tell whether data held out have the disturbance, too, by the parameters of records without the event."""
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
    """Return the model estimated from the records without a span, each with first states of its own; None where that is
    not possible."""
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
