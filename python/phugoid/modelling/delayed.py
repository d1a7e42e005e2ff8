"""Which inputs and outputs of a model are late, and by which parameter.

A delay moves a signal along its samples, so the structure of the problem would change with it. Instead signals are
moved by a base tau0, and what is left, d = tau - tau0, enters by Taylor's series: u(t - tau) = u0 - d u0' + d**2 u0''/2
with the derivatives of the interpolated input; at a sensor the state is x - d f + d**2 f'/2, with f the right-hand side
of the equations. First and second derivatives with respect to tau are exact at d = 0. The problem is solved, the base
moved to the estimate, and so on until nothing is left: there the optimum, and the standard errors, are those of the
delayed model itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .. import _core
from .._core import Expr
from .rebuilt import equations_of, rebuilt

__all__ = ["Delays", "at_delays"]


@dataclass(frozen=True)
class Delays:
    """inputs: name of the late input -> (the input, the parameter); outputs: name -> the parameter.

    settled: bases have settled when they move by less than this part of the standard error; passes: how often they may
    move until then.
    """

    inputs: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    settled: float = 1e-4
    passes: int = 30

    def __bool__(self) -> bool:
        return bool(self.inputs or self.outputs)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The parameters that are delays (s), each once."""
        return tuple(dict.fromkeys([*(tau for _, tau in self.inputs.values()), *self.outputs.values()]))

    def with_input(self, late: str, of: str, tau: str) -> Delays:
        """One more late input."""
        return replace(self, inputs={**self.inputs, late: (of, tau)})

    def with_output(self, output: str, tau: str) -> Delays:
        """One more late output."""
        return replace(self, outputs={**self.outputs, output: tau})

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it; empty where nothing is late."""
        if not self:
            return {}
        return {"inputs": {late: list(pair) for late, pair in self.inputs.items()}, "outputs": dict(self.outputs)}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Delays:
        """Reads `to_dict`."""
        inputs = {late: (of, tau) for late, (of, tau) in saved.get("inputs", {}).items()}
        return Delays(inputs, dict(saved.get("outputs", {})))


def at_delays(model: Any, base: Mapping[str, float], reach: float = np.inf) -> Any:
    """The model without delays, for data that were moved by ``base`` (s): parameters are the same."""
    old, delays = model._core, model.delays
    rest: dict[str, Any] = {tau: Expr.symbol(tau) - value for tau, value in base.items()}

    def moved(name: str, by: Any) -> Expr:
        rate, bend = Expr.symbol(f"{name}_rate"), Expr.symbol(f"{name}_bend")
        return Expr(Expr.symbol(name) - by * rate + 0.5 * by * by * bend)

    late = {name: moved(name, rest[tau]) for name, (_, tau) in delays.inputs.items()}
    whole = model.output_expressions()

    def changed(kind: str, name: str, e: Expr) -> Expr:
        if kind == "output" and name in delays.outputs:
            return _earlier(model, whole[name], rest[delays.outputs[name]], late, rest, moved)
        return e.substitute(late)

    def declare(core: _core.Model, declared: Any) -> None:
        name, unit, start, low, high, *others = declared
        if name in base:
            low, high = max(low, base[name] - reach), min(high, base[name] + reach)
            start = min(max(base[name], low), high)
        core.parameter(name, unit, start, low, high, *others)

    equations = {key: changed(*key, e) for key, e in equations_of(old)}
    used = {symbol for e in equations.values() for symbol in e.symbols}
    inputs = list(old.inputs)
    for name, unit in old.inputs:
        rates = (f"{name}_rate", f"{unit}/s"), (f"{name}_bend", f"{unit}/s**2")
        inputs += [(rate, of) for rate, of in rates if rate in used]
    core = rebuilt(old, inputs, declare, lambda key, _: equations[key])
    return model._around(core, Delays())


def _earlier(
    model: Any,
    g: Expr,
    by: Any,
    late: Mapping[str, Expr],
    rest: Mapping[str, Any],
    moved: Callable[[str, Any], Expr],
) -> Expr:
    """An output, quantities put in, as it was a little earlier: states by the equations, inputs by their rates."""
    f = model.state_expressions()
    at: dict[str, Any] = {"time": Expr.symbol("time") - by}
    inputs = list(model.declared_inputs)
    for name in inputs:
        own = rest[model.delays.inputs[name][1]] if name in model.delays.inputs else 0.0
        at[name] = moved(name, by + own)
    for state, right in f.items():
        slope = right.substitute(late)
        bend: Any = right.diff("time").substitute(late)
        for name in {*right.symbols}.intersection(f):
            bend = bend + right.diff(name).substitute(late) * f[name].substitute(late)
        for name in {*right.symbols}.intersection(inputs):
            rate: Any = Expr.symbol(f"{name}_rate")
            if name in late:
                rate = rate - rest[model.delays.inputs[name][1]] * Expr.symbol(f"{name}_bend")
            bend = bend + right.diff(name).substitute(late) * rate
        at[state] = Expr.symbol(state) - by * slope + 0.5 * by * by * bend
    return Expr(g.substitute(at))
