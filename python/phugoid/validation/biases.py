"""Detection of sensor biases among the parameters of a model, from its equations."""

from __future__ import annotations

from .._core import Expr
from ..modelling.model import Model

__all__ = ["biases", "freed_by_default"]


def biases(model: Model) -> tuple[str, ...]:
    """Return the parameters that enter outputs only, each as a term with a coefficient that is constant over a record.

    ``q + b_q`` has the bias b_q, and so has ``K*(alpha + b)`` with another parameter K. A parameter that enters a state
    equation or a condition at an end of the record (CL0, say) is no bias, nor is a delay, nor one of two that multiply
    each other.
    """
    return _entering_outputs_only(model, _symbols_of_motion(model, with_initial=True))


def freed_by_default(model: Model) -> tuple[str, ...]:
    """Return the parameters that a validation re-estimates: biases, and initial values that each experiment has its own
    of."""
    declared = model.declared_parameters
    either = {*biases(model)}
    apart = _entering_outputs_only(model, _symbols_of_motion(model, with_initial=False))
    either |= {name for name in apart if declared[name].per_experiment}
    return tuple(name for name in declared if name in either and not declared[name].fixed)


def _symbols_of_motion(model: Model, with_initial: bool) -> set[str]:
    """Return the symbols in state equations and conditions, with quantities substituted."""
    found = [*model.state_expressions().values()]
    found += [e for end, _, e in model.end_conditions if with_initial or end != "initial"]
    return {symbol for e in found for symbol in e.simplify().symbols}


def _entering_outputs_only(model: Model, motion: set[str]) -> tuple[str, ...]:
    parameters = {*model.parameter_names}
    outputs = [Expr(e).simplify() for e in model.output_expressions().values()]
    initial = {s for end, _, e in model.end_conditions if end == "initial" for s in e.symbols}
    coefficients: dict[str, set[str]] = {}
    for name in model.parameter_names:
        if name in motion or name in model.delays.parameters:
            continue
        slopes = [e.diff(name).simplify() for e in outputs if name in e.symbols]
        symbols = {s for slope in slopes for s in slope.symbols}
        acts = any(slope.constant != 0.0 for slope in slopes) or name in initial
        if acts and symbols <= parameters - {name}:
            coefficients[name] = symbols
    return tuple(name for name, symbols in coefficients.items() if symbols.isdisjoint(coefficients))
