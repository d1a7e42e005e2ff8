"""A model as regression equations: each measured channel, or its slope, expressed by the others; and their data from an
experiment, with the parameters as unknowns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..data.experiment import Experiment
from ..errors import DataError, EvaluationError, ModelError
from ..initialisation import measured_states
from ..modelling.compiled import CompiledExpressions, CompiledModel
from ..modelling.model import Model
from ..records import Record
from .least_squares import Differentiator

__all__ = [
    "Equation",
    "EquationSides",
    "Evaluation",
    "MeasuredChannel",
    "Unknown",
    "channels",
    "equations",
    "groups",
    "unknowns_of",
]


_Array: TypeAlias = NDArray[np.float64]
_Mask: TypeAlias = NDArray[np.bool_]
_Of = TypeVar("_Of", bound=Mapping[str, float])

# Draws of the parameters by which an output is compared with a state equation, and how near they have to be.
_DRAWS, _SAME = 3, 1e-9


@dataclass(frozen=True)
class MeasuredChannel:
    """The output that measures a state: z = offset + slope * x, both in terms of parameters alone."""

    state: str
    output: str
    offset: Expr
    slope: Expr


@dataclass(frozen=True)
class Equation:
    """A regression equation: ``name`` is the output, or the state with a prime; ``right`` its right-hand side.

    In ``right`` the name of a state stands for the channel that measures it.
    """

    name: str
    right: Expr
    channel: MeasuredChannel | None  # whose slope stands on the left; None: the output itself


def channels(model: Model, values: Mapping[str, float]) -> list[MeasuredChannel]:
    """Return for each state the output that measures it; raise ModelError, with their names, where some are not
    measured."""
    found = measured_states(model, values)
    lost = [name for name in model.state_names if name not in found]
    if lost:
        what = f"states {', '.join(lost)} are" if len(lost) > 1 else f"state {lost[0]} is"
        raise ModelError(
            f"equation_error: the {what} not measured by an output of its own, as in outputs(q=q + bias), and the "
            "equation-error method needs every state: add the output with reconstructed values, or use estimate"
        )
    outputs = model.output_expressions()
    listed = []
    for state in model.state_names:
        output = found[state][0]
        e = Expr(outputs[output])
        listed.append(MeasuredChannel(state, output, e.substitute({state: 0.0}), e.diff(state)))
    return listed


def equations(
    model: Model, measured: Sequence[MeasuredChannel], values: Mapping[str, float], data: Sequence[Experiment]
) -> list[Equation]:
    """Return the state equations, and the outputs that are not the measurement of a state.

    A state equation is left out where an output measures the slope itself. Where it does but for a bias, both stay:
    the slope separates the bias from the constants of the equation.
    """
    inside = {c.state: (Expr.symbol(c.state) - c.offset) / c.slope for c in measured}
    taken = {c.output for c in measured}
    slopes = _measured_slopes(model, measured, values, data[0]) if measured else set()
    found = []
    by_state = {c.state: c for c in measured}
    for state, e in model.state_expressions().items():
        if state not in slopes:
            channel, right = by_state[state], e.substitute(inside)
            found.append(Equation(f"{state}'", right * channel.slope, channel))
    for name, e in model.output_expressions().items():
        if name not in taken:
            found.append(Equation(name, Expr(e).substitute(inside), None))
    return found


def _measured_slopes(
    model: Model, measured: Sequence[MeasuredChannel], values: Mapping[str, float], run: Experiment
) -> set[str]:
    """Return the states whose x' is an output, found by numbers, whatever the form of the two expressions."""
    evaluator = CompiledModel(model)
    random = np.random.default_rng(0)
    declared = model.declared_parameters
    taken = {c.output for c in measured}
    picked = np.unique(np.linspace(0, run.n - 1, 50).astype(int))
    u = [run.input(name)[picked] for name in model.input_names]
    x = [np.interp(run.t[picked], *_present(run, c.output)) for c in measured]
    candidates = {
        (state, output): True for state in model.state_names for output in model.output_names if output not in taken
    }
    for _ in range(_DRAWS):
        theta = np.array(
            [
                v if declared[n].fixed else np.clip(v + random.normal() * max(abs(v), 1.0), *declared[n].bounds)
                for n, v in values.items()
            ]
        )
        columns = np.vstack([run.t[picked], *u, *x])
        slopes = dict(zip(model.state_names, evaluator.dynamics(theta, columns), strict=True))
        outputs = dict(zip(model.output_names, evaluator.outputs(theta, columns), strict=True))
        for state, output in candidates:
            slope, rest = slopes[state], outputs[output] - slopes[state]
            near = _SAME * np.abs(slope).max()
            # A constant slope does not show how the two depend on the states.
            candidates[state, output] &= bool(np.abs(rest).max() <= near < np.ptp(slope))
    return {state for (state, _), same in candidates.items() if same}


def _present(run: Experiment, output: str) -> tuple[_Array, _Array]:
    z = run.output(output)
    there = np.isfinite(z)
    return run.t[there], z[there]


def groups(inside: Sequence[set[str]]) -> list[list[int]]:
    """Return groups of the numbers of equations that share parameters, directly or through others; those without any
    are left out."""
    found: list[tuple[set[str], list[int]]] = []
    for k, names in enumerate(inside):
        if not names:
            continue
        merged, members = set(names), [k]
        for other in [g for g in found if g[0] & names]:
            merged |= other[0]
            members += other[1]
            found.remove(other)
        found.append((merged, sorted(members)))
    return [members for _, members in sorted(found, key=lambda g: g[1])]


class Evaluation:
    """Right-hand sides and their derivatives with respect to parameters, compiled, at the samples of experiments."""

    def __init__(self, model: Model, listed: Sequence[Equation], names: Sequence[str]) -> None:
        self.listed, self.names = listed, names
        used = set().union(*(e.right.symbols for e in listed))
        self.order = [name for name in model.parameter_names if name in used]
        self.place: list[list[int]] = []
        self.linear = True
        expressions: list[Expr] = []
        for equation in listed:
            derivatives = []
            expressions.append(equation.right)
            for j, name in enumerate(names):
                if name in equation.right.symbols:
                    d = equation.right.diff(name)
                    self.linear &= not any(_depends(d, other) for other in names)
                    expressions.append(d)
                    derivatives.append(j)
            self.place.append(derivatives)
        self._rows = CompiledExpressions(expressions, self.order, model.input_names, model.state_names)

    def __call__(self, values: Mapping[str, float], columns: _Array) -> tuple[_Array, _Array]:
        """Return right-hand sides (E, N) and derivatives (E, N, p) for columns of time, inputs and state channels."""
        rows = self._rows(np.array([values[n] for n in self.order]), columns)
        right = np.empty((len(self.listed), columns.shape[1]))
        derivatives = np.zeros((*right.shape, len(self.names)))
        k = 0
        for i, inside in enumerate(self.place):
            right[i] = rows[k]
            derivatives[i][:, inside] = rows[k + 1 : k + 1 + len(inside)].T
            k += 1 + len(inside)
        return right, derivatives

    def check(self, right: _Array, derivatives: _Array, mask: NDArray[np.bool_], run: Experiment) -> None:
        """Raise EvaluationError for the first number that is not finite where it is needed."""
        wrong = mask & ~(np.isfinite(right) & np.isfinite(derivatives).all(axis=2))
        if wrong.any():
            i, k = np.argwhere(wrong)[0]
            raise EvaluationError(
                f"equation_error: experiment '{run.name}': the equation of {self.listed[i].name} is not finite at "
                f"t = {run.t[k]:g} with the measured states and the parameters at their start: give another start"
            )


def _depends(e: Expr, name: str) -> bool:
    return name in e.symbols and e.diff(name).constant != 0.0


@dataclass(frozen=True)
class Unknown:
    """A parameter, of all experiments or of one alone."""

    label: str
    name: str
    experiment: int | None

    def among(self, each: Sequence[_Of]) -> Sequence[_Of]:
        """Return the values of those experiments that the parameter belongs to."""
        return each if self.experiment is None else each[self.experiment : self.experiment + 1]


def unknowns_of(model: Model, names: Sequence[str], runs: Sequence[Experiment]) -> list[Unknown]:
    declared = model.declared_parameters
    found = []
    for name in names:
        if declared[name].per_experiment:
            found += [Unknown(f"{name}[{run.name}]", name, i) for i, run in enumerate(runs)]
        else:
            found.append(Unknown(name, name, None))
    return found


class EquationSides:
    """The data of an experiment for the equations: left-hand sides (E, N), valid rows, columns for the right-hand
    sides."""

    def __init__(
        self,
        model: Model,
        run: Experiment,
        measured: Sequence[MeasuredChannel],
        listed: Sequence[Equation],
        way: Differentiator,
    ) -> None:
        self.model, self.run, self.measured, self.listed = model, run, measured, listed
        smooth = {c.state: _smooth(run, c, way) for c in measured}
        self.columns = np.vstack(
            [run.t, *(run.input(n) for n in model.input_names), *(smooth[n][0] for n in model.state_names)]
        )
        # Beyond the first and the last sample of a state the smoothing extrapolates.
        covered = np.ones(run.n, dtype=bool)
        for c in measured:
            present = np.flatnonzero(np.isfinite(run.output(c.output)))
            covered[: present[0]] = covered[present[-1] + 1 :] = False
        own = [np.isfinite(run.output(e.channel.output if e.channel else e.name)) for e in listed]
        self.mask: _Mask = np.array([covered & o for o in own])
        left = [smooth[e.channel.state][1] if e.channel else run.output(e.name) for e in listed]
        self.left = np.where(self.mask, np.array(left), 0.0)

    def unit(self, equation: Equation) -> str:
        """Return the unit of the sides of an equation, where it is known."""
        units = self.model.units
        if equation.channel is None:
            return units.get(equation.name, "")
        own = units.get(equation.channel.output, units.get(equation.channel.state))
        return self.model.time_unit.rate(own) if own else ""

    def record(self, values: Mapping[str, float]) -> Record:
        """Return a record of both sides at the result."""
        right, _ = Evaluation(self.model, self.listed, [])(values, self.columns)
        left = np.where(self.mask, self.left, np.nan)
        first = 1 + len(self.model.input_names)
        channel = dict(zip(self.model.state_names, self.columns[first:], strict=True))
        states = {
            c.state: (channel[c.state] - _number(c.offset, values)) / _number(c.slope, values) for c in self.measured
        }
        states = {name: states[name] for name in self.model.state_names}
        units = {**self.model.units, **{e.name: unit for e in self.listed if (unit := self.unit(e))}}
        names = [e.name for e in self.listed]
        return Record(
            name=self.run.name,
            t=self.run.t,
            inputs={n: self.run.input(n) for n in self.model.input_names},
            outputs=dict(zip(names, right, strict=True)),
            states=states,
            measured=dict(zip(names, left, strict=True)),
            residuals=dict(zip(names, left - right, strict=True)),
            mesh_t=self.run.t,
            mesh_states=states,
            units=units,
        )


def _smooth(run: Experiment, channel: MeasuredChannel, way: Differentiator) -> tuple[_Array, _Array]:
    try:
        return way.smooth(run.t, run.output(channel.output))
    except DataError as error:
        raise DataError(f"experiment '{run.name}', output '{channel.output}': {error}") from None


def _number(e: Any, values: Mapping[str, float]) -> float:
    return float(e.evaluate({n: values[n] for n in e.symbols}))
