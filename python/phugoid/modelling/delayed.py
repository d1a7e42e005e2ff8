"""Which inputs and outputs of a model are late, and by which parameter.

A delay moves a signal along its samples, so the structure of the problem would change with it. Instead signals are
moved by a base tau0, and what is left, d = tau - tau0, enters by Taylor's series: u(t - tau) = u0 - d u0' + d**2 u0''/2
with the derivatives of the interpolated input; at a sensor the state is x - d f + d**2 f'/2, with f the right-hand side
of the equations. First and second derivatives with respect to tau are exact at d = 0. The problem is solved, the base
moved to the estimate, and so on until nothing is left: there the optimum, and the standard errors, are those of the
delayed model itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

__all__ = ["Delays"]


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

    @property
    def spec(self) -> tuple[list[tuple[str, str, str]], list[tuple[str, str]]]:
        """As the core takes them."""
        return [(late, of, tau) for late, (of, tau) in self.inputs.items()], list(self.outputs.items())

    def with_input(self, late: str, of: str, tau: str) -> Delays:
        """Add one more delayed input."""
        return replace(self, inputs={**self.inputs, late: (of, tau)})

    def with_output(self, output: str, tau: str) -> Delays:
        """Add one more delayed output."""
        return replace(self, outputs={**self.outputs, output: tau})

    def to_dict(self) -> dict[str, Any]:
        """Return the delays for JSON; empty where nothing is delayed."""
        if not self:
            return {}
        return {"inputs": {late: list(pair) for late, pair in self.inputs.items()}, "outputs": dict(self.outputs)}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Delays:
        """Read what `to_dict` wrote."""
        inputs = {late: (of, tau) for late, (of, tau) in saved.get("inputs", {}).items()}
        return Delays(inputs, dict(saved.get("outputs", {})))
