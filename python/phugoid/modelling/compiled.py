"""Models and expressions compiled for evaluation on arrays, and the derivatives of a model's equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .._core import Expr
from ..errors import EvaluationError, ModelError, listing
from .declared import rebuilt
from .model import Model

__all__ = ["CompiledExpressions", "CompiledModel", "Jacobians"]

_Array = NDArray[np.float64]


class CompiledModel:
    """State equations and outputs of a model, for parameters (n_p,) and columns (rows, n) of points.

    The rows are time, the inputs as declared (delayed ones included), and the states. With
    ``own_parameters`` each point has parameters of its own: they are rows after the inputs, and (n_p,) is empty.
    """

    def __init__(self, model: Model, own_parameters: bool = False) -> None:
        core = model._core
        if own_parameters:

            def declare(new: _core.Model, declared: Any) -> None:
                new.input(declared[0], declared[1])

            core = rebuilt(core, core.inputs, declare)
        self._evaluator = _core.Evaluator(core)

    def dynamics(self, parameters: _Array, columns: _Array) -> _Array:
        """Return derivatives of the states (n_x, n)."""
        return np.asarray(self._evaluator.dynamics(parameters, columns))

    def outputs(self, parameters: _Array, columns: _Array) -> _Array:
        """Return outputs (n_y, n)."""
        return np.asarray(self._evaluator.outputs(parameters, columns))


class CompiledExpressions:
    """Values of expressions for parameters (n_p,) and columns (1 + inputs + states, n): time, inputs, states.

    Parameters may be named that stand in none of the expressions.
    """

    def __init__(
        self,
        expressions: Sequence[Expr],
        parameters: Sequence[str] = (),
        inputs: Sequence[str] = (),
        states: Sequence[str] = (),
    ) -> None:
        used = {symbol for e in expressions for symbol in e.symbols}
        self._used = [i for i, name in enumerate(parameters) if name in used]
        core = _core.Model("expressions")
        for i in self._used:
            core.parameter(parameters[i], "", 0.0, -np.inf, np.inf, None, False, False, False, None)
        for constant, value in sorted({pair for e in expressions for pair in e.constants}):
            core.constant(constant, value, "", "")
        for name in inputs:
            core.input(name, "")
        self._stateless = not states  # a model has at least one
        for name in states or ("no_state__",):
            core.state(name, "")
            core.equation(name, 0.0, None)
        for k, e in enumerate(expressions):
            core.output(f"e{k} of phugoid", e, "", None)
        self._evaluator = _core.Evaluator(core) if expressions else None

    def __call__(self, parameters: _Array, columns: _Array) -> _Array:
        """Return the values (expressions, n)."""
        if self._evaluator is None:
            return np.empty((0, columns.shape[1]))
        if self._stateless:
            columns = np.vstack([columns, np.zeros(columns.shape[1])])
        return np.asarray(self._evaluator.outputs(parameters[self._used], columns))


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
                raise ModelError(f"{self.caller}: at: '{name}' is not a state or input.{listing(str(name), there)}")
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
