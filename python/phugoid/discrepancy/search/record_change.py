"""Parameters and offsets that differ from record to record: another mass, another trim, a sensor that was readjusted.

A model with one value for all records takes such a difference for a disturbance. Each parameter, a constant in each
equation and output, and the scale of each output are tried with a value for each record, beside the terms that a search
found and without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._core import Expr
from ...errors import PhugoidError
from ...fit_result import dataset
from ...goodness_of_fit import chi_square_quantile
from ...modelling.model import Model
from ...parameters import Parameter
from ...sensitivities import Place
from ...sensitivities.linearised import Linearised
from ...solvers.newton import Newton
from ..candidates.candidate import taken_names, unused
from ..candidates.model_structure import ModelStructure
from ..candidates.terms import where
from . import Search, SearchResult
from .evidence import AssessmentSettings
from .free_run import Explained, Misfitting, Simulated
from .refit import BLOCKS, Refit, blocks_of, fitted_to, is_structured

__all__ = ["RecordChange", "record_changes"]

_Array = NDArray[np.float64]

# Differences that are fitted, of those that explain most to first order; and those that are found one after the other.
_TRIED, _MOST = 4, 3
# Probability that any is found where there is none; log-likelihood by which they must be ahead of terms of the physics.
_FALSE_ALARM, _MARGIN = 0.01, 8.0
# Part of what is left of the misfit that they must explain, together and each: own values of each record fit a little
# of any misfit. What explains less than the last of the whole is not worth a name.
_PART, _EACH, _MINOR = 0.8, 0.2, AssessmentSettings.minor
# Places by how likely something differs there from record to record, where two explain the same.
_ORDER = ("parameter", "output", "input", "equation")
# Log-likelihood by which two are not distinguished.
_ALIKE = 2.0
_ITERATIONS = 60
# Part of the residuals' power that is predictable, from which on so many more are fitted, whatever first order says.
_ERROR, _MANY = 0.5, 12
# Of an option's effect on the outputs: below it parameters that are there can do the same.
_NOTHING = 1e-6
# Part of blocks left out that they must predict from the others, and the rank of their information.
_PREDICTED, _RANK = 0.3, 1e-6


@dataclass(frozen=True)
class _Difference:
    """What may differ: a parameter of the model, a constant at a place that has none, or the scale of an output."""

    place: Place
    parameter: str
    scale: bool = False

    @property
    def name(self) -> str:
        """Canonical, ``what:per_experiment``."""
        p = self.place
        at = f"{p.name}'" if p.kind == "equation" else p.name
        if p.kind == "parameter":
            return f"{at}:per_experiment"
        return f"{at}:{'scale' if self.scale else 'bias'}_per_experiment"

    def signals(self, linear: Linearised) -> list[_Array]:
        """Return (n, points) for each record: what is added at the place for a unit of each record's parameter."""
        n, found = len(linear.points), []
        for e, p in enumerate(linear.points):
            signal = np.zeros((n, p.n))
            signal[e] = p.outputs[self.place.name] if self.scale else 1.0
            found.append(signal)
        return found

    def in_model(self, model: Model, each: bool = True) -> Model:
        """Return the model with a value for each record, or with one for all."""
        if self.place.kind == "parameter":
            declared = model.declared_parameters[self.parameter]
            return model.with_parameters({self.parameter: replace(declared, per_experiment=each)})
        to = {"equation": f"{self.place.name}'", "output": f"y:{self.place.name}"}.get(self.place.kind, self.place.name)
        unit = "" if self.place.kind == "equation" or self.scale else model.units.get(self.place.name, "")
        new = Parameter(0.0, per_experiment=each, unit=unit)
        if self.scale:
            equations = model._right_hand_sides()
            key = ("output", self.place.name)
            equations[key] = Expr((1 + Expr.symbol(self.parameter)) * equations[key])
            return model._changed(parameters={self.parameter: new}, equations=equations)
        if self.place.kind == "input":
            u = Expr.symbol(self.place.name)
            shifted = {self.place.name: u + Expr.symbol(self.parameter)}
            equations = {key: Expr(e.substitute(shifted)) for key, e in model._right_hand_sides().items()}
            return model._changed(parameters={self.parameter: new}, equations=equations)
        return model.with_terms({to: Expr.symbol(self.parameter)}, {self.parameter: new})


@dataclass(frozen=True, eq=False)
class RecordChange:
    """A difference between records that was found.

    name       canonical: ``k:per_experiment``, ``x:bias_per_experiment``, ``x:scale_per_experiment``.
    parameter  of the model.
    aliases    names of others that the data do not distinguish from it.
    place      of the parameter or the constant.
    values     record -> value and standard error.
    unit       of these.
    gain       in log-likelihood with coloured noise, over the model without.
    threshold  that it had to pass.
    explained  the part of the misfit that it explains, in the records themselves.
    """

    name: str
    parameter: str
    aliases: tuple[str, ...]
    place: Place
    values: dict[str, tuple[float, float]]
    unit: str
    gain: float
    threshold: float
    explained: Explained

    @property
    def explanation(self) -> str:
        """What it says, in words."""
        part = "scale" if self.is_scale else "constant part"
        what = self.place.name if self.place.kind == "parameter" else f"the {part} of {where(self.place)}"
        return f"{what} differs from record to record"

    def beside(self, terms: Refit) -> RecordChange:
        """Return the same with the values that it has beside terms that were found after it."""
        return replace(self, values=_values(terms, self.parameter))

    @property
    def is_scale(self) -> bool:
        """Return whether it is the scale of a sensor."""
        return self.place.kind == "output" and ":scale_" in self.name


def record_changes(search: Search, result: SearchResult) -> tuple[Refit | None, list[RecordChange]]:
    """Return the base model with differences between records, fitted, and what these are.

    None where the terms that the search found are likelier, or nothing differs.
    """
    base, full = search.cache.base, result.full
    if len(dataset(base.fit)) < 2:
        return None, []
    best = -np.inf
    options: list[tuple[_Difference, tuple[str, ...]]] = []
    # The last terms of a search may be what stands for a difference beside the first ones.
    prefixes = (search.cache.refit(full.candidates[:k], full.fit) for k in range(1, len(full.candidates)))
    for at in [base, *(r for r in prefixes if r is not None), *([] if full is base else [full])]:
        found, chosen = _differing(at)
        unknowns = len(chosen) * (len(dataset(at.fit)) - 1)
        merit = found.merit - search.chances(at) - 0.5 * unknowns * float(np.log(at.linear.n_rows))
        if chosen and merit > best and _explained(at, at, found).part > _PART:
            best, options = merit, chosen
    # Minor findings and surrogates stand for something else: this may be it, if it is likelier than they are.
    final = result.final
    if best <= max(final.merit - search.chances(final) + _MARGIN, full.merit - search.chances(full)):
        return None, []
    current, changes = base, []
    for option, aliases in options:
        more = _with(current, option)
        # Beside those that were found much of what is left may be little of the misfit that is diagnosed.
        if more is None or _explained(base, _the_same(current, option), more).part < _MINOR:
            break
        changes.append(_change(search, current, more, option, aliases))
        current = more
    return (current, changes) if changes else (None, [])


def _threshold(unknowns: int, tries: int) -> float:
    return chi_square_quantile(unknowns, _FALSE_ALARM / tries) / 2.0


def _differing(at: Refit) -> tuple[Refit, list[tuple[_Difference, tuple[str, ...]]]]:
    """Differences that are each significant beside those before, the clearest first, each with its aliases, and the fit
    with all."""
    first, chosen = at, list[tuple[_Difference, tuple[str, ...]]]()
    while len(chosen) < _MOST:
        options = _options(at)
        ranked = _ranked(at.linear, options)
        tried = ranked[:_TRIED]
        if not chosen and is_structured(at, _ERROR):
            # Where one value for all is far from that of any record, first order says little of it.
            far = [o for o in options if o.place.kind == "parameter"] + [o for o in options if o.scale]
            tried += [o for o in dict.fromkeys([*ranked, *far]) if o not in tried][:_MANY]
        refits = [(r, o) for o in tried if (r := _with(at, o)) is not None]
        if not refits:
            break
        best = max(r.merit for r, _ in refits)
        alike = [pair for pair in refits if pair[0].merit > best - _ALIKE]
        # A parameter that the model has, before a sensor or an input, before an equation that is complete without it.
        following, option = min(alike, key=lambda pair: _ORDER.index(pair[1].place.kind))
        before = _the_same(at, option)
        needed = _threshold(len(dataset(at.fit)) - 1, len(options))
        if following.merit - before.merit < needed or _explained(at, before, following).part < _MINOR:
            break
        if _explained(before, before, following).part < _EACH:  # of what the same constant leaves
            break
        chosen.append((option, tuple(o.name for _, o in alike if o is not option)))
        start, at = at, following
        at, chosen = _pruned(first, at, chosen, needed)
        if at is not following and at.merit <= start.merit:  # back and forth
            break
    return at, chosen


def _pruned(
    first: Refit, at: Refit, chosen: list[tuple[_Difference, tuple[str, ...]]], needed: float
) -> tuple[Refit, list[tuple[_Difference, tuple[str, ...]]]]:
    """Return the fit and its differences without those that later ones have made needless."""
    for pair in chosen[:-1]:
        left = [other for other in chosen if other is not pair]
        without: Refit | None = first
        for option, _ in left:
            without = _with(without, option) if without is not None else None
        if without is not None and at.merit - without.merit < needed:
            return without, left
    return at, chosen


def _options(at: Refit) -> list[_Difference]:
    model, added = at.fit.model, {n for c in at.candidates for n in c.parameters}
    declared = model.declared_parameters
    found = [
        _Difference(Place("parameter", n), n)
        for n, p in declared.items()
        if not (p.fixed or p.per_experiment or n in added) and n in model.parameter_names
    ]
    taken = {*taken_names(model), *model.output_names}
    structure = ModelStructure(model)
    for place in structure.places:
        if place.kind in ("output", "equation"):
            found.append(_Difference(place, unused(f"bias_{place.name}", taken)))
        if place.kind == "output":
            found.append(_Difference(place, unused(f"scale_{place.name}", taken), scale=True))
    inputs = [v.symbol for v in structure.variables if v.kind == "input" and structure.used(v.symbol)]
    found += [_Difference(Place("input", n), unused(f"bias_{n}", taken)) for n in inputs]
    return [o for o in found if o.place in at.linear.places]


def _ranked(linear: Linearised, options: Sequence[_Difference]) -> list[_Difference]:
    """Options by the part of the residuals that differences explain to first order, white noise; those that do not
    predict blocks of the records from the others are left out."""
    scale = linear.scale()
    tangents = linear.tangents / scale[:, None]
    residuals = linear.residuals / scale
    gains = []
    for option in options:
        columns = (linear.answers(option.place, option.signals(linear)) / scale).T
        same = np.hstack([tangents, columns.sum(axis=1, keepdims=True)])
        basis = np.linalg.svd(same, full_matrices=False)[0]
        left = columns - basis @ (basis.T @ columns)
        u, sizes, _ = np.linalg.svd(left, full_matrices=False)
        seen = u[:, sizes > _NOTHING * max(float(np.linalg.norm(columns)), 1e-300)]
        gain = float(np.sum((seen.T @ residuals) ** 2)) if seen.shape[1] else 0.0
        predicted = _predicted(blocks_of(linear), same, columns, residuals) if gain else 0.0
        gains.append(gain if predicted > _PREDICTED else 0.0)
    order = np.argsort(gains)[::-1]
    return [options[i] for i in order if gains[i] > 0.0]


def _predicted(block: NDArray[np.intp], same: _Array, each: _Array, residuals: _Array) -> float:
    """Return the part of what columns explain of blocks, each fitted for itself, that is explained with the
    coefficients from the other blocks; all else is as it fits a block best. Noise that no columns explain does not
    count."""
    own_gain, predicted_gain, n = 0.0, 0.0, same.shape[1]
    for b in range(BLOCKS):
        inside = block == b
        both = np.hstack([same, each])
        coefficients = np.linalg.lstsq(both[~inside], residuals[~inside], rcond=_RANK)[0][n:]
        r = residuals[inside]
        before = _left(same[inside], r)
        own_gain += before - _left(both[inside], r)
        predicted_gain += before - _left(same[inside], r - each[inside] @ coefficients)
    return predicted_gain / max(own_gain, 1e-300)


def _left(columns: _Array, r: _Array) -> float:
    """Return the sum of squares that least squares with columns leave."""
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, sizes > _RANK * sizes[:1]]
    return float(np.sum((r - basis @ (basis.T @ r)) ** 2))


def _with(at: Refit, option: _Difference, each: bool = True) -> Refit | None:
    """Return the fit with a difference, or with the same value for all; None where the solver does not come to an end,
    or the data do not determine it."""
    fit = at.fit
    try:
        model = option.in_model(fit.model, each)
    except PhugoidError:
        return None
    solver = Newton(max_iterations=_ITERATIONS, time_limit=max(5.0, 20.0 * fit.time))
    return fitted_to(at, dataset(fit), model=model, solver=solver)


def _the_same(at: Refit, option: _Difference) -> Refit:
    """Return the fit with one value for all records, where that is the better one: it is no difference."""
    same = _with(at, option, each=False) if option.place.kind != "parameter" else None
    return same if same is not None and same.merit > at.merit else at


def _explained(of: Refit, before: Refit, after: Refit) -> Explained:
    """Return the part of the misfit of a fit that one explains and another does not, in the records themselves."""
    return Simulated.of(after.linear).explained(Simulated.of(before.linear), Misfitting.of(of.linear))


def _values(at: Refit, parameter: str) -> dict[str, tuple[float, float]]:
    """Return the value and standard error of a parameter in each record, with coloured noise."""
    names = {e.name: f"{parameter}[{e.name}]" for e in dataset(at.fit)}
    inflation = float(np.sqrt(max(at.own.inflation(n) for n in names.values())))
    found = {record: at.own.parameter(name) for record, name in names.items()}
    return {record: (float(value), float(error) * inflation) for record, (value, error) in found.items()}


def _change(search: Search, before: Refit, after: Refit, option: _Difference, aliases: tuple[str, ...]) -> RecordChange:
    values = _values(after, option.parameter)
    return RecordChange(
        option.name,
        option.parameter,
        aliases,
        option.place,
        values,
        after.fit.model.declared_parameters[option.parameter].unit,
        after.merit - before.merit,
        _threshold(len(values) - 1, len(_options(before))),
        _explained(search.cache.base, before, after),
    )
