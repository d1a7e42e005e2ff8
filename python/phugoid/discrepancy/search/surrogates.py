"""Named terms that are surrogates of something that no candidate describes, and whether residuals are a motion that the
model does not have, or noise of a sensor.

Of a misfit that has its cause outside of all candidates, the nearest of some hundred explains a part, significantly,
and data held out confirm that part. It is distinguished from a cause by the remaining residuals. Beside a cause they
are noise, or another cause is found; beside a surrogate they are a motion that the model does not have, larger than
what it explains.

A surrogate may fit the records as well as the cause does, and only differ from it where data held out have another
amplitude or another frequency: |u|u and u^3, or a lag and a delay. It shows when it is estimated from all records
together. Then its coefficient moves by more than its standard error allows, or any function of its variable is
likelier, or residuals that passed for noise in the records have structure.

A motion persists over the time in which the vehicle itself hardly moves, noise of a sensor does not. The prediction
from one sample to the next says less: of two records of one motion that with more samples is the better predicted,
and so is its noise where that is coloured. A lag in seconds, which follows from the fitted motion, is the same at any
sampling rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...fit_result import dataset
from ...residual_noise import UniformSegment
from ..candidates.candidate import Candidate, Effect, is_function
from . import Search, SearchResult
from .confirmation import Found
from .disturbance import Disturbance, Disturbances, functions_of, likeliest_function
from .free_run import Explained, Misfitting, Simulated
from .refit import Refit, fitted_to, is_structured, values_of
from .remainder import Remainder

__all__ = [
    "CONTRADICTED",
    "DIFFERS",
    "HARMS",
    "LEAVES_MORE",
    "SurrogateSettings",
    "is_motion",
    "missing_in_all",
    "persistence",
    "with_held_out",
    "without_surrogates",
]


_Array = NDArray[np.float64]

LEAVES_MORE = (
    "the remaining residuals are not noise and exceed what it explains with certainty, so that it may represent an "
    "effect that no candidate describes"
)
DIFFERS = (
    "estimated with the data held out it is different, or does not describe both, so that it may represent an effect "
    "of about this shape that no candidate describes"
)
CONTRADICTED = (
    "with it the data held out are predicted worse, beside the other causes, and it explains the lesser part of the "
    "misfit, so that it may represent an effect that no candidate describes"
)
HARMS = (
    "with it some outputs of the data held out are predicted worse beyond chance, by more than half of what it "
    "explains in all, so that it may represent an effect that no candidate describes"
)
"""Why a term is a surrogate, in words."""

# Of the autocorrelation of a fitted output what it loses over the lag: a sine loses that in a sixth of a radian.
_LOST = 0.015


def is_motion(at: Refit, least: float) -> bool:
    """Return whether the residuals of any output persist so much, above the resolution of its sensor."""
    linear = at.linear
    for name, line, lasting in zip(linear.model.output_names, linear.rows, persistence(at), strict=True):
        power = float(np.mean(linear.residuals[line[0].start : line[-1].stop] ** 2))
        if power > linear.rounding[name] ** 2 and lasting > least:
            return True
    return False


def persistence(at: Refit) -> list[float]:
    """Return the autocorrelation of each output's residuals over a lag in which the fitted output keeps 98.5 %."""
    linear = at.linear
    return [
        _autocorrelation(linear.residuals, segments, _lag(at, name))
        for name, segments in zip(linear.model.output_names, linear.structure.segments, strict=True)
    ]


def _lag(at: Refit, output: str) -> float:
    """Return the lag, s, after which a fitted output differs from itself by so much; infinite where it never does."""
    records = at.fit.records
    step = min(float(np.median(np.diff(r.t))) for r in records)
    paths = [np.interp(np.arange(r.t[0], r.t[-1], step), r.t, r.outputs[output]) for r in records]
    spread = float(np.concatenate(paths).var())
    before = 0.0
    for k in range(1, max(p.size for p in paths)):
        change = np.concatenate([p[k:] - p[:-k] for p in paths if p.size > k])
        lost = float(np.mean(change**2)) / (2.0 * spread) if spread > 0.0 else 0.0
        if lost > _LOST:
            share = (_LOST - before) / (lost - before)
            return step * (k - 1 + share if k > 1 else float(np.sqrt(share)))
        before = lost
    return float("inf")


def _autocorrelation(residuals: _Array, segments: Sequence[UniformSegment], lag: float) -> float:
    """Return the autocorrelation of residuals (n_rows,) about zero over a lag, s: between whole numbers of steps by a
    straight line; within the first step by a parabola through the first two, for that of a motion begins so."""
    step = max(s.step for s in segments)
    steps = min(lag / step, max(s.size for s in segments) / 4.0)
    if steps < 1.0:
        one, two = (_at_lag(residuals, segments, k) for k in (1, 2))
        return one + (one - two) / 3.0 * (1.0 - steps**2)
    whole = int(steps)
    near, far = (_at_lag(residuals, segments, k) for k in (whole, whole + 1))
    return near + (steps - whole) * (far - near)


def _at_lag(residuals: _Array, segments: Sequence[UniformSegment], steps: int) -> float:
    """Return the autocorrelation at a number of steps, of all segments together."""
    grids = [s.on_grid(residuals[s.rows]) for s in segments]
    products = np.concatenate([np.zeros(0), *(g[steps:] * g[: g.size - steps] for g in grids if g.size > steps)])
    products = products[np.isfinite(products)]
    power = float(np.nanmean(np.concatenate(grids) ** 2))
    return float(products.mean()) / power if products.size and power > 0.0 else 0.0


@dataclass(frozen=True)
class SurrogateSettings:
    """Set what terms must explain beside residuals that are error of the model.

    most        part of the misfit that all named terms explain together beyond doubt, else something else is larger.
    sure        part of it that one term explains beyond doubt, beside which a likelier description of the rest is no
                better answer.
    persistent  autocorrelation of an output's residuals over a lag in which the output itself hardly moves, from which
                on they are a motion rather than noise of a sensor (`persistence`).
    whole       part of the misfit of data held out that terms explain, from which on they are not compared with it
                further.
    deviation   standard errors by which a parameter of a term may change when data held out are added.
    margin      log-likelihood, less the number of its parameters, by which any function of a term's variable may be
                ahead of it on all records, and any function that is missing beside all terms.
    more        part of what a term explains that such a change, or such a function, may explain beside it: no record is
                without another misfit.
    structure   part of the residuals' power that their past predicts, below which they pass for noise.
    harm        part of what a term explains by which it may make some outputs worse.
    """

    most: float = 0.5
    sure: float = 0.8
    persistent: float = 0.94
    whole: float = 0.9
    deviation: float = 4.0
    margin: float = 8.0
    more: float = 0.1
    structure: float = 0.05
    harm: float = 0.5


def without_surrogates(
    search: Search, result: SearchResult, remainder: Remainder | None, settings: SurrogateSettings | None = None
) -> tuple[SearchResult, Remainder | None]:
    """Return a search's result with terms that stand in for something else listed as surrogates, and in the full model
    alone; and what is left, but for a random disturbance that was found beside such terms: what these stand in for is
    in it."""
    s, final = settings or SurrogateSettings(), result.final
    named = [f for f in result.found if f.candidate is not None and f.candidate.name in final.names]
    if not named:
        return result, remainder
    lost = {c.name: LEAVES_MORE for c in _outweighed(search, result, named, remainder, s)}
    differing, curve = _differing(search, final, s)
    lost |= {c.name: DIFFERS for c in differing}
    lost |= {f.candidate.name: HARMS for f in named if f.candidate is not None and _harms(f, s)}
    lost |= {f.candidate.name: CONTRADICTED for f in named if f.candidate is not None and _is_contradicted(f, s)}
    if not lost:
        return result, remainder
    kept = search.cache.refit([c for c in final.candidates if c.name not in lost], final.fit)
    if remainder is not None and remainder.is_noise and not lost.keys().isdisjoint(remainder.at.names):
        remainder = None
    final = kept or search.cache.base
    return replace(result, final=final, surrogates={**result.surrogates, **lost}), remainder or curve


def _outweighed(
    search: Search, result: SearchResult, named: Sequence[Found], remainder: Remainder | None, s: SurrogateSettings
) -> list[Candidate]:
    """Return the terms that leave more of the misfit, as a motion, than they explain."""
    unknown = remainder is not None and remainder.is_unknown
    if not (unknown or is_motion(result.final, s.persistent)):
        return []
    together = search.assessment.explained(search.cache.base, result.final)
    doubtful = together is None or together.interval[0] < s.most
    # A function that has no name is the better part of the answer where it is so much likelier.
    gain = remainder.gain if remainder is not None and unknown else -np.inf
    return [
        f.candidate
        for f in named
        if f.candidate is not None
        and ((doubtful and not _of_its_own(f, s.most)) or (f.gain < gain and not _is_sure(f, s.sure)))
    ]


def _differing(search: Search, final: Refit, s: SurrogateSettings) -> tuple[list[Candidate], Remainder | None]:
    """Return the terms that data held out ask to be different, and the function that is likelier than one of them."""
    cache = search.cache
    if not cache.validation or not all(c.transferable for c in final.candidates):
        return [], None
    together = search.assessment.explained(cache.base, final)
    if together is None or together.part >= s.whole:
        return [], None
    cache.watch("comparing what was found with all records together")
    every = with_held_out(search, final)
    if every is None:
        return [], None
    likelier = _likelier_shapes(search, every, together, s)
    found = [c for c in final.candidates if c.name in likelier or _has_changed(final, every, c, s)]
    if not found and not is_structured(final, s.structure) and is_structured(every, s.structure):
        found = list(final.candidates)
    if not likelier:
        return found, None
    name, most = max(likelier.items(), key=lambda each: each[1].merit)
    (candidate,) = (c for c in final.candidates if c.name == name)
    return found, Remainder(_beside(every, candidate, most), every, most.merit - every.merit, float("nan"))


def with_held_out(search: Search, at: Refit) -> Refit | None:
    """Return the model of a refit estimated from the records and the data held out together; what is estimated again
    on other data has a value in each. None where there is no such fit."""
    model = at.fit.model
    declared = model.declared_parameters
    own = [n for n in search.cache.estimated_again(at) if n in declared]
    each = model.with_parameters({n: replace(declared[n], per_experiment=True) for n in own})
    data = [*dataset(at.fit), *search.cache.validation]
    return fitted_to(at, data, model=each, start=values_of(at.fit))


@dataclass(frozen=True, eq=False)
class MissingInAll:
    """Hold a ``function`` that is missing where the model is estimated from all records together, its ``gain`` in
    log-likelihood, and the model diagnosed, estimated from them: ``base``."""

    function: Disturbance
    gain: float
    base: Refit


def missing_in_all(search: Search, at: Refit, settings: SurrogateSettings | None = None) -> MissingInAll | None:
    """Return the function that is missing beside the terms of a refit where the model is estimated from the records and
    the data held out together, of any variable in any place; None where none is likelier than coloured noise by a
    margin, or where it explains no more than a minor part of the misfit.

    What fits the records and predicts the data held out to within their noise may still be another effect: with twice
    the data, and another range of motion, its shape shows. A cause that was found rightly leaves nothing.
    """
    s, every = settings or SurrogateSettings(), with_held_out(search, at)
    if every is None:
        return None
    known = Disturbances(search.cache.base.fit.model).known
    first = max(functions_of(every, known), key=lambda h: h.merit, default=None)
    if first is None or first.merit < every.merit + s.margin:
        return None
    base = with_held_out(search, search.cache.base)
    if base is None or _part_of(first, every, base) < search.assessment.settings.minor:
        return None
    return MissingInAll(first, first.merit - every.merit, base)


def _part_of(function: Disturbance, at: Refit, base: Refit) -> float:
    """Return the part of the misfit of a base that a function explains beside the terms of a refit to the same
    records."""
    more = Simulated.of(at.linear, function.marginal.residuals)
    return more.explained(Simulated.of(at.linear), Misfitting.of(base.linear)).part


def _has_changed(before: Refit, after: Refit, candidate: Candidate, s: SurrogateSettings) -> bool:
    """Return whether a parameter of a candidate differs between two fits by more than its standard error allows, and by
    so much that the square of its effect matters."""
    known, change = after.fit.parameters, math.sqrt(s.more)
    values = {n: each for n, each in before.parameters(candidate).items() if n in known}
    return any(abs(known[n].value - v) > max(s.deviation * e, change * abs(v)) for n, (v, e) in values.items())


def _likelier_shapes(search: Search, at: Refit, together: Explained, s: SurrogateSettings) -> dict[str, Disturbance]:
    """Return, by the name of a term, the function of its variable that is likelier beside it, in its place, and
    explains much."""
    terms = [c for c in at.candidates if isinstance(c, Effect) and is_function(c)]
    every = {c.name: likeliest_function(at, c.place, c.variables) for c in terms}
    ahead = {n: h for n, h in every.items() if h is not None and h.merit >= at.merit + s.margin}
    base = with_held_out(search, search.cache.base) if ahead else None
    if base is None:
        return {}
    return {n: h for n, h in ahead.items() if _part_of(h, at, base) > s.more * together.part}


def _beside(at: Refit, candidate: Candidate, rest: Disturbance) -> Disturbance:
    """Return the function that a candidate and what is missing beside it make together."""
    assert isinstance(candidate, Effect)
    fit, points = at.fit.parameters, at.linear.points
    (name,), size = candidate.variables, fit[candidate.coefficients[0]].value if candidate.coefficients else 1.0
    shape = {n: fit[n].value for n in candidate.shape_names}
    x = np.concatenate([p.values[name] for p in points])
    y = np.concatenate([candidate.signals(p, shape)[0] for p in points])
    order = np.argsort(x)
    values = rest.values + size * np.interp(rest.knots, x[order], y[order])
    return replace(rest, marginal=replace(rest.marginal, coefficients=values))


def _is_contradicted(found: Found, s: SurrogateSettings) -> bool:
    """Return whether data held out are predicted worse with a term, by more than chance, and it explains the lesser
    part of the misfit."""
    gain, explained = found.held_out, found.explained
    return explained is not None and gain.gain < -gain.deviation and explained.part < s.most


def _harms(found: Found, s: SurrogateSettings) -> bool:
    """Return whether a term makes outputs of data held out worse by much of what it explains in all."""
    explained = found.explained
    return explained is not None and explained.harm > s.harm * explained.part


def _is_sure(found: Found, sure: float) -> bool:
    return found.explained is not None and found.explained.interval[0] >= sure


def _of_its_own(found: Found, most: float) -> bool:
    """Return whether a term of one output explains that much of the misfit there: what is wrong with the others is no
    business of a sensor's."""
    c = found.candidate
    if c is None or c.place.kind != "output" or found.explained is None:
        return False
    return found.explained.outputs.get(c.place.name, 0.0) >= most
