"""Laws of a variable that the records do not distinguish from that of the model: dry friction from viscous, say.

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
from ...errors import PhugoidError
from ...fit_result import dataset
from ...sensitivities.linearised import Linearised
from ...solvers import Newton
from ..candidates.candidate import Candidate, Effect, is_function
from ..candidates.terms import where
from . import Search
from .evidence import is_physical
from .free_run import Misfitting, Simulated
from .refit import Refit, fitted_to, on_other_data, started_from

__all__ = ["OtherLaw", "other_laws", "words_of_laws"]

# Part of what the extended model explains of a misfit that it explains with the other law; and the least of that, for
# where little is explained both laws are wrong.
_AS_MUCH, _MOST = 0.95, 0.5
# Part of an effect that the model's parameters cannot imitate, below which one of them may stand for it.
_NEAR = 0.2
# Cosine between a law and a linear one beyond which it may take its place: an even function never does.
_LIKE = 0.7
# Other laws that are fitted.
_TRIED = 4
# Iterations of each: a friction that jumps takes three times those of a smooth law.
_ITERATIONS = 150


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
            f"Records in which {variable} has several sizes would tell."
        )
    return words


def other_laws(search: Search, final: Refit) -> list[OtherLaw]:
    """Return functions of one variable that explain as much in place of a parameter whose term is linear in it: those
    that were tried when the time was up or Ctrl-C was pressed."""
    found: list[OtherLaw] = []
    try:
        options = _options(search, final) if final.candidates else []
        own = _explained(search, final) if options else 0.0
        if own < _MOST:
            return []
        needless = {p for p in {p for _, p in options} if _stands(search, _in_place(final, None, p), own)}
        for c, parameter in [(c, p) for c, p in options if p not in needless][:_TRIED]:
            other = _in_place(final, c, parameter)
            if other is not None and is_physical(other, c) and _stands(search, other, own):
                found.append(OtherLaw(c, parameter, c.variables[0], other.parameters(c)))
    except KeyboardInterrupt:
        pass
    return found


def _stands(search: Search, other: Refit | None, own: float) -> bool:
    return other is not None and _explained(search, other) > _AS_MUCH * own


def _options(search: Search, final: Refit) -> list[tuple[Effect, str]]:
    """Return candidates that a parameter nearly imitates and that are shaped like its term, the most alike first; and
    that parameter."""
    known = [c for c in search.cache.candidates if isinstance(c, Effect) and is_function(c)]
    known = list({c.name: c for c in reversed(known) if c.name not in final.names}.values())
    options = [(c, p) for c in known for p in _linear_in(final, c)]
    if not options:
        return []
    scan = search.cache.scan(final)
    distinct: dict[str, float] = dict.fromkeys(scan.lost, 0.0)
    for (c, _), each in zip(scan.effects, scan.distinct.tolist(), strict=True):
        distinct[c.name] = max(each, distinct.get(c.name, 0.0))
    likeness = {c.name: _likeness(final, c) for c, _ in options}
    options = [(c, p) for c, p in options if likeness[c.name] > _LIKE and distinct.get(c.name, 1.0) < _NEAR]
    return sorted(options, key=lambda option: -likeness[option[0].name])


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
    solver = Newton(max_iterations=_ITERATIONS)
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
