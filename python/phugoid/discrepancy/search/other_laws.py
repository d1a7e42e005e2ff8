"""Laws of a variable that the records do not distinguish from that of the model (dry friction from viscous, say), and a
missing term that no name fits, as a smooth function of one variable or two: fitted with the model, as a table.

Where a motion has about one speed all the time, friction in proportion to the speed and friction that does not depend
on it are the same but for a factor. A term that is added to the model has nothing to explain then, since a parameter
does it already; in place of that parameter it may explain the records as well. Neither is known to be the cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import PhugoidError, joined
from ...fit_result import FitResult, dataset
from ...parameters import Estimates
from ...sensitivities import Place
from ...sensitivities.linearised import Linearised
from ...solvers.newton import Newton
from ..candidates.candidate import Candidate, Effect, is_function
from ..candidates.scales import Scales
from ..candidates.terms import tabulated, where
from . import Search, SearchResult
from .admissibility import is_physical
from .disturbance import Disturbance, hats, likeliest_function
from .free_run import Explained, Misfitting, Simulated
from .refit import Refit, fitted_to, on_other_data, refit, started_from
from .segments import short_segments

__all__ = [
    "OtherLaw",
    "UnknownFunction",
    "formula",
    "other_laws",
    "terms_of",
    "unknown_function",
    "words_of_laws",
]

# Part of what the extended model explains of a misfit that it explains with the other law; and the least of that, for
# where little is explained both laws are wrong.
_AS_MUCH, _MOST = 0.95, 0.5
# To first order so many times that much may be lost: what follows then is a fit.
_DOUBT = 4.0
# Part of an effect that the model's parameters cannot imitate, below which one of them may stand for it.
_NEAR = 0.2
# Cosine between a law and a linear one beyond which it may take its place: an even function never does.
_LIKE = 0.7
# Other laws that are fitted.
_TRIED = 4
# Iterations of each: a friction that jumps takes three times those of a smooth law. And seconds, or times of the base
# fit: what takes longer diverges, since another law that is kept is near.
_ITERATIONS, _SECONDS, _TIMES = 150, 2.0, 10.0


@dataclass(frozen=True)
class OtherLaw:
    """A candidate that explains as much in place of a parameter, the coefficient of a term linear in the variable.

    values   of the candidate's parameters: estimate and standard error.
    """

    candidate: Candidate
    parameter: str
    variable: str
    values: dict[str, tuple[float, float]]

    @property
    def estimates(self) -> str:
        """The values in words."""
        return ", ".join(f"{name} = {value:.3g} ± {error:.1g}" for name, (value, error) in self.values.items())


def words_of_laws(laws: Sequence[OtherLaw]) -> list[str]:
    """Return a sentence for each parameter in whose place other laws explain as much."""
    words = []
    for parameter in dict.fromkeys(law.parameter for law in laws):
        same = [law for law in laws if law.parameter == parameter]
        place, variable = where(same[0].candidate.place), same[0].variable
        each = " or ".join(f"{law.candidate.name} ({law.estimates})" for law in same)
        words.append(
            f"How {place} depends on {variable} is not determined: in place of {parameter}, {each} explains as much. "
            f"Records with several amplitudes of {variable} would determine it."
        )
    return words


def other_laws(search: Search, final: Refit) -> list[OtherLaw]:
    """Return functions of one variable that explain as much in place of a parameter whose term is linear in it: those
    that were tried when the time was up or Ctrl-C was pressed."""
    found: list[OtherLaw] = []
    try:
        options, distinct = _options(search, final) if final.candidates else ([], {})
        own = _explained(search, final) if options else 0.0
        if own < _MOST:
            return []
        # Of a parameter whose loss alone would be as much as all that is explained nothing else stands in its place.
        allowed = _DOUBT * (1.0 - _AS_MUCH) * _removed(search.cache.base, final)
        losses = {p: _loss(final, p) for p in {p for _, p in options}}
        options = [(c, p) for c, p in options if distinct[c.name] ** 2 * losses[p] < allowed]
        few = [p for p in dict.fromkeys(p for _, p in options) if losses[p] < allowed]
        needless = {p for p in few if _stands(search, _in_place(final, None, p), own)}
        for c, parameter in [(c, p) for c, p in options if p not in needless][:_TRIED]:
            other = _in_place(final, c, parameter)
            if other is not None and is_physical(other, c) and _stands(search, other, own):
                found.append(OtherLaw(c, parameter, c.variables[0], other.parameters(c)))
    except KeyboardInterrupt:
        pass
    return found


def _stands(search: Search, other: Refit | None, own: float) -> bool:
    return other is not None and _explained(search, other) > _AS_MUCH * own


def _removed(base: Refit, final: Refit) -> float:
    """Return how much less the sum of squares of the residuals is with all that was found, in units of the noise."""
    before, after = base.rms, final.rms
    counts, sigmas = final.linear.counts, final.linear.sigmas
    names = final.fit.model.output_names
    return float(
        sum(n * (before[y] ** 2 - after[y] ** 2) / s**2 for n, s, y in zip(counts, sigmas, names, strict=True))
    )


def _loss(at: Refit, parameter: str) -> float:
    """Return by how much the sum of squares of the residuals grows without a parameter, to first order, in units of the
    noise."""
    estimate = at.fit.parameters[parameter]
    error = estimate.std_error if np.isfinite(estimate.std_error) else 0.0
    return float((estimate.value / error) ** 2) if error > 0.0 else 0.0


def _options(search: Search, final: Refit) -> tuple[list[tuple[Effect, str]], dict[str, float]]:
    """Return candidates that a parameter nearly imitates and that are shaped like its term, the most alike first, each
    with that parameter; and the part of their effects that the parameters cannot imitate."""
    known = [c for c in search.cache.candidates if isinstance(c, Effect) and is_function(c)]
    known = list({c.name: c for c in reversed(known) if c.name not in final.names}.values())
    options = [(c, p) for c in known for p in _linear_in(final, c)]
    if not options:
        return [], {}
    scan = search.cache.scan(final)
    distinct: dict[str, float] = dict.fromkeys(scan.lost, 0.0)
    for (c, _), each in zip(scan.effects, scan.distinct.tolist(), strict=True):
        distinct[c.name] = max(each, distinct.get(c.name, 0.0))
    likeness = {c.name: _likeness(final, c) for c, _ in options}
    options = [(c, p) for c, p in options if likeness[c.name] > _LIKE and distinct.get(c.name, 1.0) < _NEAR]
    return sorted(options, key=lambda option: -likeness[option[0].name]), distinct


def _likeness(at: Refit, c: Effect) -> float:
    """Return the cosine of the angle between a candidate's signal and its variable."""
    signal, x = _signals(at, c)
    return abs(float(signal @ x)) / max(float(np.linalg.norm(signal) * np.linalg.norm(x)), 1e-300)


def _signals(at: Refit, c: Effect) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a candidate's signal and its variable along the records, one after the other."""
    points = at.linear.points
    signals = [c.signals(p, {})[0] for p in points]
    return np.concatenate(signals), np.concatenate([p.values[c.variables[0]] for p in points])


def _linear_in(at: Refit, c: Effect) -> list[str]:
    """Return the free parameters that stand at the place of a candidate as the coefficient of its variable alone."""
    model, key = at.fit.model, (c.place.kind, c.place.name)
    e = model._right_hand_sides().get(key)
    if e is None or c.place.kind not in ("equation", "quantity"):
        return []
    added = {n for other in at.candidates for n in other.parameters}
    declared = model.declared_parameters
    free = [n for n, p in declared.items() if not (p.fixed or p.per_experiment or n in added) and n in e.symbols]
    return [n for n in free if _slope(e, n, c.variables[0])]


def _slope(e: Expr, parameter: str, variable: str) -> float:
    """Return s of a term s p x of an expression, with its parameter p and variable x; 0 where these stand otherwise."""
    return Expr(Expr(e.diff(parameter)).diff(variable)).constant or 0.0


def _in_place(at: Refit, c: Effect | None, parameter: str) -> Refit | None:
    """Return the model with a candidate, or nothing, in place of a parameter, which is 0; None where it cannot be
    fitted."""
    fit = at.fit
    declared = fit.model.declared_parameters[parameter]
    low, high = declared.bounds
    none = replace(declared, start=0.0, fixed=True, bounds=(min(low, 0.0), max(high, 0.0)))
    try:
        model = fit.model.with_parameters({parameter: none})
        if c is not None:
            signal, x = _signals(at, c)
            e = fit.model._right_hand_sides()[c.place.kind, c.place.name]
            slope = fit.parameters[parameter].value * _slope(e, parameter, c.variables[0])
            start = slope * float(signal @ x) / max(float(signal @ signal), 1e-300)
            model = c.extended(model, {c.coefficients[0]: start})
    except PhugoidError:
        return None
    as_before = started_from(fit, [n for n in fit.model.parameter_names if n != parameter])
    candidates = at.candidates if c is None else (*at.candidates, c)
    solver = Newton(max_iterations=_ITERATIONS, time_limit=max(_SECONDS, _TIMES * fit.time))
    return fitted_to(Refit(candidates, fit), dataset(fit), model=model, start=as_before, solver=solver)


def _explained(search: Search, at: Refit) -> float:
    """Return the part of the misfit of the model diagnosed that a refit explains, in data held out where there are any,
    else in the records."""
    base, elsewhere = search.cache.base, search.cache.on_validation(search.cache.base)
    if elsewhere is None:
        before, after = base.linear, at.linear
    else:
        try:
            before, after = elsewhere, on_other_data(at, search.cache.validation, None, search.cache.biases)
        except PhugoidError:
            return 0.0
    return _part(before, after)


def _part(before: Linearised, after: Linearised) -> float:
    return Simulated.of(after).explained(Simulated.of(before), Misfitting.of(before)).part


_Array = NDArray[np.float64]

# Rounds of estimating the function about a fit, and fitting the model with it; they end where one gains less than this.
_ROUNDS, _GAIN = 6, 1.0
# Parts of the step to what is missing that are tried: far from the fit it is not linear.
_STEPS = (1.0, 0.5, 0.2)
# Nodes of its table.
_NODES = 64
# Part of the misfit of data held out that it must explain beside a term in its place, by which it may be behind
# several, and what is much more.
_MORE, _SEVERAL, _MUCH = 0.01, 0.1, 0.2
# Part of it that a candidate must explain to be its formula.
_SIMPLER = 0.9
# Candidates that are tried in place of a function, and log-likelihood by which the function must be ahead of them.
_FORMULAS, _AHEAD = 6, 3.0
# Families of terms that a function of the same variable in the same place has in it.
_PARTS = ("linear", "own", "bias", "function")


@dataclass(frozen=True, eq=False)
class UnknownFunction:
    """A function of one variable or two that is missing.

    fitted      the model with it, in place of the terms that stood in for it.
    without     the same without the function.
    curve       the function, with standard deviations.
    unknowns    the effective number of its coefficients.
    gain        in log-likelihood with coloured noise, less ``unknowns``, over the terms that it replaces.
    explained   the part of the misfit that it explains in free simulation of data held out.
    """

    fitted: Refit
    without: Refit
    curve: Disturbance
    unknowns: float
    gain: float
    explained: Explained | None


def terms_of(at: Refit, place: Place, variables: Sequence[str]) -> list[Candidate]:
    """Return the terms of a refit that a function of variables stands for: functions of one of them anywhere, for a
    quantity and the equation that it is in are the same place, and linear ones at the place itself; of two variables,
    products of them there, too."""

    def is_part(c: Candidate) -> bool:
        if not isinstance(c, Effect) or not {*c.variables} <= {*variables}:
            return False
        return is_function(c) or (c.place == place and (c.family in _PARTS or len(c.variables) > 1))

    return [c for c in at.candidates if is_part(c)]


def unknown_function(
    search: Search, at: Refit, result: SearchResult, place: Place, variables: tuple[str, ...]
) -> UnknownFunction | None:
    """Return a function of one variable or two in a place, fitted with the model in place of the terms of a refit that
    are such functions; None where it cannot be fitted, or where what a search found explains as much of data held out.
    Its gain is over all that was found."""
    assess = search.assessment
    replaced = {c.name for c in terms_of(at, place, variables)}
    kept = [c for c in at.candidates if c.name not in replaced]
    without = search.cache.refit(kept, at.fit)
    if without is None:
        kept, without = [], search.cache.base
    search.cache.watch(f"fitting any function of {joined([*variables])} in {where(place)}")
    settled = _settled(search, without, place, variables)
    if settled is None:
        return None
    fitted, curve = settled
    # Beside the function others may be needless; of two variables that takes too long to ask.
    for c in kept if len(variables) == 1 else ():
        fewer = search.cache.refit([o for o in fitted.candidates[:-1] if o is not c], without.fit)
        if fewer is None:
            continue
        other = _settled(search, fewer, place, variables)
        if other is not None and assess.gain(other[0], fitted) < assess.needed(fitted, c):
            fitted, curve = other
    without = search.cache.refit(fitted.candidates[:-1], fitted.fit)
    if without is None:
        return None
    explained = assess.explained(without, fitted)
    if explained is None or assess.is_minor(explained) or not _is_better(search, result, without, fitted, variables):
        return None
    unknowns, full = curve.marginal.unknowns, result.full
    gain = fitted.merit - unknowns - full.merit + len(full.candidates) - len(fitted.candidates) + 1
    return UnknownFunction(fitted, without, curve, unknowns, gain, explained)


def _is_better(search: Search, result: SearchResult, without: Refit, fitted: Refit, variables: Sequence[str]) -> bool:
    """Return whether a function explains more of data held out than the named causes in whose place it is.

    No record is without a misfit beside its causes, and with little noise a function that follows all of it is likelier
    than any formula: a cause that simulates other data as well is the better answer.
    """
    assess, final = search.assessment, result.final
    lost = [c for c in final.candidates if c.name not in without.names]
    if not lost:
        return True
    # Linear terms of the variables belong to what stands for their function.
    functions_lost = [c for c in lost if isinstance(c, Effect) and c.variables and {*c.variables} <= {*variables}]
    more = assess.compared(without, final, fitted)
    if more is None or more.part > _MUCH:
        return True
    for c in lost:
        own = None if c in functions_lost else search.confirmation.explained(final, c)
        if own is not None and own.part > _MUCH:
            return False
    # Two terms of one variable stand for a function of it sooner than one.
    return more.part > -_SEVERAL if len(functions_lost) > 1 else more.significant and more.part > _MORE


def formula(search: Search, of: UnknownFunction) -> Refit | None:
    """Return the likeliest refit with a candidate that is a function of the same variable and explains as much as any
    function of it does, here and on data held out; None where there is none, or where there are two variables."""
    assess = search.assessment
    if len(of.curve.variables) != 1:
        return None
    (variable,) = of.curve.variables
    names = search.screen.functions(of.without, variable, of.fitted.own.filter, _FORMULAS)
    refits = search.cache.refits([[*of.without.candidates, c] for c in names], of.without.fit)
    least = of.fitted.merit - of.unknowns - _AHEAD

    def stands(r: Refit) -> bool:
        c, explained = r.candidates[-1], assess.explained(of.without, r)
        if r.merit - len(c.parameters) < least or not is_physical(r, c) or explained is None or of.explained is None:
            return False
        enough = explained.part > _SIMPLER * of.explained.part
        return enough and assess.gain(of.without, r) > assess.needed(r, c)

    return max((r for r in refits if r is not None and stands(r)), key=lambda r: r.merit, default=None)


def _settled(
    search: Search, without: Refit, place: Place, variables: tuple[str, ...]
) -> tuple[Refit, Disturbance] | None:
    """Return the likeliest refit with the function, and its curve; None where there is none."""
    first = likeliest_function(without, place, variables)
    if first is None:
        return None
    # Of one variable the table is finer than its nodes, for these may change from round to round.
    axes = (np.linspace(first.axes[0][0], first.axes[0][-1], _NODES),) if len(first.axes) == 1 else first.axes
    found = _refitted(search.cache.base.fit, without, replace(first, axes=axes, marginal=first.marginal_on(axes)))
    # Of two variables it may move the path far: about short segments of the records, where the path is nearly the
    # measured one, first order says more of it.
    near = short_segments(without) if len(variables) > 1 else None
    there = likeliest_function(near, place, variables) if near is not None else None
    if near is not None and there is not None:
        along = replace(there, axes=axes, marginal=there.marginal_on(axes))
        _, values = _refitted(near.fit, near, along) or (near, along.values)
        begun = replace(first, axes=axes, marginal=replace(along.marginal, coefficients=values))
        other = _refitted(search.cache.base.fit, without, begun)
        if other is not None and (found is None or other[0].merit > found[0].merit):
            found = other
    if found is None:
        return None
    best, values = found
    marginal = replace(first.marginal_on(axes), coefficients=values)
    return best, replace(first, knots=axes[0] if len(axes) == 1 else first.knots, axes=axes, marginal=marginal)


def _refitted(base: FitResult, without: Refit, of: Disturbance) -> tuple[Refit, _Array] | None:
    """Return the likeliest refit with a function, begun from its values at its nodes and bettered by what is missing
    beside it, round after round, and its values (k,) there; None where there is none."""
    scales = Scales.of(without.linear.points)
    starts = {n: without.fit.parameters[n].value for c in without.candidates for n in c.parameters}
    shape = [nodes.size for nodes in of.axes]

    def fitted(values: _Array, near: Refit) -> Refit | None:
        term = tabulated(of.place, of.variables, of.axes, values.reshape(shape), scales)
        (name,) = term.coefficients
        # The coefficient is 1 with every table.
        start = replace(near.fit, parameters=Estimates(e for n, e in near.fit.parameters.items() if n != name))
        return refit(base, [*without.candidates, term], {**starts, name: 1.0}, start)

    def factor(r: Refit) -> float:
        return r.fit.parameters[r.candidates[-1].coefficients[0]].value

    values = of.values
    best = fitted(values, without)
    if best is None:
        return None
    for _ in range(_ROUNDS):
        # About this fit: what it has already, and what is still missing. Noise like a random walk, as the residuals of
        # a fit that is far off are, would hide most of that: where it leaves nothing, white noise shows it.
        known = factor(best) * values
        missing = (likeliest_function(best, of.place, of.variables, white) for white in (False, True))
        steps = (m.marginal_on(of.axes).coefficients for m in missing if m is not None)
        tries = (known + part * more for more in steps for part in _STEPS)
        least, begun = best.merit + _GAIN, best
        found = next(((each, r) for each in tries if (r := fitted(each, begun)) and r.merit > least), None)
        if found is None:
            break
        values, best = found
    values = factor(best) * values
    # What parameters of the model do as well is not missing: the curve is easier to read without its linear part.
    for constant in (True, False):
        bent = values - _linear_part(without.linear, of, values, constant)
        other = fitted(bent, best)
        if other is not None and other.merit > best.merit - _GAIN:
            return other, factor(other) * bent
    return best, values


def _linear_part(linear: Linearised, of: Disturbance, values: _Array, constant: bool) -> _Array:
    """Return the part (k,) of the values of a function that is nearest to it along the records and linear in its
    variables, with a ``constant`` or without."""
    often = sum(hats([p.values[n] for n in of.variables], of.axes).sum(axis=1) for p in linear.points)
    nodes = [each.ravel() for each in np.meshgrid(*of.axes, indexing="ij")]
    plane = np.column_stack([np.ones(values.size), *nodes])
    weight = np.sqrt(often)
    found = np.linalg.lstsq(plane * weight[:, None], values * weight, rcond=None)[0]
    return np.asarray(plane[:, not constant :] @ found[not constant :])
