"""Derivatives of a model's equations by its states and inputs: A, B, C and D, as expressions and as numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..errors import EvaluationError, ModelError, listing
from ..modelling.model import Model

__all__ = ["Jacobians"]

_Array: TypeAlias = NDArray[np.float64]
_Place: TypeAlias = tuple[int, int]


class Jacobians:
    """A = df/dx, B = df/du, C = dg/dx and D = dg/du of a model, exactly; the delayed inputs of a model are inputs too.

    The expressions that are not zero are kept by place, and so are their derivatives by parameters.
    """

    def __init__(self, model: Model, caller: str, blocks: str = "ABCD") -> None:
        self.model, self.caller = model, caller
        self.states = model.state_names
        self.inputs = tuple(model.declared_inputs)
        self.outputs = model.output_names
        by_state = model.state_expressions()
        f = [by_state[name] for name in self.states]
        g = [Expr(e) for e in model.output_expressions().values()]
        pairs = {"A": (f, self.states), "B": (f, self.inputs), "C": (g, self.states), "D": (g, self.inputs)}
        self.blocks = {block: _derivatives(*pairs[block]) for block in blocks}
        self.shapes = {block: (len(pairs[block][0]), len(pairs[block][1])) for block in blocks}
        used = {name for block in self.blocks.values() for e in block.values() for name in e.symbols}
        # Where the derivatives depend on states, inputs or time.
        self.varying = [name for name in (*self.states, *self.inputs, "time") if name in used]
        self.parameters = [name for name in model.parameter_names if name in used]

    def point(self, values: Mapping[str, float], at: Mapping[str, float] | None) -> dict[str, float]:
        """Return numbers for all symbols: parameters from ``values``, and the point. ModelError where a value is
        missing."""
        if not isinstance(at, (Mapping, type(None))):
            raise ModelError(f"{self.caller}: at: give states and inputs by name, such as {{'alpha': 0.1}}, not {at!r}")
        at = dict(at or {})
        there = (*self.states, *self.inputs, "time")
        for name in at:
            if name not in there:
                raise ModelError(f"{self.caller}: at: '{name}' is no state or input.{listing(str(name), there)}")
        missing = [name for name in self.varying if name not in at]
        if missing:
            raise ModelError(
                f"{self.caller}: '{self.model.name}' is not linear: its derivatives depend on {', '.join(missing)}; "
                f"say where, as in at={{'{missing[0]}': ...}}, at a trim point"
            )
        return {**values, **{name: float(value) for name, value in at.items()}}

    def matrix(self, block: str, numbers: Mapping[str, float]) -> _Array:
        """Return the numbers of a block; raise EvaluationError where they are not finite."""
        found = np.zeros(self.shapes[block])
        for place, e in self.blocks[block].items():
            found[place] = e.evaluate({name: numbers[name] for name in e.symbols})
        if not np.isfinite(found).all():
            i, j = np.argwhere(~np.isfinite(found))[0]
            of = f"{self.states[i]}'" if block in "AB" else self.outputs[i]
            by = self.states[j] if block in "AC" else self.inputs[j]
            raise EvaluationError(f"{self.caller}: the derivative of {of} by {by} is {found[i, j]} there")
        return found

    def slopes(self, parameter: str, numbers: Mapping[str, float]) -> dict[str, list[tuple[_Place, float]]]:
        """Return for each block the elements that depend on a parameter, with their derivatives by it."""
        found: dict[str, list[tuple[_Place, float]]] = {}
        for block, entries in self.blocks.items():
            found[block] = []
            for place, e in entries.items():
                if parameter in e.symbols:
                    d = e.diff(parameter)
                    found[block].append((place, d.evaluate({name: numbers[name] for name in d.symbols})))
        return found


def _derivatives(expressions: Sequence[Expr], names: Sequence[str]) -> dict[_Place, Expr]:
    found = {}
    for i, e in enumerate(expressions):
        used = {*e.symbols}
        for j, name in enumerate(names):
            if name in used and (d := e.diff(name)).constant != 0.0:
                found[i, j] = d
    return found
