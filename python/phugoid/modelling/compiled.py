"""Models rebuilt with other declarations, and expressions compiled for evaluation on arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from .._core import Expr
from ..errors import ModelError, listing
from ..parameters import Parameter

if TYPE_CHECKING:
    from .model import Model

__all__ = [
    "CompiledExpressions",
    "CompiledModel",
    "Key",
    "added_parameters",
    "changed",
    "changed_parameters",
    "declare_parameter",
    "equations_of",
    "separated",
]


Key = tuple[str, str]


def equations_of(core: _core.Model) -> Iterator[tuple[Key, Expr]]:
    """Yield all right-hand sides by kind ("quantity", "equation", "output", or the end of a condition) and name."""
    groups = {"quantity": core.quantities, "equation": core.dynamics, "output": core.outputs}
    for kind, equations in groups.items():
        for name, e, *_ in equations:
            yield (kind, name), e
    for end, state, e, _ in core.conditions:
        yield (end, state), e


def declare_parameter(core: _core.Model, name: str, p: Parameter) -> Expr:
    """Declare a parameter in a core model."""
    log = p.transform == "log"
    return core.parameter(name, p.unit, p.start, *p.bounds, p.prior, p.fixed, p.per_experiment, log, p.scale)


def changed_parameters(
    declared: Mapping[str, Parameter], changes: Mapping[str, Parameter | float]
) -> dict[str, Parameter]:
    """Return the declarations that `Model.with_parameters` replaces; raises as that does."""
    found = {}
    for name, value in changes.items():
        if name not in declared:
            raise ModelError(f"with_parameters: '{name}' is no parameter.{listing(str(name), list(declared))}")
        try:
            found[name] = value if isinstance(value, Parameter) else replace(declared[name], start=value)
        except (ModelError, TypeError) as error:
            raise ModelError(f"with_parameters: '{name}': {error}") from None
    return found


def added_parameters(
    declared: Mapping[str, Parameter], parameters: Mapping[str, Parameter | float]
) -> dict[str, Parameter]:
    """Return the declarations that `Model.with_terms` adds; raises as that does."""
    found = {}
    for name, value in parameters.items():
        if name in declared:
            raise ModelError(f"with_terms: the model has a parameter '{name}' already: give another name")
        try:
            found[name] = value if isinstance(value, Parameter) else Parameter(value)
        except (ModelError, TypeError) as error:
            raise ModelError(f"with_terms: '{name}': {error}") from None
    return found


def rebuilt(
    old: _core.Model,
    inputs: Iterable[tuple[str, str]],
    declare: Callable[[_core.Model, Any], None],
    change: Callable[[Key, Expr], Expr] = lambda _, e: e,
) -> _core.Model:
    """Return a model with the states of another, ``inputs`` as (name, unit), the parameters that ``declare`` declares
    for each of its own, and its equations, keyed as by `equations_of`, passed through ``change``."""
    core = _core.Model(old.name)
    for declared_state in old.declared_states:
        core.state(*declared_state)
    for name, unit in inputs:
        core.input(name, unit)
    for declared in old.parameters:
        declare(core, declared)
    for name, e, _, source in old.quantities:
        core.quantity(name, change(("quantity", name), e), source)
    for name, e, _, source in old.dynamics:
        core.equation(name, change(("equation", name), e), source)
    for name, e, unit, source in old.outputs:
        core.output(name, change(("output", name), e), unit, source)
    for end, state, e, source in old.conditions:
        core.condition(end, state, change((end, state), e), source)
    return core


def separated(old: _core.Model, local: Sequence[str], count: int) -> _core.Model:
    """Return a model in which each parameter p of ``local`` is a quantity, the sum over ``count`` experiments of a
    parameter ``p__i`` times an input ``experiment__i``."""

    def declare(core: _core.Model, declared: Any) -> None:
        name, unit, start, low, high, prior, fixed, _, log, scale = declared

        def shared(name: str) -> Expr:
            return core.parameter(name, unit, start, low, high, prior, fixed, False, log, scale)

        if name not in local:
            shared(name)
            return
        own = (shared(f"{name}__{i}") * Expr.symbol(f"experiment__{i}") for i in range(count))
        core.quantity(name, Expr(sum(own, Expr(0.0))), None)

    switches = [(f"experiment__{i}", "") for i in range(count)]
    return rebuilt(old, [*old.inputs, *switches], declare)


def changed(
    old: _core.Model,
    parameters: Mapping[str, Parameter],
    equations: Mapping[Key, Expr],
    inputs: Mapping[str, str],
    outputs: Mapping[str, Expr],
) -> _core.Model:
    """Return a model with some parameters and equations replaced, and new parameters, inputs and outputs added."""

    def declare(core: _core.Model, declared: Any) -> None:
        if declared[0] in parameters:
            declare_parameter(core, declared[0], parameters[declared[0]])
        else:
            core.parameter(*declared)

    core = rebuilt(old, [*old.inputs, *inputs.items()], declare, lambda key, e: equations.get(key, e))
    there = {name for name, *_ in old.parameters}
    for name, p in parameters.items():
        if name not in there:
            declare_parameter(core, name, p)
    for name, e in outputs.items():
        core.output(name, e, "", None)
    return core


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
