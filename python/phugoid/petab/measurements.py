"""Measurement and condition tables of a PEtab problem."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..errors import DataError, ModelError
from ..functions import log
from ..modelling.densities import Laplace
from .sbml import Formulas, substituted

__all__ = ["Conditions", "Measurements", "Output", "Phase", "set_after_rest"]


@dataclass(frozen=True)
class Phase:
    """The conditions of a simulation: of the steady state before it, if there is one, and its own."""

    before: str | None
    during: str

    @property
    def name(self) -> str:
        """The name of the experiment."""
        return self.during if self.before is None else f"{self.before}__{self.during}"


@dataclass
class Conditions:
    """The condition table, read for a set of phases.

    values   by name: what stands for it in the model, an expression in parameters and signals.
    signals  by signal: its value by condition.
    """

    values: dict[str, Expr] = field(default_factory=dict)
    signals: dict[str, dict[str, float]] = field(default_factory=dict)

    @classmethod
    def read(cls, table: Any, used: Sequence[str], defaults: Mapping[str, Expr]) -> Conditions:
        """Read a condition table for the conditions that are ``used``.

        ``defaults``: values of names of which a condition says nothing (NaN). Raises ModelError where there is none.
        """
        found = cls()
        entries: dict[str, float | str | Expr | None]
        for name in table.columns:
            if name == "conditionName":
                continue
            entries = {c: _entry(table.loc[c, name]) for c in used}
            if all(e is None for e in entries.values()):
                continue
            if missing := [c for c, e in entries.items() if e is None]:
                if name not in defaults:
                    raise ModelError(f"PEtab: condition {missing[0]} has no value of {name}, and the model has none")
                entries |= dict.fromkeys(missing, defaults[name])
            found._add(str(name), entries)
        return found

    def _add(self, name: str, entries: Mapping[str, float | str | Expr | None]) -> None:
        numbers = {c: e for c, e in entries.items() if isinstance(e, float)}
        others: dict[str, tuple[Expr, list[str]]] = {}
        for condition, entry in entries.items():
            if isinstance(entry, (str, Expr)):
                value = Expr.symbol(entry) if isinstance(entry, str) else entry
                others.setdefault(str(value), (value, []))[1].append(condition)
        if not others and len(set(numbers.values())) == 1:
            self.values[name] = Expr(next(iter(numbers.values())))
            return
        if not numbers and len(others) == 1:
            self.values[name] = next(iter(others.values()))[0]
            return
        total = Expr(0.0)
        if any(numbers.values()):
            self.signals[f"{name}_given"] = {c: numbers.get(c, 0.0) for c in entries}
            total = Expr.symbol(f"{name}_given")
        for k, (value, where) in enumerate(others.values(), 1):
            chosen = f"{name}_is_{value.name or k}"
            self.signals[chosen] = {c: float(c in where) for c in entries}
            total = Expr(total + Expr.symbol(chosen) * value)
        self.values[name] = total


def set_after_rest(table: Any, phases: Sequence[Phase], states: Mapping[str, Any]) -> list[str]:
    """Return the states that a condition sets anew after the steady state before it; an empty entry (NaN) keeps them.

    Raises ModelError where some of the conditions do so, and others keep the state.
    """
    after = list(dict.fromkeys(p.during for p in phases if p.before is not None))
    found = []
    for name in table.columns if after else ():
        if name not in states:
            continue
        kept = [c for c in after if _entry(table.loc[c, name]) is None]
        if not kept:
            found.append(str(name))
        elif len(kept) < len(after):
            raise ModelError(
                f"PEtab: not supported: the state {name} is set after the steady state in some conditions, and kept in "
                f"others ({', '.join(kept)})"
            )
    return found


def _entry(value: Any) -> float | str | None:
    """Return a number, the name of a parameter, or None for an empty entry."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        text = str(value).strip()
        return text or None
    return None if math.isnan(number) else number


_Array = NDArray[np.float64]
# A smoothing of the Laplace density so small that a log-density is off by less than this.
_SMOOTHING = 1e-4


@dataclass
class Output:
    """An output of the model: an observable with its parameters put in, on the scale of its noise."""

    name: str
    expression: Expr
    sigma: Expr
    laplace: bool

    @property
    def noise(self) -> Any:
        """The noise as `Model.noise` takes it."""
        sigma = self.sigma if self.sigma.constant is None else self.sigma.constant
        return Laplace({self.name: sigma}, _SMOOTHING) if self.laplace else sigma


@dataclass
class Measurements:
    """The measurement table as outputs and samples.

    outputs   what is measured: one output for each observable, set of parameters put in and replicate.
    samples   by phase and output: times and values on the scale of the noise, with the numbers put in.
    columns   by phase and signal: times and numbers that differ from sample to sample.
    constant  what the log-likelihood of the PEtab problem has beside that of the fit: the normalisation of Gaussian
              densities and the Jacobian of logarithms.
    """

    outputs: dict[str, Output] = field(default_factory=dict)
    samples: dict[Phase, dict[str, list[tuple[float, float]]]] = field(default_factory=dict)
    columns: dict[Phase, dict[str, list[tuple[float, float]]]] = field(default_factory=dict)
    constant: float = 0.0

    @classmethod
    def read(cls, measurements: Any, observables: Any, formulas: Formulas, values: Mapping[str, Expr]) -> Measurements:
        """Read both tables; ``values`` are put in for names that the model does not know as symbols."""
        found = cls()
        for observable, rows in measurements.groupby("observableId", sort=False):
            if observable not in observables.index:
                raise ModelError(f"PEtab: the observable {observable} is measured and not declared")
            found._observable(str(observable), observables.loc[observable], rows, formulas, values)
        return found

    def _observable(self, name: str, declared: Any, rows: Any, formulas: Formulas, values: Mapping[str, Expr]) -> None:
        kind = str(_get(declared, "noiseDistribution", "normal"))
        scale = str(_get(declared, "observableTransformation", "lin"))
        if kind not in ("normal", "laplace") or scale not in ("lin", "log", "log10"):
            raise ModelError(f"PEtab: the noise of {name} ({kind} on the scale {scale}) is not supported")
        formula = formulas.read(str(declared["observableFormula"]), f"PEtab observable {name}")
        sigma = formulas.read(str(declared["noiseFormula"]), f"PEtab noise of {name}")
        groups: dict[tuple[Any, ...], list[Any]] = {}
        overrides = [_overrides(row, name) for _, row in rows.iterrows()]
        spread = _that_vary(overrides)
        for (_, row), own in zip(rows.iterrows(), overrides, strict=True):
            key = tuple(sorted((k, v) for k, v in own.items() if k not in spread))
            groups.setdefault(key, []).append((row, own))
        for key, members in groups.items():
            put_in: dict[str, Any] = {k: Expr.symbol(v) if isinstance(v, str) else v for k, v in key}
            replicates: dict[tuple[Phase, float], int] = {}
            for row, own in members:
                phase, t = _phase(row), float(row["time"])
                number = replicates[phase, t] = replicates.get((phase, t), 0) + 1
                base = name if len(groups) == 1 else f"{name}_{list(groups).index(key) + 1}"
                output = base if number == 1 else f"{base}_replicate_{number}"
                # Numbers that vary are signals; they are those of this output.
                mine = {k: Expr.symbol(f"{k}_of_{output}") for k in spread}
                if output not in self.outputs:
                    said = {**values, **put_in, **mine}
                    g, s = substituted(formula, {**put_in, **mine}), substituted(sigma, {**put_in, **mine})
                    g, s = substituted(g, said), substituted(s, said)
                    self.outputs[output] = Output(output, _scaled(g, scale), s, kind == "laplace")
                value = self._value(float(row["measurement"]), scale, kind, name)
                self.samples.setdefault(phase, {}).setdefault(output, []).append((t, value))
                for k, symbol in mine.items():
                    self.columns.setdefault(phase, {}).setdefault(str(symbol.name), []).append((t, float(own[k])))

    def _value(self, z: float, scale: str, kind: str, name: str) -> float:
        if not math.isfinite(z):
            raise DataError(f"PEtab: a measurement of {name} is {z}")
        if kind == "normal" or kind == "laplace":
            self.constant -= 0.5 * math.log(2.0 * math.pi)
        if scale == "lin":
            return z
        if z <= 0.0:
            raise DataError(f"PEtab: a measurement of {name} is {z}, which has no logarithm")
        self.constant -= math.log(z) + (math.log(math.log(10.0)) if scale == "log10" else 0.0)
        return math.log(z) if scale == "log" else math.log10(z)


def _scaled(expression: Expr, scale: str) -> Expr:
    if scale == "lin":
        return expression
    return Expr(log(expression) if scale == "log" else log(expression) / math.log(10.0))


def _get(row: Any, column: str, default: Any) -> Any:
    value = row.get(column, default)
    return default if isinstance(value, float) and math.isnan(value) else value


def _phase(row: Any) -> Phase:
    before = _get(row, "preequilibrationConditionId", None)
    return Phase(None if before in (None, "") else str(before), str(row["simulationConditionId"]))


def _overrides(row: Any, name: str) -> dict[str, float | str]:
    """NamedValues of the placeholders in the formulas of an observable, by placeholder."""
    found: dict[str, float | str] = {}
    for kind, column in (("observableParameter", "observableParameters"), ("noiseParameter", "noiseParameters")):
        text = _get(row, column, "")
        for i, value in enumerate(str(text).split(";") if text != "" else (), 1):
            try:
                found[f"{kind}{i}_{name}"] = float(value)
            except ValueError:
                found[f"{kind}{i}_{name}"] = value.strip()
    return found


def _that_vary(overrides: list[dict[str, float | str]]) -> set[str]:
    """Placeholders that are numbers, and not the same in all rows."""
    names = {k for own in overrides for k in own}
    each = {k: [own.get(k) for own in overrides] for k in names}
    return {k for k, v in each.items() if all(isinstance(x, float) for x in v) and len(set(v)) > 1}
