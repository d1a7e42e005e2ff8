"""Models of the core: rebuilt with other declarations, and advice on their kinks and jumps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import phugoid._core as _core

from .._core import Expr
from ..errors import ModelError, listing
from ..parameters import Parameter

__all__ = [
    "Key",
    "added_parameters",
    "changed",
    "changed_parameters",
    "declare_parameter",
    "equations_of",
    "kink_advice",
    "rebuilt",
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


_SMOOTH = {
    "sign": "smooth_sign(x, width)",
    "abs": "smooth_abs(x, width)",
    "min": "smooth_min(a, b, width)",
    "max": "smooth_max(a, b, width)",
    "lt": "smooth_step(x, width)",
    "le": "smooth_step(x, width)",
}
# Greatest number of expressions that are named.
_NAMED = 4


def kink_advice(core: _core.Model) -> str:
    """Name the kinks and jumps of a model, and the smooth functions that can stand for them; "" without any."""
    kinks = core.kinks()
    if not kinks:
        return ""
    functions = " and ".join(dict.fromkeys(f"ph.{_SMOOTH[name]}" for name, _ in kinks))
    return (
        f"the state equations have kinks or jumps: {_listed([place for _, place in kinks])}. No smooth path satisfies "
        f"such equations at the points of a mesh: write {functions}, with a width that is small beside the motion, "
        "and reduce it in steps, each with start=fit of the last"
    )


def _listed(texts: list[str]) -> str:
    """Join the first of some texts, and say how many more there are."""
    more = f" and {len(texts) - _NAMED} more" if len(texts) > _NAMED else ""
    return ", ".join(texts[:_NAMED]) + more
