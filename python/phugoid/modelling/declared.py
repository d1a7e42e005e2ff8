"""Declarations of a model: states, delays of inputs and outputs, other declarations in a rebuilt model of the core.

A delay moves a signal along its samples, so the structure of the problem would change with it. Instead signals are
moved by a base tau0, and what is left, d = tau - tau0, enters by Taylor's series: u(t - tau) = u0 - d u0' + d**2 u0''/2
with the derivatives of the interpolated input; at a sensor the state is x - d f + d**2 f'/2, with f the right-hand side
of the equations. First and second derivatives with respect to tau are exact at d = 0. The problem is solved, the base
moved to the estimate, and so on until nothing is left: there the optimum, and the standard errors, are those of the
delayed model itself.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import phugoid._core as _core

from .._core import Expr
from ..errors import ModelError, listing, some
from ..notebook import equation, overview, readable, readable_latex
from ..parameters import Parameter
from ..time_unit import SECONDS
from .constant import Constant, constants_table

__all__ = [
    "Declared",
    "Delays",
    "Key",
    "State",
    "added_parameters",
    "changed",
    "changed_parameters",
    "check_units",
    "declare_each",
    "declare_parameter",
    "declared_symbol",
    "equations_of",
    "kink_advice",
    "model_html",
    "model_latex",
    "model_text",
    "named_equations",
    "read_names",
    "rebuilt",
    "saved_conditions",
    "separated",
    "source_line",
    "terms_added",
]


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
        """Return the delays as the core takes them."""
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


_CUT = 300  # characters of an equation
_PACKAGE = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "")


def source_line() -> str | None:
    """Return ``file:line`` of the user's call: the innermost frame outside this package."""
    frame = sys._getframe(1)
    while frame is not None:
        if not os.path.abspath(frame.f_code.co_filename).startswith(_PACKAGE):
            return f"{os.path.basename(frame.f_code.co_filename)}:{frame.f_lineno}"
        if frame.f_back is None:
            break
        frame = frame.f_back
    return None


def read_names(kind: str, names: tuple[str, ...], units: Mapping[str, Any]) -> dict[str, Any]:
    """Return names from ``"a b"`` or ``"a", "b"`` (without value) and from ``a=..., b=...``."""
    given: list[tuple[str, Any]] = []
    for text in names:
        if not isinstance(text, str):
            raise ModelError(f"{kind}: names are text, as in {kind}('a b') or {kind}(a='m/s'), not {text!r}")
        given += [(name, None) for name in text.replace(",", " ").split()]
    given += units.items()
    if not given:
        raise ModelError(f"{kind}: no names were given")
    found = dict(given)
    if len(found) < len(given):
        listed = [name for name, _ in given]
        raise ModelError(f"{kind}: '{next(n for n in listed if listed.count(n) > 1)}' is given twice")
    return found


def check_units(kind: str, declared: Mapping[str, Any]) -> dict[str, str]:
    for name, unit in declared.items():
        if not isinstance(unit, (str, type(None))):
            raise ModelError(f"{kind}: the unit of '{name}' is text, not {unit!r}")
    return {name: unit or "" for name, unit in declared.items()}


class Declared(tuple[Expr, ...]):
    """A tuple of symbols, with an error message for its use in place of the one symbol in it.

    ``q = m.states(q="rad/s")`` lacks a comma; Python alone would complain of a sequence that cannot be multiplied.

    >>> import phugoid as ph
    >>> q = ph.Model("m").states(q="rad/s")
    >>> 2 * q  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    phugoid.errors.ModelError: (q,) is a tuple, as declarations return it even for one symbol: ...
    """

    __slots__ = ()

    def no_expression(self, *_: Any) -> NoReturn:
        """Raise ModelError, since a tuple is not an expression."""
        names = ", ".join(map(str, self)) + ("," if len(self) == 1 else "")
        raise ModelError(
            f"({names}) is a tuple, as declarations return it even for one symbol: write `{names} = ...`, with a comma"
        )

    def __add__(self, other: Any) -> Any:  # tuples are joined, as ever
        return tuple.__add__(self, other) if isinstance(other, tuple) else self.no_expression()

    __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = no_expression
    __truediv__ = __rtruediv__ = __pow__ = __rpow__ = __neg__ = __abs__ = no_expression


def declare_each(kind: str, expressions: Mapping[str, Any], act: Callable[[str, Any], Any]) -> list[Any]:
    """Declare each of some equations by ``act``; raise ModelError with the line for what is not an expression."""
    if not expressions:
        raise ModelError(f"{kind}: no equations were given")
    results = []
    for name, expression in expressions.items():
        if isinstance(expression, Declared):
            expression.no_expression()
        try:
            results.append(act(name, expression))
        except TypeError as error:
            raise ModelError(f"{kind} of '{name}' ({source_line()}): {error}") from None
    return results


def declared_symbol(symbol: Any, names: Sequence[str], where: str, what: str) -> str:
    """Return the name of a symbol that is one of ``names``; raise ModelError for anything else."""
    found = Expr(symbol).symbols if isinstance(symbol, Expr) else []
    if len(found) != 1 or str(symbol) != next(iter(found)) or str(symbol) not in names:
        raise ModelError(f"{where}: give the symbol of {what} of this model, not {symbol!r}")
    return str(symbol)


@dataclass(frozen=True)
class State:
    """A state as declared: ``m.states(x=State("m", start=1.0, bounds=(0.01, 10)))``.

    unit    for labels and tables only; nothing is converted.
    start   start of its path where no output measures it; None leaves the choice to `estimate`: the value that
            `Model.initial` gives, else 0, or 1 where the model has no finite derivative at 0, as sqrt(x).
    bounds  ``(lower, upper)``, kept at the points of the mesh (`Collocation`), where segments start
            (`MultipleShooting`), or at the first sample (`SingleShooting`). A bound where the model has no finite
            derivative, as 0 for sqrt(x), does not help: give a small number above it.

    Raises ModelError where a value is not a number, the bounds leave no room, or ``start`` lies outside them.

    >>> State("m", start=0.5, bounds=(0, 1)).bounds
    (0.0, 1.0)
    """

    unit: str = ""
    start: float | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        inside = self.start
        if inside is None:  # any number between the bounds
            try:
                low, high = (float(b) for b in self.bounds)
            except (TypeError, ValueError):
                low, high = -math.inf, math.inf  # wrong in itself: reported below
            inside = min(max(0.0, low), high)
            inside = inside if math.isfinite(inside) else 0.0
        try:
            checked = Parameter(inside, self.bounds, self.unit)
        except ModelError as error:
            raise ModelError(str(error).replace("a parameter's", "a state's").split(": use Parameter(")[0]) from None
        object.__setattr__(self, "bounds", checked.bounds)
        if self.start is not None:
            object.__setattr__(self, "start", checked.start)


Key = tuple[str, str]


def equations_of(core: _core.Model) -> Iterator[tuple[Key, Expr]]:
    """Yield all right-hand sides by kind ("quantity", "equation", "output", or the end of a condition) and name."""
    groups = {"quantity": core.quantities, "equation": core.dynamics, "output": core.outputs}
    for kind, equations in groups.items():
        for name, e, *_ in equations:
            yield (kind, name), e
    for end, state, e, _ in core.conditions:
        yield (end, state), e


def named_equations(core: _core.Model) -> dict[str, tuple[Key, Expr]]:
    """Return keys and right-hand sides of quantities, state equations and outputs, named as in `Model.equations`."""
    names = {"quantity": "{}", "equation": "{}'", "output": "y:{}"}
    return {names[kind].format(name): ((kind, name), e) for (kind, name), e in equations_of(core) if kind in names}


def saved_conditions(names: Any, inputs: Sequence[str]) -> tuple[str, ...]:
    """Return the names of conditions as saved; raise ModelError unless they are inputs of the model, each once."""
    if not isinstance(names, list) or any(n not in inputs for n in names) or len(set(names)) < len(names):
        raise ModelError(f"saved model: measured_conditions are inputs of the model, each once, not {names!r}")
    return tuple(names)


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
            raise ModelError(f"with_parameters: '{name}' is not a parameter.{listing(str(name), list(declared))}")
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


def terms_added(core: _core.Model, terms: Mapping[str, Any]) -> dict[Key, Expr]:
    """Return the equations that `Model.with_terms` replaces; raises as that does."""
    old, found = named_equations(core), {}
    for name, term in terms.items():
        if name not in old:
            raise ModelError(f"with_terms: '{name}' is not an equation.{listing(str(name), list(old))}")
        key, e = old[name]
        try:
            found[key] = Expr(e + Expr(term))
        except TypeError as error:
            raise ModelError(f"with_terms: the term of '{name}': {error}") from None
    return found


def rebuilt(
    old: _core.Model,
    inputs: Iterable[tuple[str, str]],
    declare: Callable[[_core.Model, Any], None],
    change: Callable[[Key, Expr], Expr] = lambda _, e: e,
    quantities: Mapping[str, Expr] = {},
) -> _core.Model:
    """Return a model with the states of another, ``inputs`` as (name, unit), the parameters that ``declare`` declares
    for each of its own, ``quantities`` after its own, and its equations, keyed as by `equations_of`, passed through
    ``change``."""
    core = _core.Model(old.name)
    for declared_state in old.declared_states:
        core.state(*declared_state)
    for name, unit in inputs:
        core.input(name, unit)
    for declared in old.parameters:
        declare(core, declared)
    for constant in old.constants:
        core.constant(*constant)
    for name, e, _, source in old.quantities:
        core.quantity(name, change(("quantity", name), e), source)
    for name, e in quantities.items():
        core.quantity(name, e, None)
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
    states: Mapping[str, tuple[str, Expr, Expr | None]],
    quantities: Mapping[str, Expr] = {},
) -> _core.Model:
    """Return a model with some parameters and equations replaced, and new ones, inputs, outputs, states and quantities
    added."""

    def declare(core: _core.Model, declared: Any) -> None:
        if declared[0] in parameters:
            declare_parameter(core, declared[0], parameters[declared[0]])
        else:
            core.parameter(*declared)

    core = rebuilt(old, [*old.inputs, *inputs.items()], declare, lambda key, e: equations.get(key, e), quantities)
    there = {name for name, *_ in old.parameters}
    for name, p in parameters.items():
        if name not in there:
            declare_parameter(core, name, p)
    for name, e in outputs.items():
        core.output(name, e, "", None)
    for name, (unit, right, initial) in states.items():
        core.state(name, unit)
        core.equation(name, right, None)
        if initial is not None:
            core.condition("initial", name, initial, None)
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
        f"the state equations have kinks or jumps: {some([place for _, place in kinks], _NAMED)}. No smooth path "
        f"satisfies such equations at the points of a mesh: write {functions}, with a width that is small beside the "
        "motion, and reduce it in steps, each with start=fit of the last"
    )


def model_html(
    core: _core.Model,
    note: str,
    symbols: Mapping[str, Sequence[str]],
    units: Mapping[str, str],
    parameters: Mapping[str, Parameter],
    constants: Mapping[str, Constant],
) -> str:
    """Return the HTML of a model from its equations and its symbols by kind."""
    lines = [
        [
            "state" if kind == "equation" else kind,
            # A measured output is another quantity than the state of its name, as in the report.
            equation(f"y_{left}" if kind == "output" else left, right, rate=kind == "equation", cut=_CUT),
        ]
        for (kind, left), right in equations_of(core)
    ]
    rows = [[symbol, kind, units.get(symbol, ""), "", ""] for kind, names in symbols.items() for symbol in names]
    for symbol, p in parameters.items():
        limited = any(abs(bound) != float("inf") for bound in p.bounds)
        remark = "fixed" if p.fixed else f"{p.bounds[0]:g} to {p.bounds[1]:g}" if limited else ""
        rows.append([symbol, "parameter", p.unit, f"{p.start:.6g}", remark])
    heads = ["symbol", "", "unit", "start", "bounds"]
    known = [constants_table(constants)] if constants else []
    return overview(core.name, (["", "equation"], lines, "ll"), (heads, rows, "sllrl"), *known, note=note)


def model_latex(core: _core.Model, conditions: Sequence[str]) -> str:
    """Return the equations of a model, and its measured conditions, as a LaTeX ``aligned`` block."""
    lines = [f"{Expr.symbol(n).latex()} &= {readable_latex(e.latex())}" for n, e, *_ in core.quantities]
    lines += [rf"\dot{{{Expr.symbol(n).latex()}}} &= {readable_latex(e.latex())}" for n, e, *_ in core.dynamics]
    lines += [rf"\tilde{{{Expr.symbol(n).latex()}}} &= {readable_latex(e.latex())}" for n, e, *_ in core.outputs]
    if conditions:
        symbols = ",\\ ".join(Expr.symbol(n).latex() for n in conditions)
        lines.append(rf"\text{{conditions: }} & {symbols}")
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def parameters_of(rows: Iterable[tuple[Any, ...]]) -> dict[str, Parameter]:
    """Return the parameters by name of their rows in the core."""
    return {
        name: Parameter(start, (low, high), unit, prior, fixed, local, "log" if log else None, scale)
        for name, unit, start, low, high, prior, fixed, local, log, scale in rows
    }


def time_note(time: str) -> list[str]:
    """Return what is said of a unit of time: nothing of seconds."""
    return [f"time in {time}"] if time != SECONDS else []


def model_text(core: _core.Model, conditions: Sequence[str], time: str) -> str:
    """Return the equations of a model, its measured conditions, its constants and its unit of time unless s, line by
    line."""
    marks = {"quantity": "", "equation": "'", "output": " (measured)"}
    lines = [f"{name}{marks.get(kind, f' ({kind})')} = {e}" for (kind, name), e in equations_of(core)]
    units = {n: f" ({unit})" if unit else "" for n, unit in core.inputs}
    lines += [f"conditions: {', '.join(f'{n}{units[n]}' for n in conditions)}"] if conditions else []
    for n, value, unit, meaning in core.constants:
        lines.append(f"{n} = {value:.10g} {unit}".rstrip() + (f" ({meaning})" if meaning else ""))
    lines += time_note(time)
    return "\n".join([core.name, *(f"  {readable(line)}" for line in lines)])
