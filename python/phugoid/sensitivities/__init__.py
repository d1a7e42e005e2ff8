"""The trajectory of a fit, the places at which terms act along it, and derivatives of the model there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..modelling.compiled import CompiledExpressions

__all__ = ["AddedTerm", "Derivatives", "Place", "Points", "Values", "shown_by_outputs"]


_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Place:
    """Where a candidate acts: what its signal is added to.

    An "input" or a "parameter" stands for its symbol everywhere, an "equation" for the derivative of the state of that
    name, a "state" for what a state is in the forces, but neither in the kinematics nor at its own sensor: with wind
    the motion through the air is another than that over ground. What acts in an equation is ``shown`` by outputs that
    show its rate, as a force is by an accelerometer, or not, as a term of the kinematics.
    """

    kind: Literal["quantity", "equation", "output", "input", "parameter", "state"]
    name: str
    shown: bool = True


@dataclass(frozen=True, eq=False, repr=False)
class Points:
    """One experiment along the fitted path, at n times: the mesh points, or the samples.

    experiment  name of the experiment.
    t           (n,) time, s.
    values      name -> (n,): states, inputs and quantities.
    rates       name -> (n,): time derivatives of states and inputs, per second.
    outputs     name -> (n,): outputs of the model.
    output_rates  name -> (n,): their time derivatives, per second.
    parameters  name -> value of the model's parameters in this experiment; nothing where that is not known.
    """

    experiment: str
    t: _Array
    values: Mapping[str, _Array]
    rates: Mapping[str, _Array]
    outputs: Mapping[str, _Array]
    output_rates: Mapping[str, _Array]
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.t.size)


class AddedTerm(Protocol):
    """What is added to a model at one place, to first order: ``sum_k c_k signal_k(t)``, for values of its shape.

    Without coefficients (``unit_amplitude``) its one signal is the whole effect.
    """

    @property
    def place(self) -> Place: ...

    @property
    def coefficients(self) -> tuple[str, ...]: ...

    @property
    def unit_amplitude(self) -> bool: ...

    def signals(self, points: Points, shape: Mapping[str, float]) -> _Array:
        """Return the signals (k, n) at the points; k is the number of coefficients, or 1 with unit amplitude."""
        ...


# Points at which an output is compared with a right-hand side, and the relative difference that is rounding.
_TRIED, _ROUNDING = 5, 1e-8


def shown_by_outputs(
    equations: Mapping[tuple[str, str], Expr], parameters: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Return, for states whose rates outputs show, output -> multiple of the rate that is in it.

    An accelerometer shows the forces on what it is mounted on, be they written out in its output once more or not: what
    is missing in an equation is missing there, too. It shows them where all parameters of a right-hand side, two at
    least, change the output as many times as much as the rate, whatever the motion.
    """
    known: dict[str, Any] = {}
    for (kind, name), e in equations.items():
        if kind == "quantity":
            known[name] = Expr(e.substitute(known))
    rates, outputs = (
        {n: Expr(e.substitute(known)) for (kind, n), e in equations.items() if kind == wanted}
        for wanted in ("equation", "output")
    )
    found: dict[str, dict[str, float]] = {}
    for state, rate in rates.items():
        own = [p for p in parameters if p in rate.symbols]
        for output, e in outputs.items() if len(own) > 1 else ():
            multiple = _multiple(e, rate, own) if {*own} <= {*e.symbols} else None
            if multiple is not None:
                found.setdefault(state, {})[output] = multiple
    return found


def _multiple(e: Expr, rate: Expr, parameters: Sequence[str]) -> float | None:
    """Return how many times as much as a rate an expression changes by each of some parameters; None where that is not
    the same number for all of them everywhere."""
    random = np.random.default_rng(0)
    pairs = [(Expr(e.diff(p)), Expr(rate.diff(p))) for p in parameters]
    names = sorted({*e.symbols, *rate.symbols})
    ratios = []
    for _ in range(_TRIED):
        at = dict(zip(names, random.uniform(0.5, 1.5, len(names)).tolist(), strict=True))
        for mine, theirs in pairs:
            slope = theirs.evaluate(at)
            if slope:
                ratios.append(mine.evaluate(at) / slope)
    values = np.array(ratios)
    if not values.size or not np.isfinite(values).all() or not values[0]:
        return None
    return float(values[0]) if np.ptp(values) <= _ROUNDING * abs(values[0]) else None


# Models of more parameters than this are not asked what each of them moves at every point.
_PARAMETERS = 60


class Derivatives:
    """f, g, quantities, and derivatives of f and g with respect to states, parameters and places, compiled.

    ``whole`` is the model as the user has it, of which ``model`` may be the one with delays taken out.
    """

    def __init__(self, model: Any, whole: Any) -> None:
        equations = model._right_hand_sides()
        self.states, self.outputs = list(model.state_names), list(model.output_names)
        self.parameters = list(model.parameter_names)
        inputs = list(model.declared_inputs)
        quantities = model.quantity_names
        # What is added to a quantity is a symbol of its own, nothing in the end.
        extra = {name: f"added to {name}" for name in quantities}
        known: dict[str, Any] = {}
        for name in quantities:
            known[name] = equations["quantity", name].substitute(known) + Expr.symbol(extra[name])
        none: dict[str, float] = dict.fromkeys(extra.values(), 0.0)
        f = [Expr(equations["equation", name].substitute(known)) for name in self.states]
        g = [Expr(equations["output", name].substitute(known)) for name in self.outputs]
        # In a late output, written out for an earlier time, quantities have no name: where its delay is as fitted, it
        # is the output of the whole model at its own time.
        late = whole._right_hand_sides()
        g_of_quantities = [Expr(late["output", name].substitute(known)) for name in self.outputs]
        self._entries: list[tuple[str, Any, int, int]] = []  # what, which, row, output of the evaluator
        asked: list[Expr] = []

        def ask(what: str, which: Any, row: int, e: Expr) -> None:
            e = Expr(e.substitute(none))
            if e.constant == 0.0:
                return
            self._entries.append((what, which, row, len(asked)))
            asked.append(e)

        for k, e in enumerate(f):
            ask("f", 0, k, e)
        for k, e in enumerate(g):
            ask("g", 0, k, e)
        for k, name in enumerate(quantities):
            ask("quantities", 0, k, Expr(known[name]))
        for i, e in enumerate(g):
            for k, name in enumerate([*self.states, *self.parameters]):
                if name in e.symbols:
                    ask("by_state" if k < len(self.states) else "by_parameter", name, i, e.diff(name))
        self.places: list[tuple[Place, str]] = [(Place("quantity", n), s) for n, s in extra.items()]
        self.places += [(Place("input", n), n) for n in inputs]
        if len(self.parameters) <= _PARAMETERS:
            self.places += [(Place("parameter", n), n) for n in self.parameters]
        # What acts on a state as the equations have it, and is no part of it, such as a gust: neither a sensor of that
        # state itself nor the kinematics know of it.
        self.places += [(Place("state", n), n) for n in self.states]
        plain = [Expr(equations["output", name]) for name in self.outputs]
        plain_f = [Expr(equations["equation", name]) for name in self.states]
        for place, symbol in self.places:
            air = place.kind == "state"
            # Where forces are declared, they alone know of the air: gravity along the path does not.
            forces = air and any(symbol in equations["quantity", n].symbols for n in quantities)
            for k, e in enumerate(f):
                if symbol in e.symbols and not (air and e == Expr.symbol(symbol)):
                    of_motion = plain_f[k].diff(symbol).substitute(known) if forces else 0.0
                    ask("place f", place, k, Expr(e.diff(symbol) - of_motion))
            for k, e in enumerate(g_of_quantities if place.kind == "quantity" else g):
                if symbol in e.symbols:
                    of_sensor = plain[k].diff(symbol).substitute(known) if air else 0.0
                    ask("place g", place, k, Expr(e.diff(symbol) - of_sensor))
        self._shown = shown_by_outputs(late, self.parameters)
        self.n_quantities = len(quantities)
        self._compiled = CompiledExpressions(asked, self.parameters, inputs, self.states)

    def __call__(self, theta: _Array, columns: _Array) -> Values:
        n = columns.shape[1]
        rows = self._compiled(theta, columns)
        n_x, n_y = len(self.states), len(self.outputs)
        v = Values(
            np.zeros((n_x, n)),
            np.zeros((n_y, n)),
            np.zeros((self.n_quantities, n)),
            np.zeros((n_y, n_x, n)),
            np.zeros((n_y, len(self.parameters), n)),
        )
        for place, _ in self.places:
            v.by_place[place] = (np.zeros((n_x, n)), np.zeros((n_y, n)))
        for k, name in enumerate(self.states):
            slope = np.zeros((n_x, n))
            slope[k] = 1.0
            direct = np.zeros((n_y, n))
            for output, multiple in self._shown.get(name, {}).items():
                direct[self.outputs.index(output)] = multiple
            v.by_place[Place("equation", name)] = (slope, direct)
        for what, which, row, k in self._entries:
            if what in ("f", "g", "quantities"):
                getattr(v, what)[row] = rows[k]
            elif what == "by_state":
                v.by_state[row, self.states.index(which)] = rows[k]
            elif what == "by_parameter":
                v.by_parameter[row, self.parameters.index(which)] = rows[k]
            else:
                v.by_place[which][what == "place g"][row] = rows[k]
        return v


class Values:
    def __init__(self, f: _Array, g: _Array, quantities: _Array, by_state: _Array, by_parameter: _Array) -> None:
        self.f, self.g, self.quantities = f, g, quantities
        self.by_state, self.by_parameter = by_state, by_parameter
        self.by_place: dict[Place, tuple[_Array, _Array]] = {}
