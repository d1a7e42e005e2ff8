"""A model of ours from the parts of a PEtab problem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .._core import Expr
from ..errors import ModelError
from ..modelling.model import Model
from ..noise.kinds import PerOutput
from ..noise.noise import Gaussian
from ..parameters import Parameter
from .conditions import Conditions
from .formulas import TIME, Formulas, substituted
from .measurements import Measurements, Output
from .sbml import SbmlModel

__all__ = ["NamedValues", "declared_parameters", "model_of", "prior_outputs"]


@dataclass
class NamedValues:
    """What stands for each name of the SBML model: constants, and all names at the beginning of a simulation."""

    sbml: SbmlModel
    conditions: Conditions
    table: Mapping[str, Expr]
    _done: dict[str, Expr] = field(default_factory=dict)

    def constant(self, name: str) -> Expr | None:
        """Return what stands for a constant in parameters and signals; None for what changes along a record."""
        if name in self.sbml.slopes or name in self.sbml.rules or name == TIME:
            return None
        return self.initial(name)

    def constants(self, expression: Expr) -> Expr:
        """Put in all constants of an expression."""
        found = {name: self.constant(name) for name in expression.symbols}
        return substituted(expression, {n: e for n, e in found.items() if e is not None})

    def initial(self, name: str, asked: tuple[str, ...] = ()) -> Expr:
        """Return the value of a name at the beginning, in parameters and signals."""
        if name in asked:
            raise ModelError(f"PEtab: the initial value of {name} depends on itself ({' -> '.join((*asked, name))})")
        if name not in self._done:
            said = self.conditions.values.get(name, self.table.get(name))
            if said is None:
                said = self.sbml.rules.get(name, self.sbml.initial.get(name))
            if said is None:
                self._done[name] = Expr.symbol(name)  # a parameter of the tables, a signal or a switch
            elif said.name == name:
                self._done[name] = said
            else:
                inner = {n: self.initial(n, (*asked, name)) for n in said.symbols if n != TIME}
                self._done[name] = substituted(said, inner)
        return self._done[name]


def declared_parameters(table: Any) -> tuple[dict[str, Parameter], dict[str, Expr]]:
    """Read a parameter table: the parameters that are estimated, starting at their nominal values, and what stands
    for each parameter, a symbol or a number."""
    found, values = {}, {}
    for name, row in table.iterrows():
        nominal = float(row.get("nominalValue", math.nan))
        if not int(row.get("estimate", 1)):
            if math.isnan(nominal):
                raise ModelError(f"PEtab: the parameter {name} is not estimated and has no nominal value")
            values[str(name)] = Expr(nominal)
            continue
        low, high = float(row["lowerBound"]), float(row["upperBound"])
        scale = str(row.get("parameterScale", "lin"))
        if not low < high:
            raise ModelError(f"PEtab: the bounds of {name} ({low:g}, {high:g}) leave no room")
        if scale not in ("lin", "log", "log10"):
            raise ModelError(f"PEtab: the parameter {name} has the unknown scale {scale}")
        logarithmic = scale != "lin" and low > 0.0
        middle = math.sqrt(low * high) if logarithmic else 0.5 * (low + high)
        start = middle if math.isnan(nominal) else min(max(nominal, low), high)
        found[str(name)] = Parameter(start, bounds=(low, high), transform="log" if logarithmic else None)
        values[str(name)] = Expr.symbol(str(name))
    return found, values


def prior_outputs(table: Any) -> dict[str, tuple[Output, float]]:
    """Read the priors of a parameter table as outputs that are measured once: name -> output and value.

    A normal prior on a parameter, or on its logarithm, is the density of such a measurement.
    """
    found = {}
    for name, row in table.iterrows():
        kind = row.get("objectivePriorType", None)
        if not int(row.get("estimate", 1)) or not isinstance(kind, str) or not kind.strip():
            continue
        if kind in ("uniform", "parameterScaleUniform"):
            continue
        scale = str(row.get("parameterScale", "lin")) if kind.startswith("parameterScale") else "lin"
        if kind not in ("normal", "laplace", "parameterScaleNormal", "parameterScaleLaplace"):
            raise ModelError(f"PEtab: the prior {kind} of {name} is not supported")
        mean, width = map(float, str(row["objectivePriorParameters"]).split(";"))
        p = Expr.symbol(str(name))
        on_scale = {"lin": p, "log": Expr(p.log()), "log10": Expr(p.log() / math.log(10.0))}[scale]
        label = f"prior_of_{name}"
        found[label] = (Output(label, on_scale, Expr(width), "aplace" in kind), mean)
    return found


def model_of(
    sbml: SbmlModel,
    values: NamedValues,
    formulas: Formulas,
    measured: Measurements,
    parameters: Mapping[str, Parameter],
) -> Model:
    """Return the model: dynamics, initial states, outputs and noise, with what is used of signals and parameters."""
    slopes = {n: values.constants(e) for n, e in sbml.slopes.items()}
    rules = {n: values.constants(e) for n, e in sbml.rules.items()}
    initial = {n: values.initial(n) for n in sbml.slopes}
    outputs = {n: values.constants(o.expression) for n, o in measured.outputs.items()}
    sigmas = {n: values.constants(o.sigma) for n, o in measured.outputs.items()}
    used = {s for e in (*slopes.values(), *initial.values(), *outputs.values(), *sigmas.values()) for s in e.symbols}
    for name in reversed(rules):
        if name in used:
            used |= set(rules[name].symbols)
    rules = {n: e for n, e in rules.items() if n in used}
    signals = {s for own in measured.columns.values() for s in own} | set(values.conditions.signals)
    signals |= {s.name for s in formulas.switches.values()}
    known = used & {*parameters, *signals, *sbml.slopes, *rules, TIME}
    if unknown := sorted(used - known):
        raise ModelError(f"PEtab: nothing says what {', '.join(unknown)} is")
    free = [n for n in sbml.slopes if initial[n].name == n]
    if free:
        raise ModelError(f"PEtab: the state {free[0]} has no initial value")

    m = Model(sbml.name)
    m.states(*sbml.slopes)
    if signals & used:
        m.inputs(*sorted(signals & used))
    m.parameters(**{n: p for n, p in parameters.items() if n in used})
    if rules:
        m.quantities(**rules)
    m.dynamics(**slopes)
    m.initial(**initial)
    m.outputs(**outputs)
    noises = {n: Output(n, outputs[n], sigmas[n], o.laplace).noise for n, o in measured.outputs.items()}
    scales = {n: s for n, s in noises.items() if not measured.outputs[n].laplace}
    densities = {n: s for n, s in noises.items() if measured.outputs[n].laplace}
    m.noise(PerOutput(densities, scales) if densities else Gaussian(scales))
    m.check()
    return m
