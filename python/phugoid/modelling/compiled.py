"""Models and expressions compiled for evaluation on arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .._core import Expr
from .core_model import rebuilt
from .model import Model

__all__ = ["CompiledExpressions", "CompiledModel"]

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
