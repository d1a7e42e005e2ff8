"""A missing term that no name fits, as a smooth function of one variable: fitted with the model, as a table."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...parameters import Estimates
from ...sensitivities import Place
from ..candidates.candidate import Candidate, Effect, is_function
from ..candidates.scales import Scales
from ..candidates.terms import tabulated, where
from . import Search, SearchResult
from .disturbance import BENDS, Disturbance, functions
from .evidence import is_physical
from .free_run import Explained
from .refit import Refit, refit

__all__ = ["UnknownFunction", "formula", "terms_of", "unknown_function"]

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
_AS_MUCH = 0.9
# Candidates that are tried in place of a function, and log-likelihood by which the function must be ahead of them.
_FORMULAS, _AHEAD = 6, 3.0
# Families of terms that a function of the same variable in the same place has in it.
_PARTS = ("linear", "own", "bias", "function")


@dataclass(frozen=True, eq=False)
class UnknownFunction:
    """A function of one variable that is missing.

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


def terms_of(at: Refit, place: Place, variable: str) -> list[Candidate]:
    """Return the terms of a refit that a function of a variable stands for: functions of it anywhere, for a quantity
    and the equation that it is in are the same place, and linear ones at the place itself."""

    def is_part(c: Candidate) -> bool:
        if not isinstance(c, Effect) or not {*c.variables} <= {variable}:
            return False
        return is_function(c) or (c.place == place and c.family in _PARTS)

    return [c for c in at.candidates if is_part(c)]


def unknown_function(
    search: Search, at: Refit, result: SearchResult, place: Place, variable: str
) -> UnknownFunction | None:
    """Return a function of a variable in a place, fitted with the model in place of the terms of a refit that are such
    functions; None where it cannot be fitted, or where what a search found explains as much of data held out. Its gain
    is over all that was found."""
    assess = search.assessment
    replaced = {c.name for c in terms_of(at, place, variable)}
    kept = [c for c in at.candidates if c.name not in replaced]
    without = search.cache.refit(kept, at.fit)
    if without is None:
        kept, without = [], search.cache.base
    search.cache.watch(f"fitting any function of {variable} in {where(place)}")
    fitted, curve = _settled(search, without, place, variable)
    if fitted is None:
        return None
    # Beside the function others may be needless.
    for c in kept:
        fewer = search.cache.refit([o for o in fitted.candidates[:-1] if o is not c], without.fit)
        if fewer is None:
            continue
        other, its = _settled(search, fewer, place, variable)
        if other is not None and assess.gain(other, fitted) < assess.needed(fitted, c):
            fitted, curve = other, its
    without = search.cache.refit(fitted.candidates[:-1], fitted.fit)
    if without is None:
        return None
    explained = assess.explained(without, fitted)
    if explained is None or assess.is_minor(explained) or not _is_better(search, result, without, fitted, variable):
        return None
    unknowns, full = curve.marginal.unknowns, result.full
    gain = fitted.merit - unknowns - full.merit + len(full.candidates) - len(fitted.candidates) + 1
    return UnknownFunction(fitted, without, curve, unknowns, gain, explained)


def _is_better(search: Search, result: SearchResult, without: Refit, fitted: Refit, variable: str) -> bool:
    """Tell whether a function explains more of data held out than the named causes in whose place it is.

    No record is without a misfit beside its causes, and with little noise a function that follows all of it is likelier
    than any formula: a cause that simulates other data as well is the better answer.
    """
    assess, final = search.assessment, result.final
    lost = [c for c in final.candidates if c.name not in without.names]
    if not lost:
        return True
    # Linear terms of the variable belong to what stands for its function.
    functions_lost = [c for c in lost if isinstance(c, Effect) and {*c.variables} == {variable}]
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
    function of it does, here and on data held out; None where there is none."""
    assess, (term,) = search.assessment, of.fitted.candidates[-1:]
    (variable,) = term.variables if isinstance(term, Effect) else ("",)
    names = search.screen.functions(of.without, variable, of.fitted.own.filter, _FORMULAS)
    refits = search.cache.refits([[*of.without.candidates, c] for c in names], of.without.fit)
    least = of.fitted.merit - of.unknowns - _AHEAD

    def stands(r: Refit) -> bool:
        c, explained = r.candidates[-1], assess.explained(of.without, r)
        if r.merit - len(c.parameters) < least or not is_physical(r, c) or explained is None or of.explained is None:
            return False
        enough = explained.part > _AS_MUCH * of.explained.part
        return enough and assess.gain(of.without, r) > assess.needed(r, c)

    return max((r for r in refits if r is not None and stands(r)), key=lambda r: r.merit, default=None)


def _settled(search: Search, without: Refit, place: Place, variable: str) -> tuple[Refit | None, Disturbance]:
    """Return the likeliest refit with the function, None where there is none, and its curve."""
    first = _likeliest(without, place, variable)
    nodes = np.linspace(first.knots[0], first.knots[-1], _NODES)
    values = np.interp(nodes, first.knots, first.values)
    deviations = np.interp(nodes, first.knots, first.marginal.deviations)
    scales, base = Scales.of(without.linear.points), search.cache.base.fit
    starts = {n: without.fit.parameters[n].value for c in without.candidates for n in c.parameters}

    def fitted(values: _Array, near: Refit) -> Refit | None:
        term = tabulated(place, variable, nodes, values, scales)
        (name,) = term.coefficients
        # The coefficient is 1 with every table.
        start = replace(near.fit, parameters=Estimates(e for n, e in near.fit.parameters.items() if n != name))
        return refit(base, [*without.candidates, term], {**starts, name: 1.0}, start)

    def factor(r: Refit) -> float:
        return r.fit.parameters[r.candidates[-1].coefficients[0]].value

    best = fitted(values, without)
    for _ in range(_ROUNDS if best is not None else 0):
        assert best is not None
        # About this fit: what it has already, and what is still missing.
        missing = _likeliest(best, place, variable)
        more = np.interp(nodes, missing.knots, missing.values)
        known = factor(best) * values
        tries = ((part, fitted(known + part * more, best)) for part in _STEPS)
        part, following = next(((p, r) for p, r in tries if r and r.merit > best.merit + _GAIN), (0.0, None))
        if following is None:
            break
        best, values = following, known + part * more
    values = values if best is None else factor(best) * values
    marginal = replace(first.marginal, coefficients=values, deviations=deviations)
    return best, replace(first, knots=nodes, marginal=marginal)


def _likeliest(at: Refit, place: Place, variable: str) -> Disturbance:
    return max(functions(at, place, [variable], BENDS), key=lambda h: h.merit)
