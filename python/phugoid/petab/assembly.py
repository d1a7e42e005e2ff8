"""Assemble the model and the records of a PEtab problem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..data.experiment import Experiment
from ..data.filtering import Interpolation
from ..errors import ModelError
from ..modelling.densities import PerOutput
from ..modelling.model import Model
from ..modelling.noise import Gaussian
from ..parameters import Parameter
from ..records import Record
from ..steady_state import REST, at_rest, duration_of_rest, integrated
from .measurements import Conditions, Measurements, Output, Phase
from .sbml import TIME, Formulas, SbmlModel, Switch, substituted

__all__ = ["NamedValues", "Records", "declared_parameters", "model_of", "prior_outputs"]


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
            if said is None and name not in self.sbml.jumping:
                said = self.sbml.rules.get(name)
            if said is None:
                said = self.sbml.initial.get(name)
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


def prior_outputs(table: Any) -> dict[str, tuple[Output, float, float]]:
    """Read the priors of a parameter table as outputs that are measured once.

    Returns by name the output, its value, and what the log-density of the prior has beside that of the measurement.
    A normal prior on a parameter, or on its logarithm, is the density of such a measurement. A log-normal one, of ln p
    with mean m and standard deviation s, has a factor 1/p, too: it is that of a mean m - s^2, times exp(s^2 / 2 - m).
    """
    found = {}
    for name, row in table.iterrows():
        kind = row.get("objectivePriorType", None)
        if not int(row.get("estimate", 1)) or not isinstance(kind, str) or not kind.strip():
            continue
        if kind in ("uniform", "parameterScaleUniform"):
            continue
        scale = str(row.get("parameterScale", "lin")) if kind.startswith("parameterScale") else "lin"
        if kind not in ("normal", "laplace", "logNormal", "parameterScaleNormal", "parameterScaleLaplace"):
            raise ModelError(f"PEtab: the prior {kind} of {name} is not supported")
        mean, width = map(float, str(row["objectivePriorParameters"]).split(";"))
        beside = 0.0
        if kind == "logNormal":
            scale, mean, beside = "log", mean - width**2, 0.5 * width**2 - mean
        p = Expr.symbol(str(name))
        on_scale = {"lin": p, "log": Expr(p.log()), "log10": Expr(p.log() / math.log(10.0))}[scale]
        label = f"prior_of_{name}"
        found[label] = (Output(label, on_scale, Expr(width), "aplace" in kind), mean, beside)
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

    m = Model(sbml.name, time_unit=sbml.time_unit)
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


_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Records:
    """Makes experiments."""

    model: Model
    values: NamedValues
    formulas: Formulas
    measured: Measurements

    def experiment(self, phase: Phase, at: Mapping[str, float]) -> Experiment:
        """Return the experiment of a phase: its samples, signals, and the steady state before it.

        ``at``: parameters at which the durations of steady states are chosen.
        """
        samples = self.measured.samples[phase]
        steps = {s.name: self._step(s, phase) for s in self.formulas.switches.values()}
        times = {0.0, *(t for own in samples.values() for t, _ in own)}
        end = max(t for t in times if math.isfinite(t))
        times |= {t for t, _ in steps.values() if 0.0 < t < end}
        if not end > 0.0:
            times.add(1.0)
        final = 0.0
        if math.inf in times:
            times.remove(math.inf)
            begun = self._made(phase, np.array(sorted(times)), steps, {})
            final = duration_of_rest(self.model, at, begun, "PEtab")
            times |= set(float(t) for t in max(times) + final * REST[1:])
        t = np.array(sorted(times))
        last = float(t[-1])
        found = self._made(phase, t, steps, {n: [(min(s, last), z) for s, z in own] for n, own in samples.items()})
        if phase.before is None:
            return found
        before = self._made(phase, np.array([-1.0, 0.0]), steps, {}, True)
        duration = duration_of_rest(self.model, at, before, "PEtab")
        rest = np.concatenate([duration * (REST[:-1] - 1.0), t])
        return self._made(phase, rest, steps, {n: list(own) for n, own in samples.items()})

    def _made(
        self,
        phase: Phase,
        t: _Array,
        steps: Mapping[str, tuple[float, int]],
        samples: Mapping[str, list[tuple[float, float]]],
        before: bool = False,
    ) -> Experiment:
        inputs: dict[str, _Array] = {}
        for name, by_condition in self.values.conditions.signals.items():
            during, rest = by_condition[phase.during], by_condition[phase.before or phase.during]
            inputs[name] = np.where((t < 0.0) | before, rest, during)
        events = {s.name for s in self.formulas.switches.values() if s.kind == "event"}
        for name, (at, direction) in steps.items():
            # Time stands still in a steady state before a record, and no event has happened.
            clock = t if name in events else np.maximum(t, 0.0)
            reached = clock >= at - 1e-12 * max(1.0, abs(at)) if math.isfinite(at) else at < 0.0
            inputs[name] = np.full(t.size, 1.0) * (reached if direction > 0 else ~np.asarray(reached))
        held = set(inputs)
        for name, column in self.measured.columns.get(phase, {}).items():
            filled = np.full(t.size, float(np.median([v for _, v in column])))
            for at, value in column:
                filled[int(np.argmin(np.abs(t - min(at, t[-1]))))] = value
            inputs[name] = filled
        outputs = {n: np.full(t.size, np.nan) for n in samples}
        for name, own in samples.items():
            for at, value in own:
                outputs[name][int(np.argmin(np.abs(t - at)))] = value
        wanted = {n: inputs.get(n, np.ones(t.size)) for n in self.model.input_names}
        kinds: dict[str, Interpolation] = {n: "hold" if n in held else "linear" for n in wanted}
        return Experiment(t, wanted, outputs, name=phase.name, interpolation=kinds or "linear")

    def _step(self, switch: Switch, phase: Phase) -> tuple[float, int]:
        """Return the time at which a switch changes, and whether it goes on (1) or off (-1)."""
        difference = self.values.constants(switch.difference)
        numbers = {n: by[phase.during] for n, by in self.values.conditions.signals.items()}
        difference = substituted(difference, numbers)
        if others := set(difference.symbols) - {TIME}:
            raise ModelError(
                f"PEtab: not supported: whether {switch.difference} is {switch.kind} depends on "
                f"{', '.join(sorted(others))}, which is estimated or changes in time"
            )
        if switch.kind not in ("positive", "event"):
            equal = abs(difference.evaluate({})) < 1e-12
            return (-math.inf if equal == (switch.kind == "equal") else math.inf), 1
        at = [difference.evaluate({TIME: t} if difference.symbols else {}) for t in (0.0, 1.0, 2.0)]
        slope = at[1] - at[0]
        if abs(at[2] - at[1] - slope) > 1e-9 * (abs(slope) + abs(at[0])):
            raise ModelError(f"PEtab: not supported: a condition that is not linear in time ({switch.difference})")
        if slope == 0.0:
            return (-math.inf, 1) if at[0] > 0.0 else (math.inf, 1)
        return -at[0] / slope, 1 if slope > 0.0 else -1

    def rests(self, phase: Phase) -> bool:
        """Return whether there is a steady state before the record of a phase, or at its end."""
        ends = (t for own in self.measured.samples[phase].values() for t, _ in own)
        return phase.before is not None or math.inf in ends

    def settled(self, phase: Phase, record: Record) -> bool:
        """Return whether the states of a record of a phase are at rest where they have to be."""
        ends = [] if phase.before is None else [int(np.searchsorted(record.t, 0.0))]
        if math.inf in (t for own in self.measured.samples[phase].values() for t, _ in own):
            ends.append(record.t.size - 1)
        return all(at_rest(record, end) for end in ends)

    def integrated(self, at: Mapping[str, float], experiment: Experiment, time_limit: float | None) -> Record:
        """Integrate the model over an experiment."""
        return integrated(self.model, at, experiment, "PEtab", time_limit)
